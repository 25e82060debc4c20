"""What the shipped networks have seen of a scene lies in no test region of a dataset that is made of it by default.

The streets are cut by what is free of them, and what ``--populate`` puts in takes some of it: the cuts of one scene
with other traffic differ by metres. Of the frames that they were first trained on the regions are held against each
other; of the drives after those, whose traffic was put in with other seeds, each frame's own place is.
"""

import csv
import re

import numpy as np
import pytest
from manual import ROOT
from numpy.typing import NDArray
from processes import python

from datafactory.api.asking import load_scene
from datafactory.scenes.ground import Ground, sensor_ground
from shared.dataset.folder import SPLITS
from trainer.run.folder import SceneRecord, read_run
from trainer.run.pretrained import pretrained_names, pretrained_run

SCENES = ("scenes/street.usda", "sionna:simple_street_canyon_with_cars", "sionna:munich")
"""Of ``make dataset``."""
TEST = SPLITS.index("test")


def variable(name: str) -> str:
    """Of the Makefile."""
    found = re.search(rf"^{name} := (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    assert found is not None
    return found[1]


def source_of(scene: str) -> str:
    return str(ROOT / scene) if scene.startswith("scenes/") else scene


def seen_of(name: str) -> set[SceneRecord]:
    """The scenes of this name that any shipped network was first trained on."""
    starts = [read_run(pretrained_run(network)).start for network in pretrained_names()]
    # In the order of training: what comes later are drives.
    seen = (start.trained_on[0] for start in starts if start is not None)
    return {scene for data in seen for scene in data.scenes or () if scene.name == name}


def places_of(name: str) -> NDArray[np.float64]:
    """[N, 2] where the drives' frames stand."""
    with (pretrained_run("sparse6").parent / "places.csv").open(encoding="utf-8") as handle:
        rows = [row for row in csv.DictReader(handle) if row["scene"] == name]
    return np.array([[row["x"], row["y"]] for row in rows], dtype=float)


def content_of(source: str, populate: str | None, kernels: str) -> str:
    """The content hash of a scene where OpenBLAS has the kernels of that processor, by a process of its own."""
    load = f"load_scene({source!r}, populate={populate!r})"
    code = f"from datafactory.api.asking import load_scene; print({load}.content_hash())"
    return python("-c", code, OPENBLAS_CORETYPE=kernels).strip()


def apart(trained: Ground, made: Ground) -> bool:
    """Whether no cell of the one's regions of training and validation lies in the other's test region."""
    cells = np.argwhere((trained.region >= 0) & (trained.region != TEST))
    x, y = (np.array(trained.origin) + (cells + 0.5) * trained.cell_m).T
    return len(cells) > 0 and not np.any(made.values_at(np.where(made.region == TEST, 1, 0), x, y))


def test_the_scenes_are_those_of_make_dataset() -> None:
    assert variable("CITIES").split()[1::2] == list(SCENES)


@pytest.mark.parametrize("scene", [*SCENES[:2], pytest.param(SCENES[2], marks=pytest.mark.slow)])
def test_no_place_that_was_trained_on_lies_in_a_test_region(scene: str) -> None:
    source = source_of(scene)
    texts = {"make dataset": variable("POPULATE").split()[1], "render --scene": None}
    made = {name: sensor_ground(load_scene(source, populate=text)) for name, text in texts.items()}
    name = load_scene(source).name
    seen, (x, y) = seen_of(name), places_of(name).T
    assert seen
    assert len(x) > 20
    for kind, ground in made.items():
        assert not np.any(ground.values_at(np.where(ground.region == TEST, 1, 0), x, y)), kind
    for record in seen:
        trained = load_scene(source, populate=record.populate)
        # The very scene that they were trained on, which alone has the very ground.
        assert trained.content_hash() == record.content_sha256
        ground = sensor_ground(trained)
        for name, other in made.items():
            assert apart(ground, other), name


@pytest.mark.parametrize("scene", SCENES[:2])
def test_a_populated_scene_has_the_same_bits_on_processors_with_and_without_avx_512(scene: str) -> None:
    """On one without, both are its own."""
    populate = variable("POPULATE").split()[1]
    here = load_scene(source_of(scene), populate=populate).content_hash()
    assert content_of(source_of(scene), populate, "Haswell") == here


def test_ground_of_other_traffic_may_be_cut_elsewhere() -> None:
    """Which is why it is looked at: bare, the canyon's region of training reaches into the example's test region."""
    bare, example = (
        sensor_ground(load_scene(SCENES[1], populate=text)) for text in (None, variable("POPULATE").split()[1])
    )
    assert not apart(bare, example)
    assert apart(example, example)
