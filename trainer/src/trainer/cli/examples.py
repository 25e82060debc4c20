"""Two examples of every command: its help ends with them, and ``tests/documentation/test_help.py`` runs them.

``build/mine`` is a dataset that ``datafactory render`` made; captures are the reader's own.
"""

from __future__ import annotations

EXAMPLES = {
    "fit": (
        "trainer fit build/mine --out build/run",
        "trainer fit build/mine --array sparse4 --steps 1500 --out build/run-sparse4",
    ),
    "predict": (
        "trainer predict build/mine --pretrained sparse6 --points --out build/images",
        "trainer predict build/run build/mine --out build/images-of-run",
    ),
    "evaluate": (
        "trainer evaluate build/mine --run build/run --out build/report",
        "trainer evaluate build/mine --methods das,music,iaa --arrays sparse6,sparse4 --out build/classical",
    ),
    "export": (
        "trainer export build/run --out build/run.onnx",
        "trainer export build/run-sparse4 --out build/run-sparse4.onnx",
    ),
    "calibrate": (
        "trainer calibrate corner.bin --board iwr1843 --range 5.02 --angle 0 --out calibration.toml",
        "trainer calibrate corner.bin --board iwr1843 --range 5.02 --angle 0 "
        "--check other.bin --check-range 4.1 --check-angle 15 --out checked.toml",
    ),
    "import": (
        "trainer import adc_data.bin --board iwr1843 --out cube.npz",
        "trainer import adc_data.bin --board iwr1843 --calibration calibration.toml --out cube.npz",
    ),
}
