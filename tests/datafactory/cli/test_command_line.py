"""``datafactory`` as a command: its help, and what it says when it is interrupted."""

import re
from importlib.metadata import version
from pathlib import Path

import pytest
from command_line import ended
from factory_command import refused
from prepared_scenes import EFFECT_SCENES, SCENES
from typer.main import get_params_from_function
from typer.testing import CliRunner

from datafactory.cli.app import app
from datafactory.inspection.dataset import MEANINGS, told
from shared.cli.console import plain_console, table
from shared.dataset.folder import read_manifest

COMMANDS = sorted(info.callback.__name__ for info in app.registered_commands if info.callback)


def interrupted(**_: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("work", "arguments", "advice"),
    [
        ("datafactory.api.making.merge", ("merge", "jobs", "--out", "whole"),
         "what was finished is kept: the same command with --resume goes on"),
        ("datafactory.inspection.doctor.examine", ("doctor",), "it has no --resume: run it again"),
    ],
)  # fmt: skip
def test_an_interrupted_command_says_how_to_go_on(
    monkeypatch: pytest.MonkeyPatch, work: str, arguments: tuple[str, ...], advice: str
) -> None:
    """As typer hands it on, which swallows Ctrl-C of its own accord."""
    monkeypatch.setattr(work, interrupted)
    status, _, line = ended("datafactory", *arguments)
    assert (status, line) == (130, f"datafactory: interrupted; {advice}\n")


SEED = "123456789012345678901234567890"
SMALL = "[waveform]\nsamples = 4\nchirps = 2\n"
POSES = str(EFFECT_SCENES / "wall.poses.json")
TINY = ("render", "shipped:tiny")
REFUSED = [
    (("render",), "--scene: missing; expected a scene file or sionna:NAME, or --paths"),
    ((*TINY, "--paths", "x"), "--scene: given together with --paths; expected either --scene or --paths"),
    ((*TINY, "--frames", "0"), "--frames: 0 and --points 0: nothing to render; expected at least one frame"),
    ((*TINY, "--device", "cdua"), "--device: 'cdua'; expected one of auto, cpu, cuda; did you mean 'cuda'"),
    ((*TINY, "--poses", "nowhere.json"), "nowhere.json: cannot be read"),
    ((*TINY, "--materials", "nowhere.toml"), "nowhere.toml: "),
    (("render", "none.usda"), "none.usda: no such file"),
    (("render", str(SCENES)), f"{SCENES}: no such file: it is a folder; expected a scene file"),
    (("render", "--scene", ""), "--scene: ''; expected a text that is not empty"),
    ((*TINY, "--frames", "0", "--points", "2"), "--scene: beside --frames 0, which makes none of it; expected one of"),
    ((*TINY, "--scene", "~/x.usda"), "--scene: '~/x.usda': ~ was not replaced by the home folder; expected the path"),
    ((*TINY, "--materials", "~/x.toml"), "--materials: '~/x.toml': ~ was not replaced by the home folder"),
    ((*TINY, "--frame-rate", "5"), "--frame-rate: without --trajectory"),
    ((*TINY, "--trajectory", "none.csv"), "none.csv: cannot be read: No such file"),
    ((*TINY, "--trajectory", "drive", "--trajectory", "a.csv"), "--trajectory: 'drive' beside others"),
    ((*TINY, "--trajectory", "drive", "--frames", "0"), "--frames: 0 and --points 0: nothing to render"),
    ((*TINY, "--trajectory", "drive", "--frame-rate", "0"), "--frame-rate: 0.0; expected 0.001 to 100000 Hz"),
    ((*TINY, "--speed", "20"), "--speed: '20'; expected A:B in m/s, e.g. 0:20"),
    ((*TINY, "--speed", "20:5"), "--speed: 20:5; expected A:B with 0 <= A <= B <= 100 m/s"),
    ((*TINY, "--speed", "0:nan"), "--speed: 0:nan; expected A:B with 0 <= A <= B <= 100 m/s"),
    ((*TINY, "--speed", "0:5", "--poses", POSES), "--speed: beside --poses, which states them; expected one of them"),
    ((*TINY, "--speed", "0:5", "--trajectory", "drive:speed=5"), "--speed: beside --trajectory drive:speed=, which"),
    *(
        (("render", "--paths", "x", *given), f"{given[0]}: beside --paths: the trace has settled it; expected --paths")
        for given in (
            ("--variant", "a=b"),
            ("--allow-missing",),
            ("--frames", "0"),
            ("--materials", "x"),
            ("--poses", POSES),
            ("--frames", "8"),
            ("--trajectory", "drive"),
            ("--speed", "0:5"),
            ("--rays", "50000"),
            ("--depth", "3"),
        )
    ),
    (("points", "--seed", SEED), "Invalid value for '--seed': Input should be less than or equal to"),
    (("trace", "--scene", "x.usda", "--seed", SEED), "Invalid value for '--seed': Input should be less than"),
]
"""What no file of ours is asked for, and the line."""
FILES = [
    (("points", "--radar"), "[grid]\nbins = 10000000", "FILE: grid.bins = 10000000; expected"),
    (("points", "--workers", "1", "--radar"), f"{SMALL}range_bins = 2", "--radar: waveform.range_bins = 2 leaves no"),
]
"""What is asked of a file, its text, and the line."""


