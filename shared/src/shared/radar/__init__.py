"""The radar as configured: waveform, array, front end, receiver; presets and TOML."""

from shared.radar.front_end import FrontEnd
from shared.radar.radar import (
    PRESETS,
    ImageGrid,
    Radar,
    first_validation_error,
    load_radar,
)

__all__ = ["PRESETS", "FrontEnd", "ImageGrid", "Radar", "first_validation_error", "load_radar"]
