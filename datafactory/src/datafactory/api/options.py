"""The options of commands and functions, each declared here alone: type, default, bounds, choices, help.

A new option is one field of a group: the commands and functions that take the group have it, with its check, its help
and its line in the documentation. See :mod:`shared.processes.declared`. Constants alone: ``--help`` imports this
module.
"""

from collections.abc import Collection, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from datafactory.defaults import (
    ASKED_DEVICES,
    CPU,
    DEFAULT_BUDGET_DB,
    DEFAULT_DEPTH,
    DEFAULT_FRAMES,
    DEFAULT_PATTERN,
    DEFAULT_RAYS,
    ENGINES,
    IMAGE_BATCH,
    LARGEST_BUDGET_DB,
    LARGEST_DEPTH,
    LOCAL,
    MOST_RAYS,
    SMALLEST_BUDGET_DB,
)
from datafactory.scenes.city.rules import MOST_BLOCKS, Style
from shared.processes.declared import Option, Options
from shared.processes.defaults import ANGLE_WINDOWS, DEFAULT_RADAR, LARGEST_SEED, STORES, TRUTH_WINDOW
from shared.processes.telling import TellingOptions

if TYPE_CHECKING:
    from datafactory.frame.points import PointTargets
    from datafactory.scenes.drives import Drives
    from datafactory.scenes.materials.table import MaterialTable
    from datafactory.scenes.poses import Pose
    from datafactory.scenes.scene import Scene
    from datafactory.scenes.traffic.arrange import Asked
    from shared.dataset.locations import Location
    from shared.radar import Radar

FileName: TypeAlias = str | Path
SceneLike: TypeAlias = "str | Path | Scene"
"""A file's path, ``"shipped:NAME"``, ``"sionna:NAME"``, or a scene that was read or built before."""
RadarLike: TypeAlias = "str | Path | Radar"
PosesLike: TypeAlias = "str | Path | Sequence[Pose]"
"""The path of a JSON file, see :func:`datafactory.scenes.poses.read_poses`, or the poses themselves."""
TrajectoryLike: TypeAlias = "str | Path | Drives | Sequence[str | Path | Sequence[Pose]]"
"""The path of a CSV or JSON file, see :func:`datafactory.scenes.tracks.read_track`; several, or the poses of
several tracks, a sequence each; or ``"drive"``, ``"drive:speed=10,seconds=4"`` or what that means, to draw them."""
MaterialsLike: TypeAlias = "str | Path | MaterialTable"
TargetsLike: TypeAlias = "str | Path | Sequence[PointTargets]"
"""The path of a JSON file, see :func:`datafactory.frame.points.read_targets`, or the targets of each frame."""
Effects: TypeAlias = str | Collection[str]


# Not formatted: an option is read as a whole, in two or three lines.
# fmt: off
SCENE = Option("USD, Mitsuba XML or mesh file, or shipped:NAME or sionna:NAME.", "Or a Scene.",
               typed=str, flag="--scene", place="[SCENE]", placed="The scene, in place of --scene.", first=True)
SCENES = replace(SCENE, help=f"{SCENE.help[:-1]}; may be repeated.", typed=list[str], place="[SCENE]...",
                 placed="Scenes, in place of --scene or beside it.", python="One or several, or Scenes.")
FRAMES = Option("Scene frames in total, dealt to the scenes in turn.", least=1, usual=DEFAULT_FRAMES, first=True)
SEED = Option("Dataset seed: same seed, same bytes.", least=0, most=LARGEST_SEED, first=True)
TARGETS = Option("JSON file of exactly these targets: one frame for each inner list.",
                 "Or the targets of each frame; in place of ``points`` drawn ones.", typed=Path)
EFFECTS = Option("auto (what each frame calls for), all, or names separated by commas.", "Or the names.", typed=str)
BUDGET = Option("Choose rays, depth, pruning, tolerance and truth terms for this error [dB], e.g. -30, from a sweep "
                "made once; --rays and --depth stay as given. Without it nothing is swept and the defaults hold.",
                least=SMALLEST_BUDGET_DB, most=LARGEST_BUDGET_DB)
BUDGET_OF_PATHS = replace(BUDGET, help="Choose rays and depth for this error [dB] of the power in a resolution cell of "
                          "this radar, e.g. -30, from a sweep made once; --rays and --depth stay as given.")


