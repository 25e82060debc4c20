"""Every command of README and the manual exists, and those of the guides are run, as they stand in the text.

They are run in an empty folder that has what the text supposes: the repository's scenes and examples, a scene, poses
and radar files of the reader's own. Their numbers are made smaller by options that follow those of the text.
"""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import ended
from manual import DOCS, PAGES, ROOT, Command, blocks, commands, name_of
from pages import GUIDES
from typer.main import get_command

from datafactory import merge
from datafactory.cli.app import app as datafactory
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import read_poses
from shared.radar.loading import load_capture_radar
from trainer.cli.app import app as trainer

GROUPS: dict[str, Any] = {"datafactory": get_command(datafactory), "trainer": get_command(trainer)}
FOLLOWED = [ROOT / "README.md", *(DOCS / name for name in GUIDES)]

SMALLER = {
    "datafactory render": ["--rays", "2000", "--effects", "all", "--workers", "1"],
    "datafactory trace": ["--rays", "2000", "--effects", "all", "--workers", "1"],
    "datafactory plan": ["--frames", "1", "--rays", "2000", "--no-times"],
    "datafactory points": ["--workers", "1"],
    "datafactory inspect": [],
    "datafactory convert": [],
    "datafactory city": ["--blocks", "1"],
    "trainer fit": [
        "--steps", "2", "--rows", "16", "--points", "0", "--batch", "1", "--validate-every", "2", "--width", "4",
    ],
    "trainer predict": ["--no-pictures"],
}  # fmt: skip
"""Options after those of the text, by command."""
OF_STORED_PATHS = ["--effects", "all", "--workers", "1"]
"""In place of those of ``render``: rays were settled by the trace."""
FEWER_FRAMES = {"datafactory render": "2", "datafactory trace": "2", "datafactory points": "8"}
"""In place of what the text gives ``--frames``."""
SMALLER_PYTHON = {
    "scenes/street.usda": "scenes/tiny.usda",
    "plan(scene, radar=radar)": "plan(scene, radar=radar, frames=1, rays=2_000)",
    "frames=8, rays=20_000": "frames=8, rays=2_000",
}
"""In place of what stands in a page's Python."""

NOT_RUN = {
    "make setup": "minutes, and a package index; continuous integration begins with it",
    "make dataset": "minutes; the same commands are run here on smaller scenes",
    "make smoke": "continuous integration's first look; the same commands are run here",
    "make accuracy": "minutes; tests/datafactory/accuracy runs the command on a small scene",
    "make docs": "tests/documentation/test_help.py builds the site",
    "make test": "it is what runs this",
    "make test-all": "it is what runs this",
    "make study": "hours",
    "python3 -m venv .venv": "makes the environment that this runs in",
    ".venv/bin/python -m pip install torch==2.13.0 --index-url https://download.pytorch.org/whl/cpu": "a package index",
    ".venv/bin/trainer fit build/mine --array full --out build/run": "the README's, with another folder",
    ".venv/bin/trainer fit build/dataset --model spectral-unet --steps 600 --out build/run": "the README's",
    ".venv/bin/datafactory doctor": "its exit status is the machine's; tests/datafactory/inspection runs it",
}
"""Commands of blocks, with the reason."""
HARDWARE = (
    "a capture of the reader's board; tests/trainer/cli/test_captures_cli.py runs these commands on simulated ones"
)
REFERENCE = "the reference captures; tests/trainer/evaluation/test_measured.py runs it where they are"
VIEWED = "tests of datafactory/view run it, and open its page in a browser"
NOT_RUN_PAGES = {"docs/view.md": VIEWED, "docs/captures.md": HARDWARE, "docs/measured.md": REFERENCE}
"""Pages whose commands need what only some machines have."""

DONE: dict[str, str] = {}
"""Commands that were run, and the page that they stood on."""

BLOCKS = [command for page in FOLLOWED for command in commands(page) if command.in_block]
EVERY = [command for page in PAGES for command in commands(page)]


