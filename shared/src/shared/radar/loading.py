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


def load_radar(name_or_path: str | Path) -> Radar:
    """A preset by name, or a TOML file with the tables ``waveform``, ``array``, ``front_end``, ``grid``.

    The file states only what differs from the default radar, or from ``board = "NAME"``. ``mirror = true`` exchanges
    left and right of the board, or of the table ``array``. The table ``capture`` states chirps as
    :class:`shared.radar.profile.ChirpProfile` does; ``capture = "FILE.cfg"`` takes them from a configuration of the
    mmWave SDK beside the file. Either needs ``board`` or ``array``. A pattern may be named by a file beside it:
    ``tx_pattern = { kind = "table", file = "pattern.csv" }``, see :class:`shared.radar.antenna.TablePattern`.

    :raises InputError: an unknown name, an unreadable file, a field or value that the radar does not allow, alone or
        together with others
    """
    name = str(name_or_path)
    if name in PRESETS:
        return PRESETS[name]()
    if not Path(name).is_file():
        problem = f"no preset and no file {name!r}"
        expected = f"a TOML file or one of {list(PRESETS)}{meant(name, PRESETS)}"
        raise InputError("--radar", problem, expected)
    return load_capture_radar(name, None).radar


class CaptureRadar(NamedTuple):
    """A radar, and what its raw captures are.

    :param real: whether the samples are real
    :param rx: numbers of the radar's RX on its board, from 1; empty for all
    :param quadrature_first: whether a configuration of the SDK has Q before I; None where none says
    """

    radar: Radar
    real: bool = False
    rx: tuple[int, ...] = ()
    quadrature_first: bool | None = None


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
    recorded = _on_board(path, document, mirror)
    return CaptureRadar(validated(Radar, {"name": path.stem, **document}, path, ABOVE), *recorded)


def _on_board(path: Path, document: dict[str, Any], turned: bool) -> tuple[bool, tuple[int, ...], bool | None]:
    """Put what ``board``, ``mirror`` and ``capture`` say in place of them, and say what :class:`CaptureRadar` does.

    :param turned: mirror once more
    """
    name, mirror, capture = (document.pop(key, None) for key in ABOVE)
    if name is None and mirror is None and capture is None and not turned:
        return False, (), None
    for key, value, kind, expected in (
        ("board", name, str, f"one of {list(BOARDS)}"),
        ("mirror", mirror, bool, "true or false"),
        ("capture", capture, (dict, str), "a table of chirps, or the name of a .cfg file"),
    ):
        if value is not None and not isinstance(value, kind):
            raise InputError(path, f"{key} = {value!r}", expected)
    if name is not None and name not in BOARDS:
        raise InputError(path, f"board = {name!r}", f"one of {list(BOARDS)}")
    mirror, own = bool(mirror) != turned, "array" in document
    elements = 'board = "NAME" beside it, or a table [array]'
    if mirror and name is None and not own:
        raise InputError(path, "mirror = true without a board", elements)
    base, real = (Radar(), False) if name is None else (board_radar(name), bool(BOARDS[name]().profile.real))
    fields = {"waveform": base.waveform.model_dump(), "front_end": base.front_end.model_dump()}
    # Its own: its TX take the turns, and a capture chooses of it.
    array = validated(Radar, {"array": document["array"]}, path).array if own else base.array
    array = mirrored(array) if mirror else array
    rx: tuple[int, ...] = ()
    quadrature_first = None
    if capture is not None:
        profile, quadrature_first = _profile(path, capture, name, real)
        if name is None and not own:  # a .cfg has no place for either
            expected = f'a radar file with board = "NAME" and capture = "{path.name}"'
            raise InputError(path, "capture without a board", expected if capture == path.name else elements)
        try:
            array = profile.array(array)
        except ValueError as error:
            raise InputError(path, f"capture: {error}") from error
        fields["waveform"] = profile.waveform(len(array.tx_m)).model_dump()
        real, rx = bool(profile.real), profile.rx
    document["array"] = array.model_dump()
    for table, values in fields.items():
        given = document.get(table, {})
        if not isinstance(given, dict):
            continue
        document[table] = {**values, **given}
        samples = given.get("samples")
        if isinstance(samples, int) and "range_bins" not in given:  # no more than before, nor mirror images
            most = max(samples // 2 if real else samples, 1)
            document[table]["range_bins"] = min(values["range_bins"], most)
    return real, rx, quadrature_first


def _profile(
    path: Path, capture: dict[str, Any] | str, board: str | None, real: bool
) -> tuple[ChirpProfile, bool | None]:
    """The chirps that ``capture`` states, and whether Q comes first where it says so.

    :param real: whether the samples of the board are real, which holds where ``capture`` does not say
    :raises InputError: complex samples of a board that records real ones alone
    """
    if isinstance(capture, str):
        source, fault, right = path.parent / capture, "adcCfg asks for complex samples", "adcCfg 2 0"
        profile, quadrature_first = read_cfg(source)
    else:
        source, fault, right = path, "capture.real = False", "true, or no such line"
        profile, quadrature_first = validated(ChirpProfile, capture, f"{path}: capture"), None
    if real and profile.real is False:
        raise InputError(source, fault, f"{right}: board {board!r} records no Q")
    return profile.model_copy(update={"real": real or bool(profile.real)}), quadrature_first


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
