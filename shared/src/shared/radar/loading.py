"""Radars by name and from files: the presets, the boards, and the TOML file."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from shared.physics.errors import InputError, meant
from shared.radar.antenna import read_table
from shared.radar.arrays import virtual_sensor_256
from shared.radar.boards import BOARDS, mirrored
from shared.radar.profile import ChirpProfile, read_cfg
from shared.radar.radar import Radar
from shared.radar.validation import Described, read_toml, validated
from shared.radar.waveform import Waveform


def board_radar(name: str, mirror: bool = False) -> Radar:
    """A board of :data:`shared.radar.boards.BOARDS` with chirps to simulate; mirrored if asked for.

    :raises InputError: an unknown name
    """
    if name not in BOARDS:
        raise InputError("board", f"{name!r}", f"one of {list(BOARDS)}")
    board = BOARDS[name]()
    array = mirrored(board.array) if mirror else board.array
    return Radar(name=name, waveform=board.profile.waveform(len(array.tx_m)), array=array, front_end=board.front_end)


PRESETS: dict[str, Callable[[], Radar]] = {
    "avr-qdm-110": lambda: Radar(name="avr-qdm-110"),
    "avr-qdm-110-virtual": lambda: Radar(name="avr-qdm-110-virtual", array=virtual_sensor_256(Waveform().carrier_hz)),
    **{name: partial(board_radar, name) for name in BOARDS},
}
"""The paper's sensor, its enhanced virtual twin, and the boards, by the name that ``--radar`` takes."""

ABOVE = ("board", "mirror", "capture")
"""Entries of a radar's file that say what its tables begin with."""


def load_radar(name_or_path: str) -> Radar:
    """A preset by name, or a TOML file with the tables ``waveform``, ``array``, ``front_end``, ``grid``.

    The file states only what differs from the default radar, or from ``board = "NAME"``. ``mirror = true`` exchanges
    left and right of the board. The table ``capture`` states chirps as :class:`shared.radar.profile.ChirpProfile` does;
    ``capture = "FILE.cfg"`` takes them from a configuration of the mmWave SDK beside the file. A pattern may be named
    by a file beside it: ``tx_pattern = { kind = "table", file = "pattern.csv" }``, see
    :class:`shared.radar.antenna.TablePattern`.

    :raises InputError: an unknown name, an unreadable file, a field or value that the radar does not allow, alone or
        together with others
    """
    if name_or_path in PRESETS:
        return PRESETS[name_or_path]()
    if not Path(name_or_path).is_file():
        problem = f"no preset and no file {name_or_path!r}"
        expected = f"a TOML file or one of {list(PRESETS)}{meant(name_or_path, PRESETS)}"
        raise InputError("--radar", problem, expected)
    return load_capture_radar(name_or_path, None).radar


class CaptureRadar(NamedTuple):
    """A radar, and what its raw captures are.

    :param real: whether the samples are real
    :param rx: numbers of the radar's RX on its board, from 1; empty for all
    """

    radar: Radar
    real: bool = False
    rx: tuple[int, ...] = ()


def load_capture_radar(path_of_radar: str, board: str | None, mirror: bool = False) -> CaptureRadar:
    """The radar of a TOML file, or of a ``.cfg`` of the mmWave SDK, with what its captures are.

    :param board: that the file describes the chirps of, in place of the file's own
    :raises InputError: as :func:`load_radar`
    """
    path = Path(path_of_radar)
    if not path.is_file():
        preset = path_of_radar in PRESETS
        problem = (
            f"{path_of_radar!r} is a preset, which describes no capture" if preset else f"no file {path_of_radar!r}"
        )
        expected = "a TOML file with a table [capture], or a .cfg of the mmWave SDK: docs/captures.md"
        raise InputError("--radar", problem, expected)
    document: dict[str, Any] = {"capture": path.name} if path.suffix == ".cfg" else read_toml(path)
    if board is not None:
        document["board"] = board
    _read_pattern_tables(path, document)
    real, rx = _on_board(path, document, mirror)
    radar = validated(Radar, {"name": path.stem, **document}, path, ABOVE)
    return CaptureRadar(radar, real, rx)


def _on_board(path: Path, document: dict[str, Any], turned: bool) -> tuple[bool, tuple[int, ...]]:
    """Put what ``board``, ``mirror`` and ``capture`` say in place of them; (are samples real, numbers of RX).

    :param turned: mirror once more
    """
    name, mirror, capture = (document.pop(key, None) for key in ABOVE)
    if name is None and mirror is None and capture is None and not turned:
        return False, ()
    for key, value, kind, expected in (
        ("board", name, str, f"one of {list(BOARDS)}"),
        ("mirror", mirror, bool, "true or false"),
        ("capture", capture, (dict, str), "a table of chirps, or the name of a .cfg file"),
    ):
        if value is not None and not isinstance(value, kind):
            raise InputError(path, f"{key} = {value!r}", expected)
    if name is not None and name not in BOARDS:
        raise InputError(path, f"board = {name!r}", f"one of {list(BOARDS)}")
    mirror = bool(mirror) != turned
    if mirror and name is None:
        raise InputError(path, "mirror = true without a board", 'board = "NAME" beside it')
    base = Radar() if name is None else board_radar(name, mirror)
    fields = {"waveform": base.waveform.model_dump(), "front_end": base.front_end.model_dump()}
    rx: tuple[int, ...] = ()
    array, real = base.array, name is not None and BOARDS[name]().profile.real
    if "array" in document:  # its own: its TX take the turns, and a capture chooses of it
        array = validated(Radar, {"array": document["array"]}, path).array
    if capture is not None:
        if isinstance(capture, str):
            profile = read_cfg(path.parent / capture)
        else:
            profile = validated(ChirpProfile, capture, f"{path}: capture")
        try:
            array = profile.array(array)
        except ValueError as error:
            raise InputError(path, f"capture: {error}") from error
        fields["waveform"] = profile.waveform(len(array.tx_m)).model_dump()
        real, rx = profile.real, profile.rx
    document["array"] = array.model_dump()
    for table, values in fields.items():
        given = document.get(table, {})
        document[table] = {**values, **given} if isinstance(given, dict) else given
    return real, rx


class _TableFile(Described):
    """A pattern that is named by the file of its table."""

    kind: Literal["table"]
    file: Annotated[str, Field(min_length=1)]
    outside_gain_dbi: float | None = None


def _read_pattern_tables(path: Path, document: dict[str, Any]) -> None:
    """Put the patterns themselves where the document names their files, relative to the folder of ``path``."""
    front_end = document.get("front_end")
    if not isinstance(front_end, dict):
        return
    for name in ("tx_pattern", "rx_pattern"):
        pattern = front_end.get(name)
        if isinstance(pattern, dict) and "file" in pattern:
            named = validated(_TableFile, pattern, f"{path}: front_end.{name}")
            front_end[name] = read_table(path.parent / named.file, named.outside_gain_dbi)
