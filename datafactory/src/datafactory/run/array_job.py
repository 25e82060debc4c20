"""One of several jobs that make a dataset together: which shards are its own, where they lie, what it says of itself.

Whole shards are dealt to the jobs, so that their bytes are those of the run in one piece. Each job has a folder of its
own: nothing that two machines write to is shared, and no lock has to reach from one to the other.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from datafactory.frame.index import split_of
from datafactory.run.shards import PATHS, ShardPlan, plan_shards
from shared.physics.errors import InputError

OPTION = "--shard"
ARGUMENT = "shard"
"""Among the ``arguments`` of a job's manifest, which are otherwise those of the run in one piece."""
ENTRY = "job"
"""Entry of a job's manifest, see :class:`JobEntry`."""

EXPECTED = "i/n with i from 0 to n - 1, e.g. 0/16 to 15/16 for `sbatch --array=0-15`"


@dataclass(frozen=True)
class ArrayJob:
    """Job ``number`` of ``of``.

    :param number: from 0
    """

    number: int
    of: int

    def __post_init__(self) -> None:
        if not 0 <= self.number < self.of:
            raise InputError(OPTION, f"{str(self)!r}", EXPECTED)

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    @property
    def folder(self) -> str:
        """Name of its folder; those of all jobs sort by their numbers."""
        return f"job-{self.number:0{len(str(self.of - 1))}d}-of-{self.of}"

    def own(self, plans: Sequence[ShardPlan]) -> tuple[ShardPlan, ...]:
        """Its shards among those of the dataset: every ``of``-th, so that each job has shards of every split and scene.

        :raises InputError: more jobs than shards
        """
        if self.of > len(plans):
            raise InputError(OPTION, f"{self.of} jobs for {len(plans)} shards", f"at most {len(plans)} jobs")
        return tuple(plans[self.number :: self.of])


def parse_job(text: str) -> ArrayJob:
    """Job ``i/n``.

    :raises InputError: anything else
    """
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
    if found is None:
        raise InputError(OPTION, repr(text), EXPECTED)
    return ArrayJob(int(found[1]), int(found[2]))


def is_job_folder(name: str) -> bool:
    """Whether :attr:`ArrayJob.folder` may be called so."""
    return re.fullmatch(r"job-[0-9]+-of-[0-9]+", name) is not None


class JobEntry(BaseModel):
    """What a job's manifest says beside what every manifest does.

    :param frames: of the whole dataset
    :param split: pattern of the whole dataset; None for traced paths
    :param counts: of each of the job's shards, in the manifest's order
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    frames: Annotated[int, Field(ge=1)]
    split: str | None
    counts: tuple[dict[str, int | float], ...]

    def plans(self) -> tuple[ShardPlan, ...]:
        """The shards of the whole dataset.

        :raises InputError: a split pattern that is none
        """
        if self.split is None:
            return plan_shards((PATHS,) * self.frames)
        return plan_shards([split_of(frame_id, self.split) for frame_id in range(self.frames)])
