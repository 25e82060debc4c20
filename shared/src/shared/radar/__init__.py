"""The radar as configured: waveform, array, front end, receiver; presets, boards and TOML."""

from shared.radar.front_end import FrontEnd
from shared.radar.loading import PRESETS, CaptureRadar, board_radar, load_capture_radar, load_radar
from shared.radar.radar import ImageGrid, Radar
from shared.radar.validation import first_validation_error, read_toml, validated

__all__ = [
    "PRESETS",
    "CaptureRadar",
    "FrontEnd",
    "ImageGrid",
    "Radar",
    "board_radar",
    "first_validation_error",
    "load_capture_radar",
    "load_radar",
    "read_toml",
    "validated",
]
