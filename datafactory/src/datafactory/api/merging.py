"""Jobs of an array to one dataset: :func:`datafactory.merge`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from datafactory.api.options import Announce, FileName, Progress, silent
from datafactory.run import merging
from datafactory.run.pipeline import Report
from shared.dataset.locations import local


def merge(
    folders: FileName | Sequence[FileName],
    out: FileName,
    *,
    resume: bool = False,
    announce: Announce = silent,
    progress: Progress = silent,
) -> Report:
    """Join the jobs of an array into the dataset of the run in one piece, as ``datafactory merge`` does.

    >>> merge("build/jobs", "build/dataset")  # doctest: +SKIP

    :param folders: the ``out`` of jobs that were made with ``shard``, one for all or several; or single jobs' folders
    :param out: folder of the dataset; new or empty, or with ``resume`` that of a merge that was killed
    :param resume: go on with a merge that was killed
    :param announce: takes lines for the user
    :param progress: takes what is being done, how much of it is done, and of how much
    :returns: what is in the dataset; its shards and its manifest, but for ``made``, have the bytes of the run in one
        piece
    :raises InputError: frames or jobs are missing, arguments differ, shards are damaged, the disk has no room; before
        anything is written
    :raises OSError: the disk fails; what was done can be resumed
    """
    several: Sequence[FileName] = (folders,) if isinstance(folders, str | Path) else folders
    return merging.merge([local(folder, "DIR") for folder in several], local(out, "--out"), resume, announce, progress)
