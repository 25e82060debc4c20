"""TDM: what a target's motion between the turns of the TX does to the channels, and what the channels tell of it.

TX i sends i T / N after TX 0 (T = ``chirp_interval_s``, N TX). A target of Doppler frequency f_D has moved on by then:
by eq. (1) and (2) its echo in the channels of TX i is ahead by exp(+j 2 pi f_D i T / N), with f_D = 2 v / lambda of
mid-sweep, positive when receding. In the Doppler cell whose centre is f these channels are turned back by

    exp(-j 2 pi f i T / N)

(Bechter, Roos and Waldschmidt, "Compensation of motion-induced phase errors in TDM MIMO radars", IEEE Microwave and
Wireless Components Letters 27, 2017). TX 0 keeps its values.

The chirps of one TX come every T, so that f_D is f + h / T with an integer h, the *interval*, that no Doppler spectrum
knows. Channels of different TX whose virtual elements coincide see the same echo at different times. After the turn
above they differ by exp(+j 2 pi h (i - i') / N). Turned back by each h they are added, and their power
sum_places |sum_c x_c exp(-j 2 pi h i_c / N)|^2 is largest for the right h (Schmid, Feger, Pfeffer and Stelzer, EuCAP
2012, compare the phases of such elements). Of K intervals that are told apart the lowest velocity is the highest as
well. Its cell, the lowest where K is odd (of an even number of chirps) and the middle one where K is even, belongs to
both ends: the larger of its neighbours says to which.

Limits: a range-Doppler cell has one h, that of the stronger target. Without elements that coincide nothing tells h, and
0 is taken (:func:`statement`). Elements coincide in the far field; at a distance d a pair differs by up to
k (y_tx^2 + y_rx^2 - y_tx'^2 - y_rx'^2) / (2 d) more. What compensation leaves is in docs/notes/tdm.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float64, Int, Int64

from shared.radar import Radar
from shared.signal.signal import chirp_times


def turns(radar: Radar) -> Float64[np.ndarray, " channels"]:
    """[C] start of each channel's TX after TX 0, in chirp intervals: i / N, or 0 where all TX send at once."""
    starts = chirp_times(radar)[:, 0] / radar.waveform.chirp_interval_s
    return starts[radar.array.channel_tx]


def compensated(
    spectra: Complex[np.ndarray, "rows chirps channels"], radar: Radar
) -> Complex[np.ndarray, "rows chirps channels"]:
    """Range-Doppler spectra [R, chirps, C], velocity rising, with every TX turned back to TX 0; in place.

    Exact for a target at the centre of its Doppler cell and within the velocity interval, and for all of TX 0.
    """
    turn = turns(radar)
    if not turn.any():
        return spectra
    chirps = radar.waveform.chirps
    cycles = (np.arange(chirps) - chirps // 2) / chirps  # in a chirp interval
    spectra *= phasors(cycles[:, None] * turn, spectra)
    return spectra


def most_coherent(
    range_channel: Complex[np.ndarray, "peaks rows channels"], radar: Radar
) -> Int64[np.ndarray, "peaks rows"]:
    """[D, R] h from 0 on under which the elements that coincide agree best."""
    _, element = radar.array.unique_elements(radar.waveform.wavelength_m)
    order = np.argsort(element, kind="stable")
    first = np.flatnonzero(np.diff(element[order], prepend=-1))
    at_places, turn = range_channel[..., order], turns(radar)[order]
    power = np.empty((radar.velocity_intervals, *range_channel.shape[:2]))
    for h in range(len(power)):
        added = np.add.reduceat(at_places * phasors(h * turn, at_places), first, axis=-1)
        power[h] = (np.abs(added) ** 2).sum(axis=-1)
    return power.argmax(axis=0)


def phasors(cycles: Float64[np.ndarray, "*any"], like: Complex[np.ndarray, "*other"]) -> Complex[np.ndarray, "*any"]:
    """exp(-j 2 pi cycles) in the precision of ``like``."""
    return np.exp(-2j * np.pi * cycles).astype(like.dtype)


def averaged(
    range_channel: Complex[np.ndarray, "*rows channels"],
    radar: Radar,
    missing: Sequence[int] | Int[np.ndarray, " left_out"] = (),
) -> tuple[Complex[np.ndarray, "*rows elements"], Float64[np.ndarray, "elements 3"]]:
    """(means [..., E] of the channels that coincide, positions [E, 3] of those unique elements, rising in y) [m].

    Of a TDM radar the channels must be compensated already: elements of different TX coincide in place, not in time.
    White noise of power P in a channel has P / n in the mean of n.

    :param missing: channels left out; an element of which none is left is left out too
    """
    positions, element = radar.array.unique_elements(radar.waveform.wavelength_m)
    present = ~np.isin(np.arange(radar.array.channels), missing)
    share = present * (element == np.arange(len(positions))[:, None])  # (E, C)
    kept = share.any(axis=1)
    share = share[kept] / share[kept].sum(axis=1, keepdims=True)
    return range_channel @ share.T.astype(range_channel.dtype), positions[kept]


def statement(radar: Radar) -> str | None:
    """What is known of velocities that a TDM radar measures, in one line; None where all TX send at once."""
    if not turns(radar).any():
        return None
    span, known, tx_count = radar.waveform.velocity_span_mps, radar.velocity_intervals, len(radar.array.tx_m)
    if not radar.waveform.tells_velocity:
        return f"TDM of {tx_count} TX: frames of fewer than three chirps tell no velocity; what moves has a wrong angle"
    limit = 0.5 * span * known
    told = "no virtual elements of different TX coincide, so that nothing resolves the Doppler ambiguity"
    if known > 1:
        told = f"virtual elements that coincide resolve {known} Doppler intervals of {span:.3g} m/s"
    return (
        f"TDM of {tx_count} TX: {told}; velocities hold from {-limit:.3g} to {limit:.3g} m/s, "
        "what is faster appears at a wrong velocity and angle"
    )
