"""What the trainer's commands refuse: one line that begins with what is wrong, exit status 2, and nothing written.

One table a command; what depends on files of its own stands with the command's other tests.
"""

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from captured_cubes import other_radar, write_capture
from command_line import refused
from numpy.typing import NDArray
from numpy_bytes import npz, of_array
from raw_files import CHIRPS
from small_dataset import make_traced
from tiny_radar import RADAR, frame, small_dataset, tiny, write_dataset
from tiny_run import make_run, run_of

from trainer.run.pretrained import pretrained_run

SHAPE = (RADAR.waveform.chirps, RADAR.waveform.samples, RADAR.array.channels)
RADAR_TOML = "[waveform]\nsamples = 32\nrange_bins = 24\nchirps = 4\n[array]\n" + "".join(
    f"{name} = {json.dumps(getattr(RADAR.array, name))}\n" for name in ("tx_m", "rx_m")
)


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """What the words in brackets of the tables stand for."""
    made = tmp_path_factory.mktemp("refused")
    shorter = RADAR.model_copy(update={"array": RADAR.array.model_copy(update={"rx_m": RADAR.array.rx_m[:5]})})
    longer = RADAR.model_copy(update={"waveform": RADAR.waveform.model_copy(update={"samples": 64, "range_bins": 48})})
    cut = frame(0)
    cut = type(cut)(**{**vars(cut), "range_channel": np.ascontiguousarray(cut.range_channel[..., :5])})
    (made / "file").write_text("mine")
    (made / "there.onnx").write_text("mine")
    (made / "wrong.toml").write_text("steps = 0\n")
    (made / "beta.toml").write_text("beta = 3.0\n")
    (made / "slip.toml").write_text("step = 5\n")
    (made / "broken.toml").write_text("steps =")
    (made / "rx9.toml").write_text("rx = [0, 9]")
    (made / "falling.toml").write_text("rx = [2, 0]")
    (made / "mine.toml").write_text("rx = [0, 1, 2, 5]")
    np.save(made / "pair.npy", np.full((40, 1), 1.0 + 1.0j))
    np.save(made / "array.npy", np.zeros((3, 5), complex))
    np.save(made / "nan.npy", np.full((4, 8, 32), np.nan + 0j))
    (made / "capture.toml").write_text(f'board = "iwr1642"\n[capture]\n{CHIRPS}\n')
    (made / "short.bin").write_bytes(bytes(100))
    (made / "zeros.bin").write_bytes(bytes(2 * 2 * 4 * 2 * 4 * 32))
    (made / "damaged.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    (made / "radar.toml").write_text(RADAR_TOML)
    return {
        "data": small_dataset(made / "data"),
        "other_data": write_dataset(made / "other", {"test": [cut]}, shorter),
        "untested": write_dataset(made / "untested", {"train": [frame(0)], "validation": [frame(1)]}),
        "traced": make_traced(made / "traced"),
        "run": make_run(made / "run"),
        "longer": run_of(made / "longer", longer, tiny()),
        "cube": write_capture(made / "cube.npz", other_radar()),
        "chirps": f"--board iwr1642 --radar {made}/capture.toml",
        "shipped": pretrained_run("sparse6").parent,
        "here": made,
    }


FIT = [
    ("none", "none/manifest.json: no such file"),
    ("ftp://host/set", "ftp://host/set: scheme 'ftp'"),
    ("s3://", "s3://: names no bucket"),
    ("{traced}", "{traced}: holds traced paths and no frames"),
    ("none --model u-net", "trainer fit: model = 'u-net'"),
    ("none --steps 0", "trainer fit: steps = 0"),
    ("none --width 1000000000", "trainer fit: width = 1000000000"),
    ("none --batch 1000000000", "trainer fit: batch = 1000000000"),
    ("none --seed 123456789012345678901234567890", "Invalid value for '--seed'"),
    ("none --target class", "trainer fit: model 'unrolled' answers target 'row'"),
    ("none --features adaptive", "trainer fit: model 'unrolled' and features 'snapshots' belong together"),
    ("none --model spectral-unet --target paper", "trainer fit: target 'paper' is normalised per whole"),
    ("none --model spectral-unet --features paper", "trainer fit: target 'row' needs the scale"),
    ("none --model spectral-unet --features snapshots", "trainer fit: model 'unrolled' and features"),
    ("none --model doa-cnn", "trainer fit: model 'doa-cnn', features 'covariance' and target 'doa' belong"),
    (
        "none --hidden 7",
        "trainer fit: hidden = 7 makes no difference with model 'unrolled'; expected no hidden, or model ",
    ),
    ("none --config {here}/beta.toml", "trainer fit with {here}/beta.toml: beta = 3.0 makes no difference with target"),
    ("none --recipe best", "--recipe: 'best'"),
    ("none --config {here}/wrong.toml", "trainer fit with {here}/wrong.toml: steps = 0"),
    ("none --config {here}/slip.toml", "{here}/slip.toml: unknown field 'step'"),
    ("none --config {here}/broken.toml", "{here}/broken.toml: not readable as TOML"),
    ("none --logger tensorbord", "--logger: 'tensorbord'"),
    ("none --out {here}/file/out", "--out: {here}/file/out: Not a directory"),
    ("{data} --out {here}", "--out: {here} is not empty"),
    ("{data} --resume", "--array: sparse6 uses RX 15"),
    ("{data} --array full --out {here} --resume", "--resume: {here} holds no run"),
    ("{data} --array sparse5", "--array: no named array and no file 'sparse5'; expected a TOML file or one of full, s"),
    ("{data} --array {here}/rx9.toml", "--array: {here}/rx9.toml uses RX 9"),
    ("{data} --array {here}/falling.toml", "{here}/falling.toml: rx = [2, 0]; expected rising"),
    ("{data} --array {here}/broken.toml", "{here}/broken.toml: not readable as TOML"),
    ("{data} --array {here}/slip.toml", "{here}/slip.toml: rx missing"),
    ("{data} --array full --recipe doa", "--array: 6 channels; expected at least 9"),
    ("{data} --array full --width 16000", "network: width = 16000"),
    ("{data} --weight nan", "--weight: nan"),
    ("{data} --weight 0", "--weight: 0.0"),
    ("{data} --weight 1 --weight 2", "--weight: 2 weights for 1 datasets"),
    ("{data} --frames 1", "{data}: no frame"),
    ("{data} --array full --from nothing", "nothing/weights.safetensors: no such file"),
    ("{data} --array full --from {run}", "--from: {run} has width = 4"),
    ("{data} --array full --width 6 --from sparse6", "--from: {shipped}/sparse6 has width = 12"),
]
PREDICT = [
    ("none none", "none: no run.json"),
    ("sparse6 none", "sparse6: no such folder; expected a run folder made by trainer fit, or --pretrained sparse6"),
    ("{run} none", "INPUT: none"),
    ("{run} {here}/array.npy", "--radar: not given"),
    ("{run} {traced}", "{traced}: holds traced paths and no frames"),
    ("{run} {traced} --split all", "{traced}: holds traced paths and no frames"),
    ("{run} {untested}", "{untested}: no frames in split 'test'; expected --split train, validation or all"),
    ("{run} {untested} --split foo", "{untested}: no frames in split 'foo'; expected --split train, validation or all"),
    ("{run} {other_data}", "{other_data}: radar 'tiny', array.rx_m = 5 positions"),
    ("none none --out {here}/file/out", "--out: {here}/file/out: Not a directory"),
    ("{run} {data} --out {here}", "--out: {here} is not empty"),
    ("{run} {cube} --method iaa", "arguments: 2 paths"),
    ("{cube}", "arguments: 1 paths"),
    ("{cube} --method capon", "--method: 'capon'"),
    ("{cube} --method iaa --pretrained sparse6", "--method: 'iaa' beside --pretrained sparse6"),
    ("{cube} --pretrained sparse7", "--pretrained: 'sparse7'"),
    ("{cube} --pretrained sparse6", "{cube}: radar 'other' differs from 'avr-qdm-110'"),
    ("{run} {data} --points --points-format las", "--points-format: 'las'"),
    ("{run} {data} --points-format csv", "--points-format: 'csv' without --points"),
    ("{run} {data} --animation", "--animation: without --points"),
    ("{run} {data} --cells all", "--cells, --false-alarms: without --points"),
    ("{run} {data} --points --cells all", "--cells: 'all' of {data}, which holds no cubes"),
    ("{run} {data} --points --cells some", "--cells: 'some'"),
    ("{run} {data} --points --false-alarms nan", "--false-alarms: nan"),
    ("{run} {data} --points --false-alarms 0", "--false-alarms: 0.0"),
    ("{run} {data} --points --false-alarms 1e-300", "--false-alarms: 1e-300; expected a finite number of at"),
    ("{run} {cube} --split train", "--split: 'train' beside a cube; expected no --split: all frames of {cube} are"),
    ("{run} {cube} --split test", "--split: 'test' beside a cube"),
    ("{cube} --method iaa --velocity fast", "--velocity: 'fast'"),
    ("{cube} --method iaa --velocity 1,2,3", "--velocity: '1,2,3'"),
    ("{cube} --method iaa --velocity nan,0", "--velocity: (nan, 0.0), yaw 0.0"),
    ("{cube} --method iaa --mounting-yaw 30", "--mounting-yaw: without --velocity"),
    ("{cube} --method iaa --velocity 3,0", "--velocity: without --points, and 'iaa' uses no velocity"),
    ("{run} {data} --velocity 3,0", "--velocity: without --points, and 'unrolled' uses no velocity"),
    ("{cube} --method iaa --radar {here}/radar.toml", "--radar: '{here}/radar.toml' beside a .npz; expected no"),
]
EXPORT = [
    ("none --out o.onnx", "none: no run.json"),
    ("{run} --out {here}/there.onnx", "--out: {here}/there.onnx is there already"),
    ("{run} --out network.pt", "--out: network.pt"),
    ("{run} --out none/network.onnx", "--out: none/network.onnx"),
]
EVALUATE = [
    ("none --bogus", "No such option: --bogus"),
    ("none --seed 123456789012345678901234567890", "Invalid value for '--seed'"),
    ("none --methods ''", "--methods: none"),
    ("none --experiments ,", "--experiments: none"),
    ("none --measured none.mat", "--measured: none.mat"),
    ("none --out {here}/file/out", "--out: {here}/file/out: Not a directory"),
    ("{traced} --arrays full --methods das", "{traced}: holds traced paths and no frames"),
    ("{data} --arrays full --methods das,best", "--methods: 'best'; expected some of das"),
    ("{data} --arrays full --methods das,das", "--methods: 'das' twice"),
    ("{data} --arrays full --methods das,cnn", "--methods: 'cnn' without a run of that kind"),
    ("{data} --arrays full --experiments fig8", "--experiments: 'fig8'; expected some of point-spread"),
    ("{data} --arrays full --experiments measured", "--experiments: measured: no --measured file"),
    ("{data}", "--arrays, by default sparse6,sparse4,full: sparse6 uses RX 15; expected RX 0 to 5, those of the "
     "dataset's radar: 'full' has them all"),
    ("{data} --arrays sparse6", "--arrays: sparse6 uses RX 15; expected RX 0 to 5"),
    ("{data} --arrays none.toml", "--arrays: no named array and no file 'none.toml'; expected a TOML file or one of "),
    ("{data} --arrays full,full", "--arrays: 'full' twice"),
    ("{data} --arrays ,", "--arrays: none; expected some of"),
    ("{data} --arrays full --frames 0", "Invalid value for '--frames'"),
    ("{data} --arrays full --run nothing", "nothing: no run.json; expected a run folder"),
    ("{data} --arrays full --run {run}", "--run: {run} was trained for array 'mine'"),
    ("{data} --arrays {here}/mine.toml --run {longer}", "{data}: radar 'tiny', waveform.samples = 32; expected 64"),
    ("{data} --arrays {here}/mine.toml --run {run} --methods das", "--run: {run} is a 'unet', not among"),
    ("{data} --arrays full --measured {here}/pair.npy --experiments detection",
     "--measured: {here}/pair.npy without the experiment"),
    ("{data} --arrays full --out {here}/file", "--out: {here}/file: File exists"),
    ("{data} --arrays full --out {here}", "--out: {here} is not empty"),
    ("{data} --arrays full --out {here} --resume", "--out: {here} holds no cells/"),
    ("{untested} --arrays full", "{untested}: no frames in split 'test'; expected a dataset with frames to test"),
    ("{here} --arrays full", "{here}/manifest.json: no such file"),
    ("", "arguments: neither a dataset nor --measured; expected one of both, or both"),
    ("none --run sparse4", "sparse4: no such folder; expected a run folder made by trainer fit, or --pre"),
    ("none --range 3", "--range: 3 without --measured; expected --measured beside it"),
    ("none --targets 2", "--targets: 2 without --measured"),
    ("none --model-error -20", "--model-error: -20 without --measured"),
    ("--measured {here}/pair.npy --methods das,unet", "--methods: 'unet' without a run of that kind"),
    ("--measured {here}/pair.npy --range 3", "--range: 3 m of a snapshot; expected no --range"),
    ("--measured {here}/pair.npy --targets 0", "--targets: 0; expected 1 or more"),
    ("--measured {here}/pair.npy --targets 6", "--targets: 6 with 10 elements; expected at most 5"),
    ("--measured {here}/pair.npy --model-error 3", "model_error_db: 3.0; expected at most 0 dB"),
    ("--measured {here}/pair.npy --experiments detection", "--experiments: detection; expected measured alone"),
    ("--measured {here}/pair.npy --methods capon", "--methods: 'capon'; expected some of das, "),
    ("--measured {here}/pair.npy --run none", "none: no run.json; expected a run folder"),
    ("--measured none.npz", "--measured: none.npz; expected a .mat or .npy file"),
    ("--measured {cube} --range 30", "--range: 30 m; expected 0 to "),
]  # fmt: skip
IMPORT = [
    ("none.bin --board iwr1843", "CAPTURE: none.bin"),
    ("none.npy --board iwr1843", "none.npy: no such file of arrays"),
    ("none.bin --board iwr9", "--board: 'iwr9'"),
    ("none.bin --board iwr1843 --out cube.npy", "--out: cube.npy"),
    (
        "none.bin --board iwr1843 --radar iwr1843",
        "--radar: 'iwr1843' is a preset, which describes no capture; expected a",
    ),
    ("none.bin --board iwr1843 --radar iwr1844", "--radar: no file 'iwr1844'; expected a TOML file with a table [capt"),
    ("none.bin {chirps} --calibration {here}/capture.toml", "{here}/capture.toml: is no calibration, without array"),
    ("none.bin --board iwr1843 --out {cube}", "--out: {cube} is there already; expected a file that does not exist"),
    ("none.bin --board iwr1843 --order q", "--order: 'q'"),
    ("none.bin --board iwr1843 --frames 1", "--frames: '1'"),
    ("{here}/array.npy {chirps}", "{here}/array.npy: 0 arrays that fit"),
    ("{here}/array.npy {chirps} --variable adc", "{here}/array.npy: no array 'adc'"),
    ("{here}/array.npy {chirps} --axes chirp-time", "--axes: 'chirp-time'"),
    ("{here}/array.npy {chirps} --axes (tx", "--axes: '(tx'"),
    ("{here}/array.npy {chirps} --layout 2-lane", "--layout: '2-lane' of {here}/array.npy"),
    ("{here}/nan.npy {chirps}", "{here}/nan.npy: array has values that are not finite"),
    ("{here}/nan.npy {chirps} --frames 1:2", "--frames: 1:2 of {here}/nan.npy, which has 1"),
    ("{here}/short.bin {chirps}", "{here}/short.bin: 100 bytes"),
    ("{here}/zeros.bin {chirps}", "{here}/zeros.bin: all samples are 0"),
    ("{here}/damaged.h5 {chirps}", "{here}/damaged.h5: not readable"),
]
CALIBRATE = [
    ("a.bin --board iwr1843 --range 3", "Missing option '--angle'"),
    ("a.bin b.bin --board iwr1843 --range 3 --angle 1", "arguments: 2 captures, 1 --range and 1 --angle"),
    ("a.bin --board iwr1843 --range -3 --angle 1", "--range: -3.0"),
    ("a.bin --board iwr1843 --range 3 --angle 91", "--angle: 91.0"),
    ("a.bin --board iwr1843 --range 3 --angle 1 --out c", "--out: c"),
    ("a.bin --board iwr1843 --range 3 --angle 1 --out {here}/capture.toml", "--out: {here}/capture.toml is there alr"),
    ("a.bin --board iwr1843 --range 3 --angle 1 --check b", "--check: without all of the three"),
]
TABLES = {
    "fit": FIT, "predict": PREDICT, "export": EXPORT, "evaluate": EVALUATE, "import": IMPORT, "calibrate": CALIBRATE,
}  # fmt: skip
OUT = {"import": "out.npz", "calibrate": "out.toml"}
ROWS = [(command, line, source) for command, table in TABLES.items() for line, source in table]


@pytest.mark.parametrize(("command", "line", "source"), ROWS, ids=[f"{row[0]} {row[1]}" for row in ROWS])
def test_what_is_refused(
    places: dict[str, object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, line: str, source: str
) -> None:
    monkeypatch.chdir(tmp_path)
    words = shlex.split(line.format(**places))
    out = [] if "--out" in words else ["--out", OUT.get(command, "out")]
    said = refused("trainer", command, *words, *out)
    assert said.startswith(f"trainer: {source.format(**places)}"), said
    assert not list(tmp_path.iterdir())


CUBE, RADAR_TEXT = of_array(np.zeros(SHAPE, np.complex64)), of_array(RADAR.model_dump_json())
HEADER = b"{'descr': '<c8', 'fortran_order': False, 'shape': (1000000, 1000000, 48)}\n"


def scrambled(content: bytes) -> bytes:
    """A .npz whose compressed bytes were changed, its directory left as it was."""
    place = content.index(b"cube.npy") + 12
    return content[:place] + bytes(255 - byte for byte in content[place : place + 40]) + content[place + 40 :]


def of_radar(radar: object) -> bytes:
    return npz(cube=CUBE, radar=of_array(radar))


def of_cube(cube: NDArray[Any]) -> bytes:
    return npz(cube=of_array(cube), radar=RADAR_TEXT)


CUBES = {
    "huge.npy": (b"\x93NUMPY\x01\x00" + len(HEADER).to_bytes(2, "little") + HEADER, "not readable: Unable to allocate"),
    "cut.npy": (CUBE[:-7], "not readable: "),
    "no archive.npz": (b"PK no archive", "not readable: "),
    "scrambled.npz": (scrambled(of_cube(np.zeros(SHAPE, np.complex64))), "not readable: "),
    "objects.npz": (of_cube(np.array([{}], object)), "not readable: "),
    "without radar.npz": (npz(cube=CUBE), "no array 'radar'"),
    "channels.npz": (of_cube(np.zeros((4, 32, 5), np.complex64)), "cube is complex64 [4, 32, 5]"),
    "real.npz": (of_cube(np.zeros(SHAPE)), "cube is float64"),
    "nan.npz": (of_cube(np.full(SHAPE, np.nan, np.complex64)), "cube has 768 values that are not finite"),
    "loud.npz": (of_cube(np.full(SHAPE, 1e30, np.complex128)), "cube has samples of 1e+30"),
    "nested.npz": (of_radar("[" * 100_000), "radar is not JSON"),
    "numbers.npz": (of_radar(np.arange(3)), "radar is not JSON"),
    "field.npz": (of_radar('{"chirps": 3}'), "radar: unknown field chirps"),
    "grid.npz": (of_radar('{"grid": {"bins": 10000000}}'), "radar: grid.bins = 10000000"),
    "room.npz": (of_radar('{"waveform": {"chirps": 65536, "samples": 1048576}}'), "radar: chirps = 65536"),
}  # fmt: skip


@pytest.mark.parametrize("name", CUBES)
def test_a_cube_that_is_none(places: dict[str, object], tmp_path: Path, name: str) -> None:
    content, problem = CUBES[name]
    (tmp_path / name).write_bytes(content)
    beside = ["--radar", f"{places['here']}/radar.toml"] if name.endswith(".npy") else []
    said = refused("trainer", "predict", places["run"], tmp_path / name, "--out", tmp_path / "out", *beside)
    assert said.startswith(f"trainer: {tmp_path / name}: {problem}"), said
    assert not (tmp_path / "out").exists()
