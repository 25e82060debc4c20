"""Recipes: what counts before what, and that every one of them is a configuration."""

from importlib.util import find_spec
from pathlib import Path

import pytest
import torch

from shared.physics.errors import InputError
from trainer.run.configuration import FitConfig
from trainer.training.callbacks import check_logger, make_logger
from trainer.training.start import GPU, RECIPES, configuration


@pytest.fixture(autouse=True)
def processor_without_bfloat16(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.cpu, "get_capabilities", dict)


def test_every_recipe_is_a_configuration() -> None:
    for recipe in RECIPES:
        assert configuration(recipe) == FitConfig.model_validate(RECIPES[recipe])
    assert configuration() == FitConfig()


def test_what_is_stated_counts_before_the_recipe_and_the_recipe_before_the_device(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = configuration("paper", {"width": 8, "steps": None, "seed": 3})
    assert (found.width, found.accumulate, found.steps, found.seed) == (8, 4, FitConfig().steps, 3)
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    assert configuration().precision == "bf16"
    assert configuration(given={"precision": "32"}).precision == "32"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert configuration() == FitConfig.model_validate(GPU)
    assert configuration("doa").width == 256
    assert configuration("doa").precision == "bf16"


def test_a_file_states_fields_between_the_recipe_and_the_options(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text("steps = 50\nwidth = 6\n[imperfections]\nphase_deg = [2.0, 3.0]\n", encoding="utf-8")
    found = configuration("recommended", {"width": 8, "batch": None}, path)
    assert (found.steps, found.width) == (50, 8)
    assert found.imperfections is not None
    with pytest.raises(InputError, match="config: 3; expected a TOML file's path, or a FitConfig"):
        configuration(config=3)  # type: ignore[arg-type]
    path.write_text('model = "doa-cnn"\n', encoding="utf-8")
    assert configuration("doa", None, path).steps == 4000


def test_what_is_stated_counts_before_a_configuration() -> None:
    """Recipe and device do not: the configuration is given in their place."""
    assert configuration("paper", {"steps": 5, "batch": None}, FitConfig(width=8)) == FitConfig(width=8, steps=5)
    assert configuration(config=FitConfig(width=8)).model_fields_set == {"width", "features"}


def test_what_makes_no_difference_is_refused_and_not_where_it_does_or_is_the_default(tmp_path: Path) -> None:
    every = tmp_path / "every.toml"
    every.write_text("hidden = 384\nbeta = 10.0\nlearned = 2\nexponent = 0.5\n", encoding="utf-8")
    assert configuration("recommended", {"hidden": None}, every) == FitConfig()
    assert configuration("paper", {}, every).model == "attention-unet"
    assert configuration(given={"model": "spectral-unet", "hidden": 7}).hidden == 7
    for recipe, stated in (
        ("recommended", {"hidden": 7}),
        ("recommended", {"threshold_db": 20.0}),
        ("recommended", {"model": "spectral-unet", "learned": 1}),
        ("paper", {"iterations": 3}),
        ("paper", {"linear": 0.1}),
        ("doa", {"foreground": 0.0}),
        ("doa", {"alpha": 0.1}),
    ):
        with pytest.raises(InputError, match="makes no difference with"):
            configuration(recipe, stated)


def test_loggers() -> None:
    assert make_logger("none", Path("out")) is False
    if find_spec("wandb") is None:
        with pytest.raises(InputError, match="the package wandb is not installed; expected pip install wandb"):
            check_logger("wandb")
