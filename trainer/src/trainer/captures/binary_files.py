"""Binary captures of Texas Instruments' boards: 16-bit numbers in the order in which they leave the device's lanes.

``adc_data.bin`` of a DCA1000 ("mmWave Radar Device ADC Raw Data Capture", SWRA581B, and its ``readDCA1000.m``), by the
lanes:

- "2-lane" (xWR16xx, xWR18xx, xWR68xx): chirp after chirp, RX after RX; of complex samples two I, then their two Q.
  Only the RX that are switched on are there.
- "4-lane" (xWR12xx, xWR14xx): chirp after chirp, sample after sample; of complex samples the I of four lanes, then
  their Q. There are always four lanes; those of RX that are off hold zeros.

The AWR2944 records real samples on two lanes. SWRA581 does not name it; its data are taken to be "2-lane", real.

The four files of the MMWCAS cascade, as its capture card (TDA2) and mmWave Studio write them:
``master_0000_data.bin``, ``slave1_0000_data.bin``, ``slave2_...``, ``slave3_...``, and an ``_idx.bin`` beside each. A
data file holds frame after frame, loop after loop, TX after TX as they send, sample after sample, the four RX of its
device, I then Q (``read_ADC_bin_TDA2_separateFiles.m`` of the mmWave Studio examples). RX 1 to 4 are the master's, then
those of slaves 1, 2 and 3. An index begins with five little-endian fields: tag, version, flags and number of frames
(32 bits each) and the bytes of the data (64 bits).
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.radar import CaptureRadar, Radar
from trainer.captures.options import Frames, Reading
from trainer.captures.samples import Sizes, as_cube, chosen_frames, frames_there, read_numbers, sizes_of

Lanes = Literal["2-lane", "4-lane"]
LANES = 4
"""In a "4-lane" file, whatever RX are on."""
DEVICES = ("master", "slave1", "slave2", "slave3")
RX_OF_DEVICE = 4
INDEX_HEADER = struct.Struct("<IIIIQ")


def read_dca1000(path: Path, of_board: CaptureRadar, reading: Reading, lanes: Lanes) -> NDArray[np.complex64]:
    """[frame, chirp, sample, C] in counts of the converter.

    :param of_board: the RX of a "4-lane" file are its lanes, by default the first ones
    :raises InputError: a file whose size does not fit, that is empty, or whose numbers cannot be samples
    """
    radar, wide, sizes = of_board.radar, lanes == "4-lane", sizes_of_lanes(of_board, lanes)
    chosen = chosen_frames(path, frames_there(path, sizes, reading.frames), reading.frames, radar)
    numbers = read_numbers(path, sizes, chosen)
    shape, parts = (len(chosen), sizes.chirps, sizes.tx), 1 if sizes.real else 2
    if wide:
        used = [number - 1 for number in of_board.rx] or list(range(sizes.rx))
        numbers = numbers.reshape(*shape, sizes.samples, parts, LANES)[..., used]
        return as_cube(numbers, ("frame", "chirp", "tx", "sample", "iq", "rx"), reading.order)
    numbers = numbers.reshape(-1, parts, parts).swapaxes(1, 2).reshape(*shape, sizes.rx, sizes.samples, parts)
    return as_cube(numbers, ("frame", "chirp", "tx", "rx", "sample", "iq"), reading.order)


def sizes_of_lanes(of_board: CaptureRadar, lanes: Lanes) -> Sizes:
    """What a frame has in a file of a DCA1000."""
    return sizes_of(of_board.radar, of_board.real, LANES if lanes == "4-lane" else None)


def cascade_files(path: Path) -> list[Path]:
    """The four data files, given their folder or the master's file.

    :raises InputError: none, several recordings in the folder, or a device's file missing
    """
    if path.is_dir():
        masters = sorted(path.glob("master_*_data.bin"))
        if len(masters) != 1:
            raise InputError(path, f"{len(masters)} files master_*_data.bin", "one, or the name of the one to import")
        path = masters[0]
    if not path.name.startswith("master_"):
        raise InputError(path, "not the master's data", "a master_NNNN_data.bin, or its folder")
    files = [path.with_name(path.name.replace("master", device, 1)) for device in DEVICES]
    for file in files:
        if not file.is_file():
            raise InputError(file, "not there", f"the data of {' and '.join(DEVICES)} beside each other")
    return files


def sizes_of_cascade(radar: Radar) -> Sizes:
    """Of a frame in the file of one device."""
    waveform = radar.waveform
    return Sizes(waveform.chirps, len(radar.array.tx_m), RX_OF_DEVICE, waveform.samples, real=False)


def read_cascade(path: Path, of_board: CaptureRadar, reading: Reading) -> NDArray[np.complex64]:
    """[frame, chirp, sample, C] in counts of the converter.

    :param path: folder, or the master's data file
    :raises InputError: a file that is missing, or whose size does not fit its index, the radar or the other files
    """
    radar = of_board.radar
    files, sizes = cascade_files(path), sizes_of_cascade(radar)
    counts = [_frames_of(file, sizes, reading.frames) for file in files]
    if len(set(counts)) != 1 and reading.frames is None:
        told = ", ".join(f"{device} {count}" for device, count in zip(DEVICES, counts, strict=True))
        raise InputError(files[0], f"frames of {told}", "the same number of each device")
    numbers = of_board.rx or tuple(range(1, len(DEVICES) * RX_OF_DEVICE + 1))
    if len(numbers) != len(radar.array.rx_m):
        raise InputError(path, f"RX {list(numbers)}", f"the {len(radar.array.rx_m)} RX of radar {radar.name!r}")
    chosen = chosen_frames(files[0], min(counts), reading.frames, radar)
    shape = (len(chosen), sizes.chirps, sizes.tx, sizes.samples)
    recorded = np.empty((*shape, len(numbers), 2), np.int16)
    of_device, rx = np.divmod(np.array(numbers) - 1, RX_OF_DEVICE)
    for device, file in enumerate(files):
        here = of_device == device
        if here.any():
            of_file = read_numbers(file, sizes, chosen).reshape(*shape, RX_OF_DEVICE, 2)
            recorded[..., here, :] = of_file[..., rx[here], :]
    return as_cube(recorded, ("frame", "chirp", "tx", "sample", "rx", "iq"), reading.order)


def _frames_of(file: Path, sizes: Sizes, chosen: Frames | None) -> int:
    """Whole frames of a data file. An index beside it must say the same, or more of one that was cut off."""
    count, there = frames_there(file, sizes, chosen), file.stat().st_size
    index = file.with_name(file.name.replace("_data.bin", "_idx.bin"))
    if index.is_file():
        with index.open("rb") as handle:
            header = handle.read(INDEX_HEADER.size)
        if len(header) != INDEX_HEADER.size:
            raise InputError(index, f"{len(header)} bytes", f"a header of {INDEX_HEADER.size}")
        told, size = INDEX_HEADER.unpack(header)[3:]
        cut = chosen is not None and told > count and size > there
        if not cut and (told != count or size != there):
            problem = f"{told} frames in {size} bytes; {file.name} has {count} in {there}"
            raise InputError(index, problem, "the index of this recording, and chirps as they were recorded")
    return count