class ReadingOptions(Options, heading="Scene"):
    """How scenes are read."""

    variant: Annotated["Sequence[str]", Option(
        "set=name: a variant of the USD scenes; may be repeated.", typed=list[str], several=True)] = ()
    allow_missing: Annotated[bool, Option("Go on without geometry that cannot be opened.")] = False
    populate: Annotated["str | Asked | None", Option(
        "Traffic and street furniture on the free ground, e.g. cars=20,poles=30,parked=0.6; cars=4/100m of road.",
        typed=str, metavar="KIND=N,...", first=True)] = None


class LoadOptions(ReadingOptions):
    source: Annotated["SceneLike", replace(SCENE, python="Or a Scene, to populate.")] = field(kw_only=False)
    seed: Annotated[int, SEED] = 0


class SceneOptions(ReadingOptions):
    """How scenes are read, and what they are made of."""

    materials: Annotated["MaterialsLike | None", Option(
        "TOML file that overrides the material table.", "Or a table.", typed=Path)] = None


class ScenesOptions(SceneOptions):
    """Which scenes, and how they are read."""

    scenes: Annotated["SceneLike | Sequence[SceneLike] | None", SCENES] = field(kw_only=False)


class StoredOptions(Options, heading="Scene"):
    """Paths that were traced before."""

    paths: Annotated["FileName | Location | None", Option(
        "Folder of `datafactory trace`, also by URI, instead of --scene: the same paths again.",
        "Scenes are None beside it.", typed=str, metavar="DIR")] = None


class RadarOptions(Options, heading="Sensor"):
    """What measures."""

    radar: Annotated["RadarLike", Option(
        "A preset or a TOML file.", "Or a Radar.", typed=str, first=True)] = DEFAULT_RADAR


class PosedOptions(RadarOptions):
    """What measures, and from where."""

    poses: Annotated["PosesLike | None", Option(
        "JSON file of sensor poses: one frame a pose, instead of drawn ones.",
        "Or the poses, in the world frame [m, deg, m/s].", typed=Path)] = None


class SensorOptions(PosedOptions):
    """What measures, and along which way."""

    trajectory: Annotated["TrajectoryLike | None", Option(
        "CSV or JSON file of poses with times, a sequence of frames; may be repeated. "
        "Or drive[:speed=M/S][,seconds=S]: drives drawn along the streets, --frames in all.",
        "Or the poses of each sequence; where none of them has a velocity, that of their places.",
        typed=list[str], metavar="FILE|drive")] = None
    frame_rate: Annotated[float | None, Option(
        "Frames a second along a trajectory; by default a frame a row, 10 of drives.")] = None


class DealOptions(Options, heading="Sampling"):
    """How many frames are drawn, from which seed, for which splits."""

    frames: Annotated[int | None, FRAMES] = None
    seed: Annotated[int | None, replace(SEED, usual=0)] = None
    split: Annotated[str | None, Option(
        "Pattern train:validation:test over the frames.", "With ``paths`` that of their trace.",
        usual=DEFAULT_PATTERN)] = None


class SamplingOptions(DealOptions):
    """How many frames are drawn, how fast, and how many rays in each."""

    speed: Annotated["str | tuple[float, float] | None", Option(
        "Speeds of drawn poses and drives, uniform from A to B m/s; without it 0 to 6 of poses, 3 to 15 of drives.",
        "Or both ends.", typed=str, metavar="A:B")] = None

    rays: Annotated[int | None, Option(
        "Rays a frame, over the field of view.", least=1, most=MOST_RAYS, usual=DEFAULT_RAYS)] = None
    depth: Annotated[int | None, Option(
        f"Largest number of bounces. From 2 on, mirrors alone may be {LARGEST_DEPTH}.",
        least=1, most=LARGEST_DEPTH, usual=DEFAULT_DEPTH)] = None


class EffectOptions(Options, heading="Effects and accuracy"):
    """What is simulated, and how exactly."""

    effects: Annotated["Effects", EFFECTS] = "auto"
    error_budget: Annotated[float | None, BUDGET] = None


class SignalOptions(Options, heading="Effects and accuracy"):
    """What is made of paths."""

    noise: Annotated[bool, Option("Add receiver noise.")] = True
    truth_window: Annotated[str, Option(
        "Over the virtual sensor: none, taylor-25, taylor-30 or hann.", choices=ANGLE_WINDOWS)] = TRUTH_WINDOW


