"""Options are declared once: names, bounds and texts of command and function are the same; what comes next."""

import inspect
import re
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from datafactory.api.asking import order_of
from datafactory.api.making import render
from datafactory.api.options import OrderOptions, RenderOptions, RunOptions, TraceOptions
from datafactory.cli.app import app
from datafactory.cli.making import next_step, typed
from datafactory.scenes.poses import Pose
from shared.cli.options import asking
from shared.dataset.locations import locate
from shared.physics.errors import InputError
from shared.processes.declared import HEADINGS, Option, Options, common, declared, taking


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(map(int, text.split("x")))


class Drawing(Options, heading="Sampling"):
    count: Annotated[int, Option("How many.", least=1, most=8, there=2)] = 4
    colour: Annotated[str, Option("Which, beside --count.", "Or both.", choices=("red", "blue"))] = "red"
    grid: Annotated[bool, Option("Lines.")] = True
    width: Annotated[float | None, Option("Of a line.", usual=0.5)] = None
    size: Annotated[tuple[int, int], Option("Of the paper.", typed=str, read=_numbers, usual="4,3")] = (4, 3)
    begin: Annotated[int | None, Option("Where.", there=1, otherwise="at the edge")] = None
    told: Annotated[object, Option("Takes lines.", shown=False)] = None


class Many(Options):
    places: Annotated[object, Option("Where.", typed=list[str], several=True)]
    within: Annotated[Path, Option("Of a folder.")]


@taking(Drawing)
def drawn(asked: Drawing) -> Drawing:
    """Draw.

    :returns: what was asked
    """
    return asked


def command() -> tuple[typer.Typer, list[Drawing]]:
    """A command of the group, and what it was called with."""
    seen: list[Drawing] = []
    program = typer.Typer()

    @program.command()
    @asking(Drawing)
    def draw(asked: Drawing, fast: bool = False) -> None:
        """Draw."""
        seen.append(asked)
        assert not fast

    return program, seen


def test_a_function_has_the_names_the_defaults_and_the_texts() -> None:
    parameters = inspect.signature(drawn).parameters
    assert {name: item.default for name, item in parameters.items()} == vars(Drawing())
    assert ":param colour: Which, beside ``count``. Or both.\n" in (drawn.__doc__ or "")
    assert ":param width: Of a line. 0.5 by default.\n" in (drawn.__doc__ or "")
    assert (drawn.__doc__ or "").endswith(":returns: what was asked")
    assert drawn(count=3, grid=False) == Drawing(count=3, grid=False)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"count": 9}, "--count: 9; expected 1 to 8"),
        ({"count": "x"}, "--count: 'x'; expected a whole number, 1 to 8"),
        ({"count": [2]}, "--count: [2]; expected a whole number, 1 to 8"),
        ({"count": 2.5}, "--count: 2.5; expected a whole number, 1 to 8"),
        ({"colour": 5}, "--colour: 5; expected one of red, blue"),
        ({"colour": "blu"}, "--colour: 'blu'; expected one of red, blue; did you mean 'blue'?"),
    ],
)
def test_a_value_is_refused_wherever_it_is_made(given: dict[str, object], message: str) -> None:
    for make in (drawn, Drawing):
        with pytest.raises(InputError) as caught:
            make(**given)  # type: ignore[arg-type]
        assert str(caught.value) == message
    with pytest.raises(TypeError, match=r"^got an unexpected keyword argument 'counts'"):
        drawn(counts=3)  # type: ignore[call-arg]


def test_numbers_of_numpy_are_python_s_own() -> None:
    """They stand in the manifest."""
    made = drawn(count=np.int64(3), width=np.float32(0.25))  # type: ignore[arg-type]
    assert made == Drawing(count=3, width=0.25)
    assert [type(made.count), type(made.width)] == [int, float]


def test_a_number_or_a_text_stays_what_it_is() -> None:
    class Cores(Options):
        cores: Annotated[int | str, Option("How many, or which.")] = 1

    assert [Cores(cores=cores).cores for cores in (2, "all")] == [2, "all"]
    with pytest.raises(InputError, match=r"--cores: 2\.5; expected a whole number or a text"):
        Cores(cores=2.5)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"scenes": 3}, "--scene: 3; expected a path, a name or a Scene, or several"),
        ({"speed": 3.0}, "--speed: 3.0; expected its two ends, as numbers in m/s"),
        ({"speed": (1, 2, 3)}, "--speed: (1, 2, 3); expected its two ends, as numbers in m/s"),
        ({"effects": None}, "--effects: None; expected auto, all, or names of effects"),
        ({"variant": "color"}, "--variant: 'color'; expected set=name, e.g. color=red"),
        (
            {"poses": [Pose((0.0, 0.0, 0.5))], "frames": 5},
            "--frames: beside --poses, which has a frame a pose; expected one of them",
        ),
        (
            {"trajectory": [[Pose((0.0, 0.0, 0.5))]], "frames": 5},
            "--frames: beside --trajectory FILE, which has a frame a pose; expected one of them",
        ),
        ({"poses": [{"position": [0, 0, 1]}]}, "--poses: {'position': [0, 0, 1]}; expected Pose objects, or a file"),
        ({"poses": 5}, "--poses: 5; expected Pose objects, or a file"),
        ({"poses": []}, "--poses: []; expected one pose or more"),
        ({"trajectory": [5]}, "--trajectory: 5; expected Pose objects, or a file"),
        (
            {"trajectory": [Pose((0.0, 0.0, 0.5))]},
            "--trajectory: a pose in place of a track; expected tracks in a list, each a sequence of poses",
        ),
        ({"trajectory": 5}, "--trajectory: 5; expected drives, or files or tracks of poses, one or more"),
        ({"trajectory": []}, "--trajectory: []; expected drives, or files or tracks of poses, one or more"),
        ({"populate": {"cars": 2}}, "--populate: {'cars': 2}; expected text such as 'cars=20,parked=0.6'"),
        ({"targets": [[1.0, 2.0]]}, "--targets: [1.0, 2.0]; expected PointTargets objects, or a file"),
    ],
)
def test_an_order_of_something_else_is_refused_in_one_line(given: dict[str, object], message: str) -> None:
    with pytest.raises(InputError) as caught:
        order_of(OrderOptions(**{"scenes": "tiny.usda"} | given))  # type: ignore[arg-type]
    assert str(caught.value) == message


