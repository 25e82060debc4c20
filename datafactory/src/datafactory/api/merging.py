"""Jobs of an array to one dataset: :func:`datafactory.merge`."""

from __future__ import annotations

from pathlib import Path

from datafactory.api.declared import taking
from datafactory.api.options import MergeOptions
from datafactory.run import merging
from datafactory.run.pipeline import Report
from shared.dataset.locations import local


@taking(MergeOptions)
def merge(asked: MergeOptions) -> Report:
    """Join the jobs of an array into the dataset of the run in one piece, as ``datafactory merge`` does.

    >>> merge("build/jobs", "build/dataset")  # doctest: +SKIP

    :returns: what is in the dataset; its shards and its manifest, but for ``made``, have the bytes of the run in one
        piece
    :raises InputError: frames or jobs are missing, arguments differ, shards are damaged, the disk has no room; before
        anything is written
    :raises OSError: the disk fails; what was done can be resumed
    """
    several = [asked.folders] if isinstance(asked.folders, str | Path) else asked.folders
    folders, out = [local(folder, "DIR") for folder in several], local(asked.out, "--out")
    return merging.merge(folders, out, asked.resume, asked.announce, asked.progress)
