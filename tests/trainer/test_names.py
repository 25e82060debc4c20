"""The names that help lists are those of the registries, which import what computes."""

from shared.processes.defaults import BOARD_NAMES
from shared.radar.boards import BOARDS
from trainer.defaults import DEFAULT_METHODS, ESTIMATOR_NAMES, EXPERIMENT_NAMES, OF_MEASURED_ROWS
from trainer.estimators.base import ESTIMATORS
from trainer.evaluation.evaluate import NAMES
from trainer.evaluation.experiments.measured import METHODS


def test_registries_have_the_names_of_help() -> None:
    assert tuple(BOARDS) == BOARD_NAMES
    assert tuple(ESTIMATORS) == ESTIMATOR_NAMES
    assert (*ESTIMATOR_NAMES, *OF_MEASURED_ROWS) == METHODS
    assert NAMES == EXPERIMENT_NAMES
    assert set(DEFAULT_METHODS) < set(ESTIMATOR_NAMES)
