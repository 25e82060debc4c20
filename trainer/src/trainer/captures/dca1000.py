"""The ``adc_data.bin`` of a DCA1000: 16-bit numbers in the order in which they leave the device's lanes.

Texas Instruments, "mmWave Radar Device ADC Raw Data Capture", SWRA581B, and its ``readDCA1000.m``. By the lanes:

- "2-lane" (xWR16xx, xWR18xx, xWR68xx): chirp after chirp, RX after RX; of complex samples two I, then their two Q.
  Only the RX that are switched on are there.
- "4-lane" (xWR12xx, xWR14xx): chirp after chirp, sample after sample; of complex samples the I of four lanes, then
  their Q. There are always four lanes; those of RX that are off hold zeros.

The AWR2944 records real samples on two lanes. SWRA581 does not name it; its data are taken to be "2-lane", real.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from shared.radar import Radar
from trainer.captures.samples import (
    Order,
    as_cube,
    chosen_frames,
    frames_there,
    one_sided,
    ordered,
    read_numbers,
    sizes_of,
)

Lanes = Literal["2-lane", "4-lane"]
LANES = 4
"""In a "4-lane" file, whatever RX are on."""


def read_dca1000(
    path: Path,
    radar: Radar,
    lanes: Lanes,
    real: bool,
    order: Order = "iq",
    frames: tuple[int, int] | None = None,
    rx_numbers: tuple[int, ...] = (),
) -> NDArray[np.complex64]:
    """[frame, chirp, sample, C] in counts of the converter.

    :param real: True for samples without Q
    :param frames: from the first to before the second; all by default
    :param rx_numbers: of the radar's RX on the board, from 1, which are its lanes; by default the first ones
    :raises InputError: a file whose size does not fit, that is empty, or whose numbers cannot be samples
    """
    wide = lanes == "4-lane"
    sizes = sizes_of(radar, real, LANES if wide else None)
    chosen = chosen_frames(path, frames_there(path, sizes), frames, radar)
    numbers = read_numbers(path, sizes, chosen)
    shape = (len(chosen), sizes.chirps, sizes.tx)
    if wide:
        used = [number - 1 for number in rx_numbers] or list(range(sizes.rx))
        axes = ("frame", "chirp", "tx", "sample", "rx")
        if real:
            return as_cube(one_sided(numbers.reshape(*shape, sizes.samples, LANES)[..., used]), axes)
        parts = numbers.reshape(*shape, sizes.samples, 2, LANES)[..., used]
        return as_cube(ordered(_complex(parts[..., 0, :], parts[..., 1, :]), order), axes)
    axes = ("frame", "chirp", "tx", "rx", "sample")
    if real:
        return as_cube(one_sided(numbers.reshape(*shape, sizes.rx, sizes.samples)), axes)
    pairs = numbers.reshape(-1, 2, 2)
    samples = _complex(pairs[:, 0], pairs[:, 1]).reshape(*shape, sizes.rx, sizes.samples)
    return as_cube(ordered(samples, order), axes)


def _complex(in_phase: NDArray[np.int16], quadrature: NDArray[np.int16]) -> NDArray[np.complex64]:
    samples = np.empty(in_phase.shape, np.complex64)
    samples.real, samples.imag = in_phase, quadrature
    return samples