class OutputOptions(Options, heading="Output"):
    """What is kept of a frame, and under which licence."""

    store: Annotated[str, Option(
        "range-channel, range-doppler or cube: what else to keep.", choices=STORES)] = STORES[0]
    license: Annotated[str | None, Option(
        "Of the data, an SPDX identifier as CC-BY-4.0, for README.md and the manifest; by default not stated.")] = None


class DeviceOptions(Options, heading="Execution"):
    """On what it is computed."""

    device: Annotated[str, Option(
        "cpu, cuda (an NVIDIA GPU), or auto: cuda where it can be used. The bytes depend on it.",
        "It stands in the manifest, and a run is resumed on the same one alone.", choices=ASKED_DEVICES)] = CPU


class RunOptions(DeviceOptions):
    """Where a run is written, and how it is carried out."""

    out: Annotated["FileName", Option(
        "Folder of the dataset, also s3:// or gs://; new or empty.", "With ``resume`` that of an unfinished run.",
        typed=str, metavar="DIR", first=True)] = field(kw_only=False)
    workers: Annotated[int, Option(
        "Worker processes; 0: one a core if memory is there, one with cuda, of all nodes with --engine ray.",
        "1 works in this process. The bytes do not depend on it.", least=0, there=0, first=True)] = 1
    engine: Annotated[str, Option(
        "local, or ray: a Ray cluster makes the shards. The same bytes.", choices=ENGINES)] = LOCAL
    address: Annotated[str | None, Option(
        "HOST:PORT of the Ray cluster, which this machine is a node of; by default the one that runs here, "
        "else one of the run's own.")] = None
    resume: Annotated[bool, Option("Go on with an unfinished run in the same folder.", first=True)] = False
    keep_going: Annotated[bool, Option("Finish the other shards where three worker processes died of one.")] = False
    shard: Annotated[str | None, Option(
        "Make the shards of job I of N alone, I from 0 to N - 1, into DIR/job-I-of-N; `datafactory merge` joins "
        "the jobs.", metavar="I/N")] = None


# What functions and commands take. Of several groups the last one's options come first.


class OrderOptions(DeviceOptions, OutputOptions, SignalOptions, EffectOptions, SamplingOptions, SensorOptions,
                   StoredOptions, ScenesOptions, heading="Sampling"):
    """What an order is made of."""

    frames: Annotated[int | None, replace(FRAMES, least=0)] = None
    seed: Annotated[int | None, replace(SEED, help=f"{SEED.help} With --paths that of their trace; another one "
                                        "draws other noise.", usual=0)] = None
    points: Annotated[int, Option(
        "Close-target frames to add.", "Without scenes these are None, and ``frames`` 0.", least=0)] = 0
    targets: Annotated["TargetsLike", replace(TARGETS, shown=False)] = ()


class RenderOptions(TellingOptions, RunOptions, OrderOptions, heading="Output"):
    camera: Annotated[bool, Option("Also what a camera at the sensor sees, DIR/camera/frame-NNNNNN.png.",
                                   "One of each scene frame; the shards stay the same.")] = False


class TraceOptions(TellingOptions, RunOptions, EffectOptions, SamplingOptions, SensorOptions, ScenesOptions):
    error_budget: Annotated[float | None, BUDGET_OF_PATHS] = None


class PointsOptions(RunOptions, OutputOptions, SignalOptions, DealOptions, RadarOptions):
    frames: Annotated[int | None, Option(
        "Frames of randomly drawn close targets.", least=1, usual=DEFAULT_FRAMES, first=True)] = None
    targets: Annotated["TargetsLike", TARGETS] = ()


class PlanOptions(TellingOptions, DeviceOptions, SignalOptions, SamplingOptions, PosedOptions, ScenesOptions,
                  heading="Effects and accuracy"):
    error_budget: Annotated[float | None, replace(
        BUDGET, help="What leaving an effect out may cost [dB].", usual=DEFAULT_BUDGET_DB)] = None
    prove: Annotated[bool, Option("Simulate one frame as it decides and with every effect, and compare.")] = False
    times: Annotated[bool, Option("Measure what each effect costs in time.", there=True)] = False


class PlanCommandOptions(PlanOptions):
    out: Annotated[Path | None, Option("Folder for plan.json and plan.png.", first=True)] = None


