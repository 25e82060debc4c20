"""In which order frames are seen: a function of the seed alone, so that a run can be taken up at any batch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from torch.utils.data import Sampler


class BatchOrder(Sampler[list[int]]):
    """Batches of indices into several datasets laid end to end.

    An epoch has as many frames as all datasets together; with weights, each dataset gets its share of them, frames of
    a small one coming more often. A batch may reach into the next epoch, so that all have the same size.

    :param sizes: frames of each dataset
    :param weights: share of each dataset, any positive numbers; by default in proportion to the sizes
    :param batch: frames of a batch on all processes together
    :param seed: of the order
    :param batches: batches of the whole run
    :param first: batches to leave out, those that an earlier run has seen
    :param rank, world: the process and how many there are: each gets its part of every batch
    """

    def __init__(
        self,
        sizes: Sequence[int],
        weights: Sequence[float] | None,
        batch: int,
        seed: int,
        batches: int,
        first: int = 0,
        rank: int = 0,
        world: int = 1,
    ) -> None:
        self.sizes = tuple(sizes)
        self.shares = np.array(weights if weights is not None else sizes, dtype=np.float64)
        self.batch, self.seed, self.batches, self.first = batch, seed, batches, first
        self.part = slice(rank * batch // world, (rank + 1) * batch // world)

    def __len__(self) -> int:
        """Batches of the whole run, seen ones included: what a progress bar and a step count go by."""
        return self.batches

    def __iter__(self) -> Iterator[list[int]]:
        frames = sum(self.sizes)
        epoch, frames_of_epoch = -1, np.empty(0, dtype=np.int64)
        for index in range(self.first, self.batches):
            chosen: list[int] = []
            for place in range(index * self.batch, (index + 1) * self.batch):
                if place // frames != epoch:
                    epoch = place // frames
                    frames_of_epoch = self._epoch(epoch)
                chosen.append(int(frames_of_epoch[place % frames]))
            yield chosen[self.part]

    def _epoch(self, epoch: int) -> NDArray[np.int64]:
        """[frames] order of one epoch."""
        generator = np.random.default_rng([self.seed, epoch])
        frames = sum(self.sizes)
        edges = np.round(np.cumsum(self.shares) / self.shares.sum() * frames).astype(int)
        counts = np.diff(edges, prepend=0)
        starts = np.cumsum((0, *self.sizes[:-1]))
        drawn = []
        for start, size, count in zip(starts, self.sizes, counts, strict=True):
            rounds = [generator.permutation(size) for _ in range(-(-int(count) // size))]
            drawn.append(start + np.concatenate([np.empty(0, np.int64), *rounds])[:count])
        return generator.permutation(np.concatenate(drawn))
