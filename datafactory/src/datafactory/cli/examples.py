"""Two examples of every command: its help ends with them, and ``tests/documentation/test_help.py`` runs them."""

from __future__ import annotations

EXAMPLES = {
    "render": (
        "datafactory render shipped:street --frames 16 --out build/mine",
        "datafactory render sionna:munich --populate cars=4/100m,parked=0.6 --frames 64 --points 16 --out build/munich",
    ),
    "points": (
        "datafactory points --frames 64 --out build/points",
        "datafactory points --frames 64 --no-noise --seed 1 --out build/clean",
    ),
    "plan": ("datafactory plan shipped:street", "datafactory plan sionna:munich --frames 8 --no-times --json"),
    "accuracy": (
        "datafactory accuracy shipped:street --out build/accuracy",
        "datafactory accuracy sionna:munich --quick --out build/accuracy-munich",
    ),
    "trace": (
        "datafactory trace shipped:street --frames 16 --out build/paths",
        "datafactory trace sionna:munich --rays 500000 --frames 64 --out build/paths-munich",
    ),
    "merge": (
        "datafactory merge build/jobs --out build/whole",
        "datafactory merge build/jobs/job-0-of-2 build/jobs/job-1-of-2 --out build/both",
    ),
    "view": (
        "datafactory view shipped:street --out build/street.html",
        "datafactory view sionna:munich --frames 8 --frame 3 --rays 20000 --out build/munich.html",
    ),
    "scenes": ("datafactory scenes", "datafactory check shipped:tiny"),
    "check": ("datafactory check shipped:street", "datafactory check sionna:munich --json"),
    "city": (
        "datafactory city --out build/city.usda",
        "datafactory city --seed 7 --blocks 3 --out build/city-7.usda",
    ),
    "inspect": ("datafactory inspect build/mine", "datafactory inspect build/mine --verify --frames 0"),
    "convert": (
        "datafactory convert build/mine --to mcap --out build/mcap",
        "datafactory convert build/munich --to mcap --out build/mcap-munich",
    ),
    "doctor": ("datafactory doctor", "datafactory doctor --json"),
}
