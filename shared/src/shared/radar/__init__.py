"""The radar as configured: waveform, array, front end, receiver; presets, boards and TOML."""

from shared.radar.front_end import FrontEnd as FrontEnd
from shared.radar.loading import PRESETS as PRESETS
from shared.radar.loading import CaptureRadar as CaptureRadar
from shared.radar.loading import board_radar as board_radar
from shared.radar.loading import load_capture_radar as load_capture_radar
from shared.radar.loading import load_radar as load_radar
from shared.radar.radar import ImageGrid as ImageGrid
from shared.radar.radar import Radar as Radar
from shared.radar.validation import first_validation_error as first_validation_error
from shared.radar.validation import read_toml as read_toml
from shared.radar.validation import validated as validated
