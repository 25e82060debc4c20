"""Truth cells, detections and false alarms: by hand, by a slow reference, in noise alone; shuffled, flipped, empty."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from shared.physics.errors import InputError
from trainer.metrics.cells import (
    LEVELS,
    CellScores,
    Ranking,
    local_maxima,
    match_cells,
    pooled,
    score_cells,
    truth_cells,
)

STEP = 0.15
"""Of the rows [m]: row 33, at 4.95 m, is the last that is too near."""
FAR = 40
"""Empty rows in front of what is looked at, so that it is beyond 5 m."""


def far(image: NDArray) -> NDArray:
    return np.concatenate([np.zeros((FAR, image.shape[1])), image])


def dots(shape: tuple[int, int], *cells: tuple[int, int, float]) -> NDArray:
    image = np.zeros(shape)
    for row, column, level in cells:
        image[row, column] = level
    return image


def smooth(shape: tuple[int, int], seed: int) -> NDArray:
    """Noise of 40 dB range, two bins wide."""
    generator = np.random.default_rng(seed)
    rough = generator.rayleigh(size=(shape[0] + 1, shape[1] + 1)) ** 3
    return rough[1:, 1:] + rough[:-1, 1:] + rough[1:, :-1] + rough[:-1, :-1]


def scores(truth: NDArray, level: NDArray, score: NDArray | None = None, noise_power: float = 0.0) -> CellScores:
    return score_cells(truth, level, noise_power, 6, STEP, score)


def slow_maxima(image: NDArray) -> list[tuple[int, int]]:
    rows, columns = image.shape
    found = []
    for row, column in np.ndindex(rows, columns):
        around = image[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        if image[row, column] > 0.0 and np.sum(around >= image[row, column]) == 1:
            found.append((row, column))
    return found


def most_pairs(found: list[tuple[int, int]], cells: list[tuple[int, int]]) -> int:
    """The largest number of one-to-one pairs within reach, by trying every choice."""
    if not found:
        return 0
    first, *others = found
    best = most_pairs(others, cells)
    for cell in cells:
        if abs(first[0] - cell[0]) <= 1 and abs(first[1] - cell[1]) <= 2:
            best = max(best, 1 + most_pairs(others, [other for other in cells if other != cell]))
    return best


def slow_outcome(truth: NDArray, level: NDArray, score: NDArray, noise_power: float) -> list[tuple[float, int, int]]:
    """(threshold, matched, false alarms) at every score, falling: each threshold anew, as the rules have it.

    All scores differ, and so the detections of a threshold are those of the one before and one more: it is matched if
    with it there is one more pair.
    """
    cells = []
    for row, column in slow_maxima(truth):
        enough = 6 * truth[row, column] ** 2 > 10**1.3 * noise_power
        if enough and truth[row, column] >= 10 ** (-25 / 20) * truth[row].max() and row * STEP > 5.0:
            cells.append((row, column))
    detections = sorted(slow_maxima(score), key=lambda place: -score[place])
    outcome, matched, false = [], 0, 0
    for count, (row, column) in enumerate(detections, 1):
        if most_pairs(detections[:count], cells) > matched:
            matched += 1
        else:
            around = truth[max(row - 1, 0) : row + 2, max(column - 2, 0) : column + 3].max()
            false += int(row * STEP > 5.0 and level[row, column] > 10**0.5 * around)
        outcome.append((float(score[row, column]), matched, false))
    return outcome


def slow_average_precision(outcomes: list[tuple[float, bool]], truths: int) -> float:
    """Of (score, matched) pairs: the area under the steps of precision over detection probability."""
    area, before = 0.0, 0.0
    for threshold in sorted({score for score, _ in outcomes}, reverse=True):
        above = [hit for score, hit in outcomes if score >= threshold]
        recall = sum(above) / truths
        area += (recall - before) * sum(above) / len(above)
        before = recall
    return area


# Truth cells


def test_truth_cells_are_the_maxima_that_noise_row_and_range_leave() -> None:
    least = np.sqrt(10**1.3 * 1e-3 / 6)  # 13 dB over the noise of six channels
    image = far(np.zeros((12, 30)))
    for row, column, level in [
        (0, 5, 1.001 * least), (0, 20, 0.999 * least),  # above and below 13 dB
        (4, 5, 10.0), (4, 20, 10.0 * 10 ** (-24.9 / 20)), (4, 27, 10.0 * 10 ** (-25.1 / 20)),  # below the row's maximum
        (8, 0, 1.0), (8, 29, 2.0), (11, 15, 3.0),  # at the border
    ]:  # fmt: skip
        image[FAR + row, column] = level
    image[33, 7], image[34, 12] = 5.0, 5.0  # 4.95 m and 5.1 m
    expected = [(34, 12), (40, 5), (44, 5), (44, 20), (48, 0), (48, 29), (51, 15)]
    assert [tuple(cell) for cell in truth_cells(image, 1e-3, 6, STEP).tolist()] == expected
    # Four times as many channels see 6 dB less; without noise only zeros are no cells.
    assert len(truth_cells(image, 1e-3, 24, STEP)) == len(expected) + 1
    assert len(truth_cells(image, 0.0, 6, STEP)) == len(expected) + 1
    assert truth_cells(np.zeros((50, 30)), 0.0, 6, STEP).shape == (0, 2)


def test_a_shoulder_is_no_maximum_and_a_plateau_is_one() -> None:
    image = np.zeros((9, 12))
    image[1, 1:5] = [2.0, 3.0, 2.5, 2.6]
    image[2, 5] = 2.7  # beside 2.6, on the diagonal, and higher
    image[5:7, 7:10] = 4.0
    assert local_maxima(image).tolist() in ([[1, 2], [2, 5], [5, 8]], [[1, 2], [2, 5], [6, 8]])
    assert local_maxima(np.ones((7, 7))).tolist() == [[3, 3]]
    assert local_maxima(np.zeros((0, 4))).shape == (0, 2)


# Matching and false alarms by hand


def test_one_cell_serves_one_detection_and_the_other_counts_neither_way_unless_it_is_too_strong() -> None:
    truth = far(dots((5, 15), (2, 7, 1.0)))
    for weaker in (2.0, 3.1):  # within 10 dB of the truth around it
        found = scores(truth, far(dots((5, 15), (2, 6, weaker), (2, 8, 3.15))))
        assert (found.matched.tolist(), found.false_alarms.tolist()) == ([3.15], [])
    found = scores(truth, far(dots((5, 15), (2, 6, 3.2), (2, 8, 4.0))))
    assert (found.matched.tolist(), found.false_alarms.tolist()) == ([4.0], [3.2])


def test_a_false_alarm_is_judged_by_level_ranked_by_score_and_beyond_five_metres() -> None:
    truth = far(dots((9, 30), (4, 7, 1.0)))
    level = far(dots((9, 30), (4, 7, 1.0), (4, 20, 1e-9)))
    score = far(dots((9, 30), (4, 7, 0.2), (4, 20, 0.9)))
    found = scores(truth, level, score)
    assert (found.matched.tolist(), found.false_alarms.tolist()) == ([0.2], [0.9])
    assert pooled([found]).average_precision() == 0.5
    assert pooled([scores(truth, level)]).average_precision() == 1.0
    # Where the truth is as strong, what is not asked for is not false either.
    floor = np.where(far(np.ones((9, 30))) > 0, 1e-9, 0.0)
    assert scores(truth + floor, level, score).false_alarms.tolist() == []
    near = np.zeros_like(truth)
    near[33, 7], near[34, 20] = 1.0, 2.0
    assert scores(truth, near).false_alarms.tolist() == [2.0]


def test_room_is_found_at_the_end_of_a_long_chain() -> None:
    """Cells every four bins, detections between them and one beside the first or the last cell, the weakest of all."""
    chain = 1200
    cells = np.stack([np.zeros(chain + 1, dtype=int), 4 * np.arange(chain + 1)], axis=1)
    between = cells[:-1] + np.array([0, 2])
    shape = (1, 4 * chain + 1)
    for last in (cells[:1], cells[-1:]):
        assert match_cells(np.concatenate([between, last]), cells, shape).all()
        assert match_cells(np.concatenate([between, last, last]), cells, shape).tolist() == [True] * (chain + 1) + [
            False
        ]


@given(st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_matching_is_the_best_at_every_threshold(seed: int) -> None:
    """Against every choice of pairs, in images small enough to try them all."""
    truth, level = far(smooth((4, 13), seed)), far(smooth((4, 13), seed + 1)) * 2.0
    score = far(smooth((4, 13), seed + 2))
    found = scores(truth, level, score, 3.0)
    outcome = slow_outcome(truth, level, score, 3.0)
    assert found.truths == len(truth_cells(truth, 3.0, 6, STEP))
    for threshold, matched, false in outcome:
        assert (np.sum(found.matched >= threshold), np.sum(found.false_alarms >= threshold)) == (matched, false)


# What the metric must say


def test_the_truth_scores_one_and_an_empty_image_nothing() -> None:
    frames = [far(smooth((60, 90), seed)) for seed in range(4)]
    ceiling = pooled([scores(truth, truth, noise_power=0.1) for truth in frames])
    assert ceiling.truths.min() > 100
    assert ceiling.average_precision() == 1.0
    assert ceiling.values((0.0,))[1] == 1.0
    empty = pooled([scores(truth, np.zeros_like(truth), noise_power=0.1) for truth in frames])
    assert empty.average_precision() == 0.0
    assert empty.values((100.0,))[1] == 0.0
    assert [curve.tolist() for curve in empty.curve()] == [[], []]
    # Neither depends on the unit of the images.
    tiny = [scores(1e-9 * truth, 1e-9 * truth, noise_power=1e-19) for truth in frames]
    assert pooled(tiny).average_precision() == 1.0


def test_noise_alone_has_the_expected_number_of_false_alarms() -> None:
    """Of independent pixels one in nine is the largest of its window, one in six at an edge, one in four in a corner.
    Of the inner ones (1 - F^9) / 9 also exceed a level that a pixel stays below with the probability F."""
    rows, columns, frames = 90, 140, 12
    generator = np.random.default_rng(3)
    found = []
    for _ in range(frames):
        image = generator.rayleigh(size=(rows, columns))
        found.append(scores(np.zeros_like(image), image))
    alarms = np.concatenate([one.false_alarms for one in found])
    # Row 34 is the first beyond 5 m and an inner one; the last has three neighbours less.
    judged = rows - 34
    inner = (judged - 1) * (columns - 2)
    expected = frames * (inner / 9 + (columns - 2 + 2 * (judged - 1)) / 6 + 2 / 4)
    assert len(alarms) == pytest.approx(expected, abs=4 * np.sqrt(expected))
    level = 3.0
    above = frames * (judged * columns) * (1.0 - (1.0 - np.exp(-(level**2) / 2)) ** 9) / 9
    assert np.sum(alarms > level) == pytest.approx(above, abs=4 * np.sqrt(above))
    ranking = pooled(found)
    assert not ranking.defined
    assert np.isnan(ranking.values((10.0,))).all()
    assert np.isnan([one.value for one in ranking.intervals((1, 10))]).all()
    # Beside a frame with truth they cost precision.
    truth = far(dots((9, 30), (4, 7, 1.0)))
    assert pooled([*found, scores(truth, truth)]).average_precision() < 0.01


def test_shuffling_detections_of_equal_score_changes_nothing() -> None:
    generator = np.random.default_rng(0)
    places = local_maxima(smooth((12, 40), 1))
    # Three scores in all, so that most detections share theirs: turned images hold them in another order.
    truth, level = smooth((12, 40), 2), 30.0 * smooth((12, 40), 3)
    score = np.zeros_like(level)
    for row, column in places.tolist():
        score[row, column] = generator.integers(1, 4)
    turned = []
    for rows, columns in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        shown = [far(image[::rows, ::columns]) for image in (truth, level, score)]
        found = scores(shown[0], shown[1], shown[2])
        turned.append((found.truths, found.matched.tolist(), found.false_alarms.tolist()))
    assert turned[1:] == [turned[0]] * 3
    assert len(turned[0][1]) > 10
    assert len(turned[0][2]) > 3
    # Pooled: whatever the order of frames and of detections within one.
    hits, alarms = np.array([3.0, 2.0, 2.0, 1.0]), np.array([3.0, 2.0, 2.0, 2.0])
    found = CellScores(hits, alarms, 6)
    mixed = CellScores(hits[::-1], alarms[[3, 1, 0, 2]], 6)
    other = CellScores(np.array([2.0]), np.array([2.0, 1.0]), 2)
    for order in permutations([found, other]):
        assert pooled(order).average_precision() == pooled([mixed, other]).average_precision()


# Ranking


def test_average_precision_by_hand() -> None:
    # Matched at 5, 3 and 1, false at 4 and 3: precision 1/1, then 2/4 at the shared score, then 3/5; one cell missed.
    ranking = pooled([CellScores(np.array([5.0, 3.0, 1.0]), np.array([4.0, 3.0]), 4)])
    assert ranking.average_precision() == pytest.approx((1.0 + 2 / 4 + 3 / 5) / 4)
    assert ranking.values((0, 1, 1.9, 2, 100))[1:].tolist() == [0.25, 0.25, 0.25, 0.75, 0.75]
    false, detected = ranking.curve()
    assert false.tolist() == [0.0, 1.0, 2.0, 2.0]
    assert detected.tolist() == [0.25, 0.25, 0.5, 0.75]
    # Two such frames have the same precision, and the number of false alarms is that of one.
    twice = pooled([CellScores(np.array([5.0, 3.0, 1.0]), np.array([4.0, 3.0]), 4)] * 2)
    assert twice.average_precision() == pytest.approx(ranking.average_precision())
    assert twice.values((1,))[1] == 0.25


def some_frames(count: int, seed: int, detections: int = 30) -> list[CellScores]:
    """Scores in steps of a quarter, so that many are equal; the matched ones higher as a rule."""
    generator = np.random.default_rng(seed)

    def falling(number: int, shift: float) -> NDArray:
        return -np.sort(-np.round(4.0 * (generator.standard_normal(number) + shift)) / 4.0)

    numbers = generator.integers(0, detections, (count, 2))
    return [CellScores(falling(m, 1.0), falling(f, 0.0), int(m) + 5) for m, f in numbers]


@pytest.mark.parametrize("seed", range(2))
def test_average_precision_is_the_area_under_the_steps(seed: int) -> None:
    frames = some_frames(6, seed)
    outcomes = [(score, True) for one in frames for score in one.matched]
    outcomes += [(score, False) for one in frames for score in one.false_alarms]
    ranking = pooled(frames)
    truths = sum(one.truths for one in frames)
    assert ranking.average_precision() == pytest.approx(slow_average_precision(outcomes, truths))
    for most in (0.5, 3.0, 1e9):
        allowed = [
            sum(hit for score, hit in outcomes if score >= threshold) / truths
            for threshold in {score for score, _ in outcomes}
            if sum(not hit for score, hit in outcomes if score >= threshold) <= most * len(frames)
        ]
        assert ranking.values((most,))[1] == pytest.approx(max(allowed, default=0.0))


def test_intervals_are_those_of_frames_drawn_again() -> None:
    frames = some_frames(40, 9)
    found = pooled(frames).intervals((1, 10), seed=1)
    assert found == pooled(frames).intervals((1, 10), seed=1)
    generator = np.random.default_rng(2)
    draws: list[Ranking] = [pooled([frames[index] for index in generator.integers(40, size=40)]) for _ in range(600)]
    values = np.array([one.values((1, 10)) for one in draws])
    for interval, of_draws in zip(found, values.T, strict=True):
        low, high = np.percentile(of_draws, [2.5, 97.5])
        width = high - low
        assert interval.low == pytest.approx(low, abs=0.2 * width)
        assert interval.high == pytest.approx(high, abs=0.2 * width)
        assert interval.low < interval.value < interval.high
    alone = pooled(frames[:1]).intervals((1,))
    assert alone[0].value == pooled(frames[:1]).average_precision()
    assert np.isnan([alone[0].low, alone[0].high]).all()
    # Nothing but hits at every frame: no spread.
    sure = pooled([CellScores(np.array([2.0, 1.0]), np.empty(0), 2)] * 5).intervals((1,))
    assert [(one.value, one.low, one.high) for one in sure] == [(1.0, 1.0, 1.0)] * 2


def test_fewer_thresholds_hardly_move_the_intervals() -> None:
    generator = np.random.default_rng(4)
    frames = [
        CellScores(-np.sort(-generator.normal(1.0, 1.0, 900)), -np.sort(-generator.standard_normal(2000)), 1000)
        for _ in range(8)
    ]
    ranking = pooled(frames)
    assert len(ranking.last) > 3 * LEVELS
    of_draw = [pooled([frame] * 8).average_precision() for frame in frames]
    (interval,) = ranking.intervals(())
    assert min(of_draw) < interval.low < ranking.average_precision() < interval.high < max(of_draw)
    assert ranking.average_precision() == pytest.approx(np.mean(of_draw), abs=5e-3)


@pytest.mark.parametrize(
    ("call", "source"),
    [
        (lambda: truth_cells(np.zeros(4), 0.0, 6, STEP), "truth"),
        (lambda: truth_cells(np.full((3, 3), np.nan), 0.0, 6, STEP), "truth"),
        (lambda: scores(np.zeros((3, 3)), np.zeros((3, 4))), "images"),
        (lambda: scores(np.zeros((3, 3)), np.zeros((3, 3)), np.full((3, 3), np.inf)), "score"),
    ],
)  # fmt: skip
def test_what_cannot_be_scored_is_refused(call, source: str) -> None:
    with pytest.raises(InputError, match=f"^{source}: "):
        call()
