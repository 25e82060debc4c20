"""Licences: of a dataset, as its maker states it, and of the scenes that it was made of, where they are known."""

from __future__ import annotations

from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

from datafactory.scenes.readers.open import SHIPPED_PREFIX, SIONNA_PREFIX
from shared.physics.errors import InputError

UNKNOWN = "unknown"

# Of the licences for data those that the Hub knows by name (https://huggingface.co/docs/hub/repositories-licenses):
# SPDX identifiers in small letters. The two named otherwise there stand with their names.
_ON_THE_HUB = {
    name: name
    for name in (
        "apache-2.0", "mit", "bsd-2-clause", "bsd-3-clause", "bsd-3-clause-clear", "c-uda-1.0", "cc0-1.0", "cc-by-2.0",
        "cc-by-2.5", "cc-by-3.0", "cc-by-4.0", "cc-by-sa-3.0", "cc-by-sa-4.0", "cc-by-nc-2.0", "cc-by-nc-3.0",
        "cc-by-nc-4.0", "cc-by-nd-4.0", "cc-by-nc-nd-3.0", "cc-by-nc-nd-4.0", "cc-by-nc-sa-2.0", "cc-by-nc-sa-3.0",
        "cc-by-nc-sa-4.0", "cdla-sharing-1.0", "cdla-permissive-1.0", "cdla-permissive-2.0", "mpl-2.0", "isc",
        "unlicense", "zlib",
    )
} | {"odbl-1.0": "odbl", "odc-by-1.0": "odc-by", "pddl-1.0": "pddl", "c-uda-1.0": "c-uda"}  # fmt: skip

_OPENSTREETMAP = ("etoile", "florence", "munich", "san_francisco")
"""Scenes of Sionna made of OpenStreetMap's data, as its documentation says."""


def stated_licence(text: str | None) -> str | None:
    """An SPDX expression in its canonical form; None for none.

    :raises InputError: no SPDX identifier, nor an expression of such
    """
    if text is None:
        return None
    try:
        return canonicalize_license_expression(text)
    except InvalidLicenseExpression as error:
        expected = "an SPDX identifier, e.g. CC-BY-4.0, CC0-1.0, ODbL-1.0, or LicenseRef-NAME for one of your own"
        raise InputError("--license", f"{text!r}: {' '.join(str(error).split())}", expected) from error


def hub_licence(stated: str | None) -> tuple[str, str | None]:
    """The Hub's ``license`` for an SPDX expression, and its ``license_name`` where the Hub has none for it."""
    if stated is None:
        return UNKNOWN, None
    known = _ON_THE_HUB.get(stated.lower())
    return (known, None) if known else ("other", stated.lower().replace(" ", "-"))


def scene_licence(source: str) -> str:
    """What is known of the licence of a scene.

    :param source: as the manifest has it
    """
    if source.startswith(SHIPPED_PREFIX):
        return "Apache-2.0, as this software"
    if source.startswith(SIONNA_PREFIX):
        name = source.removeprefix(SIONNA_PREFIX)
        return "ODbL-1.0, OpenStreetMap contributors" if name in _OPENSTREETMAP else "Apache-2.0, as Sionna"
    return "not known here: its author's"
