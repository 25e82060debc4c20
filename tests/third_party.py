"""What the three packages need from others, with all extras, one requirement a line: the input of ``make lock``."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def third_party() -> list[str]:
    """The requirements of the three pyproject.toml, sorted; without our own packages."""
    found: set[str] = set()
    for package in ("shared", "datafactory", "trainer"):
        project = tomllib.loads((ROOT / package / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        found.update(project["dependencies"], *project.get("optional-dependencies", {}).values())
    return sorted(requirement for requirement in found if not requirement.startswith("sparseradar-"))


if __name__ == "__main__":
    print("\n".join(third_party()))
