"""``--array``: which of the dataset's virtual channels a network gets to see."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from shared.physics.errors import InputError
from shared.radar import Radar, read_toml, validated
from shared.radar.arrays import AVR_QDM_110_THINNED_RX
from shared.radar.validation import Described

FULL = "full"
"""The name of all elements of any radar."""


class ArrayChoice(Described):
    """A subset of a radar's RX elements, each with all TX.

    :param name: "full", "sparse6", "sparse4" or the TOML file's name
    :param rx: indices of the RX elements kept, rising
    """

    name: str
    rx: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)]

    @field_validator("rx")
    @classmethod
    def _rising(cls, rx: tuple[int, ...]) -> tuple[int, ...]:
        if list(rx) != sorted(set(rx)):
            raise ValueError(f"rx = {list(rx)}; expected rising indices without repetition")
        return rx

    def channels(self, radar: Radar) -> NDArray[np.intp]:
        """Indices of the virtual channels among those of the radar's array."""
        return radar.array.channel_indices(self.rx)

    def line(self, radar: Radar) -> NDArray[np.intp]:
        """Those of them along azimuth, which networks and estimators see: angles are computed of y alone."""
        return radar.array.at_one_height(self.channels(radar))

    def left_out(self, radar: Radar) -> str:
        """What is said of channels that are not along azimuth; "" where all are."""
        every, line = len(self.channels(radar)), len(self.line(radar))
        return f"{every - line} of {every} channels, at other heights than most, are left out" if line < every else ""


def choose_array(name_or_path: str | Path, radar: Radar, option: str = "--array") -> ArrayChoice:
    """A named array of the radar, or a TOML file with one entry ``rx = [0, 1, ...]``.

    :param option: that names it, for the message
    :raises InputError: an unknown name, an unreadable file, RX elements that the radar does not have
    """
    if not isinstance(name_or_path, str | Path):
        raise InputError(
            option, repr(name_or_path), "a name, or the path of a TOML file with an entry rx = [0, 1, ...]"
        )
    count = len(radar.array.rx_m)
    if name_or_path == FULL:
        return ArrayChoice(name=FULL, rx=tuple(range(count)))
    if isinstance(name_or_path, str) and name_or_path in AVR_QDM_110_THINNED_RX:
        choice = ArrayChoice(name=name_or_path, rx=AVR_QDM_110_THINNED_RX[name_or_path])
    else:
        choice = _from_file(Path(name_or_path), option)
    if choice.rx[-1] >= count:
        expected = f"RX 0 to {count - 1}, those of the dataset's radar: {FULL!r} has them all"
        raise InputError(option, f"{name_or_path} uses RX {choice.rx[-1]}", expected)
    return choice


def _from_file(path: Path, option: str) -> ArrayChoice:
    if not path.is_file():
        known = ", ".join(AVR_QDM_110_THINNED_RX)
        raise InputError(option, f"no named array and no file {str(path)!r}", f"a TOML file or one of {known}")
    return validated(ArrayChoice, {"name": path.stem, **read_toml(path)}, path)
