"""A stranger's package of one of our import names.

The public index has distributions that install ``shared`` or ``trainer``. The one that is installed later writes over
the files of the other, without a word. Each of ours asks here when it begins.
"""

from __future__ import annotations

from importlib import metadata

OURS = {"shared": "sparseradar-shared", "datafactory": "sparseradar-datafactory", "trainer": "sparseradar-trainer"}
"""Distribution by import name."""


def strangers(package: str) -> list[str]:
    """Names of all installed distributions that bring a package of this name, ours apart.

    It reads the records of every distribution, a tenth of a second.
    """
    found = metadata.packages_distributions().get(package, [])
    return sorted({name for name in found if name.lower().replace("_", "-") != OURS[package]})


def namesake(package: str) -> str | None:
    """The distribution that has the very name of the package, if one is installed: a question of a millisecond."""
    try:
        return str(metadata.metadata(package)["Name"])
    except metadata.PackageNotFoundError:
        return None


def remedy(package: str, names: list[str]) -> str:
    """The commands that bring ours back."""
    ours = OURS[package]
    return f"pip uninstall -y {' '.join(names)} && pip install --force-reinstall --no-deps {ours}"


def refuse_namesake(package: str) -> None:
    """Say in one line that a stranger's package is installed over ours.

    :raises ImportError: a distribution of the package's very name is installed
    """
    if name := namesake(package):
        raise ImportError(
            f"the distribution {name!r} is installed over {OURS[package]!r}, both bring the package {package!r}; "
            f"mend it: {remedy(package, [name])}"
        )
