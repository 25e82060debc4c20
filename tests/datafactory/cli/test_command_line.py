"""``datafactory`` as a command: its help, and what it says when it is interrupted."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import pytest
from factory_command import ended, refused
from typer.main import get_params_from_function
from typer.testing import CliRunner

from datafactory.cli.app import app
from datafactory.cli.console import plain_console, table
from datafactory.inspection.doctor import Finding
from datafactory.run.counts import MEANINGS, told

SCENES = Path(__file__).parents[3] / "scenes"
COMMANDS = sorted(info.callback.__name__ for info in app.registered_commands if info.callback)


def interrupted() -> None:
    raise KeyboardInterrupt


def test_an_interrupted_command_says_how_to_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """As typer hands it on, which swallows Ctrl-C of its own accord."""
    monkeypatch.setattr("datafactory.inspection.doctor.examine", interrupted)
    status, _, line = ended("doctor")
    assert status == 130
    assert line == "datafactory: interrupted; what was finished is kept: the same command with --resume goes on\n"


SEED = "123456789012345678901234567890"
SMALL = "[waveform]\nsamples = 4\nchirps = 2\n"


@pytest.mark.parametrize(
    ("arguments", "text", "message"),
    [
        (["points", "--seed", SEED], "", "Invalid value for '--seed': Input should be less than or equal to"),
        (["trace", "--scene", "x.usda", "--seed", SEED], "", "Invalid value for '--seed': Input should be less than"),
        (["points", "--radar", "RADAR"], "[grid]\nbins = 10000000", "RADAR: grid.bins = 10000000; expected"),
        (["render", "shipped:tiny", "--materials", "RADAR"], "[glass", "RADAR: malformed TOML"),
        (
            ["points", "--radar", "RADAR", "--workers", "1"], f"{SMALL}range_bins = 2",
            "--radar: waveform.range_bins = 2 leaves no room for random close targets; expected at least 3",
        ),
    ],
)  # fmt: skip
def test_what_no_machine_or_file_holds_is_one_line(
    tmp_path: Path, arguments: list[str], text: str, message: str
) -> None:
    path = tmp_path / "radar.toml"
    path.write_text(text, encoding="utf-8")
    given = [str(path) if word == "RADAR" else word for word in arguments]
    line = refused(*given, "--out", tmp_path / "out")
    assert line.startswith(f"datafactory: {message.replace('RADAR', str(path))}")


def test_a_virtual_sensor_of_one_element_has_no_lobe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor have elements that stand in one place: what is said of the truth's lobe is null."""
    one = "[virtual_sensor]\ntx_m = [[0.0, 0.0, 0.0]]\nrx_m = [[0.0, 0.0, 0.0]"
    for number, more in enumerate(("]\n", ", [0.0, 0.0, 0.0]]\n")):
        (tmp_path / "radar.toml").write_text(f"{SMALL}range_bins = 4\n[grid]\nbins = 5\n{one}{more}", encoding="utf-8")
        out = tmp_path / f"out{number}"
        arguments = ["points", "--frames", "1", "--radar", str(tmp_path / "radar.toml"), "--out", str(out)]
        assert CliRunner().invoke(app, [*arguments, "--workers", "1"], catch_exceptions=False).exit_code == 0
        assert json.loads((out / "manifest.json").read_text(encoding="utf-8"))["truth"]["width_u"] is None


def written_help(command: str) -> list[str]:
    """The help texts of a command's options as its module writes them."""
    (info,) = (info for info in app.registered_commands if info.callback and info.callback.__name__ == command)
    assert info.callback is not None
    declared = (parameter.default for parameter in get_params_from_function(info.callback).values())
    return [option.help for option in declared if getattr(option, "help", None)]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_every_text_as_it_is_written(command: str) -> None:
    result = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "400", "TERM": "dumb"})
    assert result.exit_code == 0
    for text in written_help(command):
        assert text in result.output


def test_some_help_states_a_unit() -> None:
    assert "[dB]" in " ".join(text for command in COMMANDS for text in written_help(command))


def test_tables_and_lines_show_square_brackets_and_colons(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    names = ["/World/Cars[0]", "[bold]street[/bold]", "a:smile:b", "[/x]", "a" * 80]
    console = plain_console()
    console.print(table("[dB]", ("[/] name", "loss [dB]"), [(name, "-3.0") for name in names]))
    console.print("wrote [0]/[dB] :smile:")
    printed = capsys.readouterr().out
    for part in ("[/] name", "loss [dB]", *names[:-1], "wrote [0]/[dB] :smile:"):
        assert part in printed
    assert printed.count("a") >= 80  # a long name continues on the next line
    assert re.search(r"-3.0 │$", printed, re.MULTILINE)  # numbers stand on the right
    assert max(map(len, printed.splitlines())) == 60


def test_the_version_is_that_of_the_distribution() -> None:
    result = CliRunner().invoke(app, ["--version"])
    assert (result.exit_code, result.output) == (0, f"datafactory {version('sparseradar-datafactory')}\n")


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["rendr"], "'render'"),
        (["render", "--sceen", "x.usda"], "--scene"),
        (["points", "--radar", "avr-qdm-111", "--out", "x"], "'avr-qdm-110'"),
        (["plan", "sionna:munch"], "'munich'"),
        (["plan", str(SCENES / "tine.usda")], "'tiny.usda'"),
        (["points", "--store", "cub", "--out", "x"], "'cube'"),
        (["render", str(SCENES / "tiny.usda"), "--effects", "difuse", "--out", "x"], "'diffuse'"),
    ],
)
def test_a_slip_of_the_pen_is_answered_with_what_was_meant(arguments: list[str], meant: str) -> None:
    line = refused(*arguments)
    assert re.search(rf"([Dd]id you mean|Possible options:.*) {re.escape(meant)}", line), line


def test_doctor_as_json_holds_the_findings(monkeypatch: pytest.MonkeyPatch) -> None:
    finding = Finding("LLVM", "15 [old]", False, "pip install", required=True)
    monkeypatch.setattr("datafactory.inspection.doctor.examine", lambda: [finding])
    result = CliRunner().invoke(app, ["doctor", "--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout) == [asdict(finding)]


def test_counts_are_told_in_words_where_they_are_asked_for() -> None:
    counts = {"frames": 2, "rays": 100, "truncated": 1, "mirrors_hidden": 0, "frames_with_noise": 2, "new_count": 7}
    effects = "effects simulated: in 2 frames noise; never corners"
    counts["frames_with_corners"] = 0
    assert told(counts, verbose=False) == [f"1 {MEANINGS['truncated']}", effects]
    assert told(counts, verbose=True) == ["100 rays sent", f"1 {MEANINGS['truncated']}", "7 new count", effects]
