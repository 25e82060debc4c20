"""Write ``expected.json`` from the effect scenes: ``.venv/bin/python tests/effect_scenes/write_expected.py``.

``scenes/make_effects.py`` writes the scenes themselves; ``make scenes`` runs both.
"""

from __future__ import annotations

import sys
from pathlib import Path

from pxr import Sdf

TESTS = Path(__file__).resolve().parents[1]
SCENES = TESTS.parent / "scenes" / "effects"
EXPECTED = TESTS / "effect_scenes" / "expected.json"


def described(folder: Path) -> dict[str, str]:
    """What each scene of the folder is, by name: the sentence in its layer's header."""
    return {path.stem: Sdf.Layer.FindOrOpen(str(path)).documentation for path in folder.glob("*.usda")}


def write_expected(path: Path = EXPECTED) -> None:
    """Write which effects each scene calls for, why, and its echoes' levels; the same versions write the same bytes."""
    from effect_scenes.reasons import expectations

    from shared.dataset.writing import write_json

    write_json(path, expectations(described(SCENES)), sort_keys=False)


if __name__ == "__main__":
    sys.path.append(str(TESTS))  # behind everything else, as tests/conftest.py does
    write_expected()
