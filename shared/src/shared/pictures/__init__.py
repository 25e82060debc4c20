"""One look for all pictures of range-angle images, whoever draws them: one colour map, one span, the radar's left on
the left, no target lost between the pixels."""

from shared.pictures.drawing import (
    COLOUR_MAP,
    LEVEL_LABEL,
    SPAN_DB,
    any_name,
    draw_from_above,
    draw_levels,
    hold_peaks,
    level_db,
    range_weighted,
    range_weighted_db,
    save_figure,
)

__all__ = [
    "COLOUR_MAP",
    "LEVEL_LABEL",
    "SPAN_DB",
    "any_name",
    "draw_from_above",
    "draw_levels",
    "hold_peaks",
    "level_db",
    "range_weighted",
    "range_weighted_db",
    "save_figure",
]