def label(command: Command) -> str:
    return f"{command.page}: {command.text}"


@pytest.mark.parametrize("command", EVERY, ids=label)
def test_what_is_named_exists(command: Command) -> None:
    """Targets, files, modules, commands, options; of commands that are to be typed the values as well."""
    program, *arguments = command.words
    if program == "make":
        target = next(word for word in arguments if not word.startswith("-") and "=" not in word)
        assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M), target
    elif program in GROUPS:
        _parse(program, arguments, whole=command.in_block)
    elif arguments[:1] == ["-m"]:
        assert importlib.util.find_spec(arguments[1]) is not None
    else:
        for word in arguments:
            if word.endswith(".py") or word.startswith("tests/"):
                assert (ROOT / word).exists(), word


def _parse(program: str, arguments: list[str], whole: bool) -> None:
    """As the command line itself would, without running.

    :param whole: otherwise values may be names for what a reader puts there, and only options are compared
    """
    name, *others = arguments
    known = GROUPS[program].commands
    assert name in known or name in ("--help", "--version", "--install-completion"), f"{program} has no command {name}"
    if name not in known:
        return
    options = {option for parameter in known[name].params for option in (*parameter.opts, *parameter.secondary_opts)}
    for word in others:
        if word.strip("[]").startswith("--") and word != "--":
            assert word.strip("[]").partition("=")[0] in options | {"--help"}, f"{program} {name} has no {word}"
    if whole:
        known[name].make_context(name, others)


@pytest.mark.parametrize("command", BLOCKS, ids=label)
def test_a_command_of_a_guide_is_run_or_there_is_a_reason(command: Command) -> None:
    if command.page in NOT_RUN_PAGES or command.text in NOT_RUN:
        return
    kind = " ".join(command.words[:2])
    tested = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests/examples").glob("test_*.py"))
    script = command.words[0] == "python" and command.words[1].startswith("examples/")
    assert kind in SMALLER or (script and Path(command.words[1]).stem in tested)