class ViewOptions(TellingOptions, SamplingOptions, SensorOptions, StoredOptions, SceneOptions, heading="Output"):
    scene: Annotated["SceneLike | None", SCENE] = field(kw_only=False)
    out: Annotated["FileName", Option(
        "The page to write, .html; a browser opens it from disk.", typed=Path, first=True)] = field(kw_only=False)
    frame: Annotated[int, Option("Which frame: of --poses, of --paths, or of the drawn ones.", least=0)] = 0
    effects: Annotated["Effects", EFFECTS] = "all"
    png: Annotated[bool, Option("Also two pictures beside it: from the sensor, and from above.")] = False


class AccuracyOptions(DealOptions, PosedOptions, SceneOptions):
    scene: Annotated["SceneLike | None", SCENE] = None
    out: Annotated[Path, Option("Folder for the tables and the picture.", first=True)]
    frames: Annotated[int, Option("Frames to measure on; --quick takes one.", least=1, most=IMAGE_BATCH)] = 2
    repeats: Annotated[int, Option("Timed runs of each stage and frame.", least=1, most=20)] = 1
    rays: Annotated[int | None, Option(
        "Rays a frame wherever they are not varied; 200000, or 50000 with --quick.", least=1)] = None
    most_rays: Annotated[int | None, Option(
        "Try more rays too, in doublings up to these; the reference has twice as many. More than 800000, or than "
        "200000 with --quick.", least=1)] = None
    quick: Annotated[bool, Option("One frame, fewer settings; for a small scene.")] = False


class CheckOptions(SceneOptions):
    scene: Annotated["SceneLike | None", SCENE] = None
    seed: Annotated[int, SEED] = 0
    json: Annotated[bool, Option("Print the report as JSON and nothing else.", first=True)] = False


class CityOptions(Options):
    out: Annotated[Path, Option("File to write: .usda or .usdc.")]
    seed: Annotated[int, replace(SEED, help="Same seed, same bytes.")] = 0
    blocks: Annotated[int | None, Option(
        "House blocks along the street; 2 without.", least=1, most=MOST_BLOCKS)] = None
    style: Annotated[Style, Option("What the city is like.")] = Style.OLD_TOWN
    opendrive: Annotated[Path | None, Option("Roads, lanes and traffic from an OpenDRIVE file (.xodr).")] = None
    osm: Annotated[Path | None, Option("The same from an OpenStreetMap extract (.osm).")] = None
    centre: Annotated[str | None, Option("x,y of the window's middle in the network [m]; its own without.")] = None
    extent: Annotated[float | None, Option("Side of the window [m]; 300 without.")] = None


class InspectOptions(Options):
    directory: Annotated[str, Option(
        "Folder of a finished dataset, also s3://, gs://, hf:// or https://.", place="DIR", flag=None)]
    verify: Annotated[bool, Option("Check every byte against the manifest's checksums.")] = False
    frames: Annotated[int, Option(
        "Pictures to draw, of frames spread over the dataset; of sequences at most 3.", least=0)] = 4
    out: Annotated[Path | None, Option(
        "Folder of the pictures; by default DIR/pictures, of a remote dataset NAME-pictures in this folder.")] = None
    camera: Annotated[bool, Option(
        "Beside them what a camera sees, from the scenes that the manifest names.")] = False
    json: Annotated[bool, Option("Print the numbers as JSON, and draw nothing.")] = False


class MergeOptions(TellingOptions):
    folders: Annotated["FileName | Sequence[FileName]", Option(
        "The --out of jobs made with --shard, or single jobs' folders.", typed=list[Path], place="DIR...",
        flag=None)] = field(kw_only=False)
    out: Annotated["FileName", Option(
        "Folder of the dataset; new or empty.", typed=str, metavar="DIR")] = field(kw_only=False)
    resume: Annotated[bool, Option("Go on with a merge that was killed.")] = False


class ConvertOptions(TellingOptions):
    directory: Annotated["FileName", Option(
        "Folder of a finished dataset, also s3:// or gs://.", typed=str, place="DIR", flag=None)] = field(kw_only=False)
    to: Annotated[str, Option("mcap: files for Foxglove.")]
    out: Annotated["FileName", Option("Folder to write; it must not exist yet.", typed=Path)] = field(kw_only=False)
# fmt: on