def test_a_folder_that_is_no_place_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match=r"^None: no place of files; expected a path, or a URI as text"):
        locate(None)  # type: ignore[arg-type]


def test_a_command_hands_on_what_was_stated_and_its_own_defaults() -> None:
    program, seen = command()
    for arguments in ([], ["--count", "4", "--no-grid"], ["--width", "0.5"], ["--size", "2x1", "--begin", "3"]):
        assert CliRunner().invoke(program, arguments).exit_code == 0
    assert seen[:2] == [Drawing(count=2, begin=1), Drawing(count=4, grid=False, begin=1)]
    assert seen[2:] == [Drawing(count=2, width=0.5, begin=1), Drawing(count=2, size=(2, 1), begin=3)]
    page = CliRunner().invoke(program, ["--help"], env={"COLUMNS": "120", "TERM": "dumb"}).output
    assert re.search(r"--size .* Of the paper. \[default: 4,3\]", page)
    assert re.search(r"--begin .* Where. \[default: \(at the edge\)\]", page)
    assert CliRunner().invoke(program, ["--count", "9"]).exit_code == 2
    assert CliRunner().invoke(program, ["--told", "x"]).exit_code == 2


@pytest.mark.parametrize(
    ("shard", "step"),
    [
        (None, "look:  'a b/c'"),
        ("0/2", "next:  datafactory merge 'a b/c' --out ANOTHER_FOLDER, once all jobs are done"),
    ],
)
def test_commands_to_come_are_typed_as_a_shell_takes_them(
    shard: str | None, step: str, capsys: pytest.CaptureFixture[str]
) -> None:
    next_step(RunOptions("a b/c", shard=shard), f"look:  {typed('a b/c')}")
    assert capsys.readouterr().out == f"{step}\n"


def test_groups_share_what_they_have_in_common() -> None:
    traced = TraceOptions("tiny.usda", "out", rays=7, radar="iwr1843")
    assert common(OrderOptions, traced) == OrderOptions("tiny.usda", rays=7, radar="iwr1843")


def test_help_begins_with_what_a_newcomer_needs() -> None:
    page = CliRunner().invoke(app, ["render", "--help"], env={"COLUMNS": "120", "TERM": "dumb"}).output
    titles = ["Options", *HEADINGS[1:]]
    places = [page.index(f"─ {title} ─") for title in titles]
    assert places == sorted(places)
    needed = {item.flag for item in declared(RenderOptions) if item.option.first}
    shown = re.findall(r"^│[ *]+(--[a-z-]+) ", page[: places[1]], re.MULTILINE)
    assert set(shown) == needed | {"--dry-run", "--verbose", "--help"}
    assert len(needed) == 8
    assert {item.name for item in declared(RenderOptions)} == set(inspect.signature(render).parameters)


@pytest.mark.parametrize("out", ["", "~", "~/data", Path("~/data")])
def test_no_run_goes_where_nobody_meant_it_to(out: str | Path) -> None:
    """The text of a variable that is not set was the current folder, and a ~ that no shell replaced a name."""
    with pytest.raises(InputError, match=r"^--out: '.*(not empty|without ~)$"):
        RenderOptions("scene.usda", out=out)
    assert RenderOptions(["a~.usda", "~b.usda"], out="data~").out == "data~"


@pytest.mark.parametrize("given", ["here", ["here"], Path("here"), np.array([1.5])], ids=str)
def test_a_lone_value_is_taken_for_several(given: object) -> None:
    one = given if isinstance(given, str | Path) else given[0]  # type: ignore[index]
    many = Many(places=given, within="folder")  # type: ignore[arg-type]
    assert many.places == (one,)
    assert many.within == Path("folder")
    with pytest.raises(InputError, match=r"^--within: 5; expected a path$"):
        Many(places=given, within=5)  # type: ignore[arg-type]
