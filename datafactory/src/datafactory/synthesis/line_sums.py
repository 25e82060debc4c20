"""From the grid of range cells and Doppler lines to the cube's samples: the loops around the FFTs and products.

The equation is that of :mod:`datafactory.synthesis.frame_lines`.
"""

from __future__ import annotations

import numpy as np

from shared.physics.compiled import compiled
from shared.physics.cycles import phasor_like

_FAST = {"contract", "nsz", "arcp"}


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def line_spectrum(row, margin, spectrum):
    """One line's grid, folded to cyclic cells, as complex numbers in the channels' order.

    :param row: [TX * panels, cells + 2 * margin, 2, LANES]; what the margins hold belongs to the other end
    :param spectrum: [cells, RX, TX] complex64, overwritten
    """
    cells, rx_count, tx_count = spectrum.shape
    panels, lanes = row.shape[0] // tx_count, row.shape[3]
    for cell in range(cells):
        for panel in range(panels):
            first = panel * lanes
            for i in range(tx_count):
                re, im = row[i * panels + panel, cell + margin, 0], row[i * panels + panel, cell + margin, 1]
                for e in range(min(lanes, rx_count - first)):
                    spectrum[cell, first + e, i] = complex(re[e], im[e])
    for outside in range(margin):
        for source in (outside, cells + margin + outside):
            cell = (source - margin) % cells
            for i in range(tx_count):
                for e in range(rx_count):
                    here = row[i * panels + e // lanes, source]
                    spectrum[cell, e, i] += complex(here[0, e % lanes], here[1, e % lanes])


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def fill_lines(frequency, scale, chirps, shape, taps, oversampling, rows):
    """cos and sin of 2 pi f eta', times the gain, for eta = p / chirps, p = 0, 1, ...

    :param scale: [samples] eta' / eta; ``rows`` [samples, 2, p, lines], overwritten
    """
    for n in range(len(scale)):
        for p in range(rows.shape[2]):
            eta = p / chirps * scale[n]
            width = np.pi * taps * eta / oversampling
            root = np.sqrt(shape * shape - width * width)
            gain = np.sinh(shape) / shape * root / np.sinh(root)
            cosines, sines = rows[n, 0, p], rows[n, 1, p]
            for line in range(len(frequency)):
                cosine, sine = phasor_like(frequency[line] * eta, cosines[line])
                cosines[line] = gain * cosine
                sines[line] = gain * sine


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def add_samples(product, first, cube):
    """Add samples from ``first`` on to ``cube`` [chirps, samples, channels].

    :param product: [samples, 2, p, 2 * channels] of cosines and of sines, for eta = p / chirps
    """
    chirps, _, channels = cube.shape
    middle = chirps // 2
    for n in range(product.shape[0]):
        for p in range(product.shape[2]):
            even, odd = product[n, 0, p], product[n, 1, p]
            if middle + p < chirps:
                line = cube[middle + p, first + n]
                for c in range(channels):
                    line[c] += complex(even[2 * c] - odd[2 * c + 1], even[2 * c + 1] + odd[2 * c])
            if 0 < p <= middle:
                line = cube[middle - p, first + n]
                for c in range(channels):
                    line[c] += complex(even[2 * c] + odd[2 * c + 1], even[2 * c + 1] - odd[2 * c])
