"""What a manifest says of its scenes, and what one of another maker may hold instead."""

import pytest

from trainer.run.folder import SceneRecord, scene_records

MUNICH = {"name": "munich", "content_sha256": "a" * 64, "source": "sionna:munich", "triangles": 38936}


def test_a_scene_has_its_name_its_content_and_what_was_put_in():
    crowded = {**MUNICH, "content_sha256": "b" * 64, "population": {"populate": "cars=20", "seed": 0}}
    assert scene_records({"scenes": [MUNICH, crowded]}) == (
        SceneRecord(name="munich", content_sha256="a" * 64),
        SceneRecord(name="munich", content_sha256="b" * 64, populate="cars=20"),
    )


def test_no_scenes_are_not_unknown_ones():
    assert scene_records({"scenes": []}) == ()
    assert scene_records({}) is None


@pytest.mark.parametrize(
    "scenes",
    [
        "munich", ["munich"], [None], [{"name": "munich"}], [{**MUNICH, "name": 7}], [{**MUNICH, "population": "many"}],
        [{**MUNICH, "population": {}}], [MUNICH, {}], {"munich": MUNICH},
    ],
)  # fmt: skip
def test_what_cannot_be_understood_is_unknown(scenes):
    assert scene_records({"scenes": scenes}) is None
