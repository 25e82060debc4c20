"""Documents that users write take text, true and false for no numbers, though pydantic would."""

from typing import Any

import pytest
from pydantic import BaseModel

from shared.physics.errors import InputError
from shared.radar import validated
from shared.radar.arrays import AntennaArray
from trainer.captures.calibration import Calibration, Reflector
from trainer.captures.cube_file import Capture
from trainer.data.arrays import ArrayChoice
from trainer.data.measurements import MotionFile
from trainer.run.configuration import FitConfig, Imperfections


@pytest.mark.parametrize(
    ("model", "document", "said"),
    [
        (FitConfig, {"steps": "600"}, "steps = '600'; expected a whole number"),
        (FitConfig, {"batch": True}, "batch = True; expected a whole number"),
        (FitConfig, {"augment": "no"}, "augment = 'no'; expected true or false"),
        (FitConfig, {"augment": 1}, "augment = 1; expected true or false"),
        (FitConfig, {"imperfections": {"perfect": "0.5"}}, "imperfections.perfect = '0.5'; expected a number"),
        (Imperfections, {"bits": True}, "bits = True; expected a whole number"),
        (ArrayChoice, {"name": "mine", "rx": [True]}, "rx.0 = True; expected a whole number"),
        (MotionFile, {"velocity": [1, 0], "mounting_yaw_deg": "5"}, "mounting_yaw_deg = '5'; expected a number"),
        (MotionFile, {"velocity": ["8.3", 1.0]}, "velocity.0 = '8.3'; expected a number"),
        (Imperfections, {"gain_db": [0.1, True]}, "gain_db.1 = True; expected a number"),
        (AntennaArray, {"tx_m": [[0.0, 0.0, "1"]], "rx_m": [[0, 0, 0]]}, "tx_m.0.2 = '1'; expected a number"),
        (Reflector, {"range_m": "3"}, "range_m = '3'; expected a number"),
        (Calibration, {"model_error_db": "-20"}, "model_error_db = '-20'; expected a number"),
        (Capture, {"frames": True}, "frames = True; expected a whole number"),
    ],
)
def test_text_and_truth_values_are_no_numbers(model: type[BaseModel], document: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as caught:
        validated(model, document, "file")
    assert str(caught.value) == f"file: {said}"


def test_what_is_not_stated_and_whole_floats_are_taken() -> None:
    assert validated(FitConfig, {"steps": 600.0, "imperfections": None}, "file") == FitConfig()
    assert validated(Imperfections, {"bits": None, "perfect": 1}, "file").perfect == 1.0