@pytest.mark.parametrize(("arguments", "text", "message"), [*((given, "", said) for given, said in REFUSED), *FILES])
def test_what_cannot_be_is_one_line_and_nothing_is_written(
    tmp_path: Path, arguments: tuple[str, ...], text: str, message: str
) -> None:
    path, out = tmp_path / "file.toml", tmp_path / "out"
    path.write_text(text, encoding="utf-8")
    line = refused(*arguments, *([path] if text else []), "--out", out)
    assert line.startswith(f"datafactory: {message.replace('FILE', str(path))}")
    assert not out.exists()


def test_a_run_that_was_refused_leaves_no_bar_behind(tmp_path: Path) -> None:
    assert ended("datafactory", "render", "none.usda", "--out", tmp_path / "out")[:2] == (2, "\n")


@pytest.mark.parametrize("command", ["plan", "accuracy"])
def test_a_file_or_no_name_in_place_of_a_folder_is_refused_before_any_work(command: str, tmp_path: Path) -> None:
    assert refused(command, "none.usda", "--out", "").startswith("datafactory: --out: ''; expected a text that is")
    (tmp_path / "file").write_text("kept", encoding="utf-8")
    for out in (tmp_path / "file", tmp_path / "file" / "folder"):
        line = refused(command, "none.usda", "--out", out)
        assert line == f"datafactory: --out: {tmp_path / 'file'} is a file; expected a folder\n"
    assert (tmp_path / "file").read_text(encoding="utf-8") == "kept"


def test_a_virtual_sensor_of_one_element_has_no_lobe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor have elements that stand in one place: what is said of the truth's lobe is null."""
    one = "[virtual_sensor]\ntx_m = [[0.0, 0.0, 0.0]]\nrx_m = [[0.0, 0.0, 0.0]"
    for number, more in enumerate(("]\n", ", [0.0, 0.0, 0.0]]\n")):
        (tmp_path / "radar.toml").write_text(f"{SMALL}range_bins = 4\n[grid]\nbins = 5\n{one}{more}", encoding="utf-8")
        out = tmp_path / f"out{number}"
        arguments = ["points", "--frames", "1", "--radar", str(tmp_path / "radar.toml"), "--out", str(out)]
        assert CliRunner().invoke(app, [*arguments, "--workers", "1"], catch_exceptions=False).exit_code == 0
        assert read_manifest(out)["truth"]["width_u"] is None


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
    texts = written_help(command)
    assert all(text in result.output for text in texts)
    assert command != "plan" or "[dB]" in " ".join(texts)  # Rich would take it for markup


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
    assert ended("datafactory", "--version")[:2] == (0, f"datafactory {version('sparseradar-datafactory')}\n")


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["rendr"], "'render'"),
        (["render", "--sceen", "x.usda"], "--scene"),
        (["points", "--radar", "avr-qdm-111", "--out", "x"], "'avr-qdm-110'"),
        (["plan", "sionna:munch"], "'munich'"),
        (["plan", str(SCENES / "tine.usda")], "'tiny.usda'"),
        (["points", "--store", "cub", "--out", "x"], "'cube'"),
        (["render", str(TINY), "--effects", "difuse", "--out", "x"], "'diffuse'"),
    ],
)
def test_a_slip_of_the_pen_is_answered_with_what_was_meant(arguments: list[str], meant: str) -> None:
    line = refused(*arguments)
    assert re.search(rf"([Dd]id you mean|Possible options:.*) {re.escape(meant)}", line), line


def test_counts_are_told_in_words_where_they_are_asked_for() -> None:
    counts = {"frames": 2, "rays": 100, "truncated": 1, "mirrors_hidden": 0, "frames_with_noise": 2, "new_count": 7}
    effects = "effects simulated: in 2 frames noise; in 1 frame doppler; never corners"
    counts |= {"frames_with_corners": 0, "frames_with_doppler": 1}
    assert told(counts, verbose=False) == [f"1 {MEANINGS['truncated']}", effects]
    assert told(counts, verbose=True) == ["100 rays sent", f"1 {MEANINGS['truncated']}", "7 new count", effects]