def test_every_exception_is_still_there() -> None:
    written = {command.text for command in EVERY}
    assert set(NOT_RUN) <= written
    assert set(NOT_RUN_PAGES) <= {command.page for command in BLOCKS}
    programs = "".join(block for page in FOLLOWED for block in blocks(page, "python"))
    assert all(theirs in programs for theirs in SMALLER_PYTHON)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A reader's folder: the repository's scenes and manual, files of the reader's own, a dataset."""
    folder = tmp_path_factory.mktemp("reader")
    for name in ("scenes", "docs", "examples"):
        (folder / name).symlink_to(ROOT / name)
    shutil.copy(ROOT / "scenes/tiny.usda", folder / "YOUR_SCENE.usd")
    (poses,) = blocks(DOCS / "own-scene.md", "json")
    (folder / "poses.json").write_text(poses, encoding="utf-8")
    (materials,) = blocks(DOCS / "own-scene.md", "toml")
    (folder / "materials.toml").write_text(materials, encoding="utf-8")
    (folder / "radar.toml").write_text(blocks(DOCS / "own-radar.md", "toml")[0], encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert ended("datafactory", "points", "--frames", 8, "--workers", 1, "--out", "build/dataset")[0] == 0
    yield folder
    shutil.rmtree(folder)


@pytest.mark.slow
@pytest.mark.parametrize("page", FOLLOWED, ids=name_of)
def test_a_reader_follows_the_page(page: Path, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its commands one after the other, each once in all pages, and its Python."""
    if name_of(page) in NOT_RUN_PAGES:
        pytest.skip(NOT_RUN_PAGES[name_of(page)])
    monkeypatch.chdir(place)
    for command in (command for command in BLOCKS if command.page == name_of(page)):
        program, *arguments = command.words
        kind = f"{program} {arguments[0]}"
        if command.text in NOT_RUN | DONE or kind not in SMALLER:
            continue
        DONE[command.text] = command.page
        if "--out" in arguments:  # pages may write into the same folder
            written = Path(arguments[arguments.index("--out") + 1])
            if written.is_dir():
                shutil.rmtree(written)
            written.parent.mkdir(exist_ok=True)
        smaller = [*arguments, *(OF_STORED_PATHS if "--paths" in arguments else SMALLER[kind])]
        if "--frames" in arguments:
            smaller += ["--frames", FEWER_FRAMES.get(kind, "2")]
        code, _, said = ended(program, *smaller)
        assert code == 0, f"{command.text}: {said}"
    for block in blocks(page, "python"):
        for theirs, ours in SMALLER_PYTHON.items():
            block = block.replace(theirs, ours)
        exec(compile(block, name_of(page), "exec"), {"__name__": "__main__"})


@pytest.mark.slow
def test_the_lines_of_one_path_run(monkeypatch: pytest.MonkeyPatch, variant: str) -> None:
    monkeypatch.chdir(ROOT)
    names: dict[str, Any] = {}
    (block,) = blocks(DOCS / "notes" / "one-path.md", "python")
    exec(compile(block, "docs/notes/one-path.md", "exec"), names)
    assert len(names["frames"]) == 1


PATTERN = "azimuth_deg,elevation_deg,gain_dbi\n" + "".join(
    f"{azimuth},{elevation},0\n" for azimuth in (-180, 0, 180) for elevation in (-90, 0, 90)
)
TOML = [(page, block) for page in PAGES for block in blocks(page, "toml")]


@pytest.mark.parametrize(("page", "block"), TOML, ids=[f"{name_of(page)}-{n}" for n, (page, _) in enumerate(TOML)])
def test_a_file_of_the_text_is_read(page: Path, block: str, tmp_path: Path) -> None:
    """Radars, captures and materials: a field that is renamed fails here."""
    path = tmp_path / "file.toml"
    path.write_text(block, encoding="utf-8")
    (tmp_path / "pattern.csv").write_text(PATTERN, encoding="utf-8")
    if "[material" in block:
        load_materials(path)
    elif ".cfg" in block:
        pytest.skip("a configuration of the reader's board; tests/shared/radar/test_radar.py reads one")
    else:
        own_board = re.search(r"^board|^\[capture\]", block, re.M) is None or "board" in block
        load_capture_radar(str(path), None if own_board else "iwr1843")


def test_poses_of_the_text_are_poses(tmp_path: Path) -> None:
    found = [block for page in PAGES for block in blocks(page, "json")]
    assert found
    for block in found:
        (tmp_path / "poses.json").write_text(block, encoding="utf-8")
        assert len(read_poses(tmp_path / "poses.json")) == 1


SMALLER_JOBS = {
    "scenes/street.usda": str(ROOT / "scenes/tiny.usda"),
    "--frames 18500": "--frames 14 --rays 500 --effects specular,diffuse --workers 1",
    "$SLURM_ARRAY_TASK_ID/16": "$SLURM_ARRAY_TASK_ID/2",
    "srun .venv/bin/datafactory": f"{sys.executable} -m datafactory",
}


@pytest.mark.slow
def test_the_jobs_of_the_batch_script_merge(tmp_path: Path) -> None:
    """As it stands but for its size, under a stand-in for Slurm."""
    (text,) = blocks(DOCS / "large-runs.md", "bash")
    assert "#SBATCH --array=0-15\n" in text
    for theirs, ours in SMALLER_JOBS.items():
        assert theirs in text
        text = text.replace(theirs, ours)
    (tmp_path / "jobs.sh").write_text(text, encoding="utf-8")
    for task in ("1", "0", "0"):  # one of them is put back into the queue
        done = subprocess.run(
            ["bash", "jobs.sh"], cwd=tmp_path, env={**os.environ, "SLURM_ARRAY_TASK_ID": task},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr[-800:]
    assert merge(tmp_path / "build/jobs", tmp_path / "build/dataset").frames == 14
