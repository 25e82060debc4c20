"""What is done with finished datasets: another layout, :func:`datafactory.convert`; the jobs of an array as one
dataset, :func:`datafactory.merge`.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from datafactory.api.declared import taking
from datafactory.api.options import ConvertOptions, MergeOptions
from datafactory.conversion import formats
from datafactory.conversion.formats import Converted
from datafactory.run import merging
from datafactory.run.pipeline import Report
from shared.dataset.folder import open_dataset
from shared.dataset.locations import local


@taking(ConvertOptions)
def convert(asked: ConvertOptions) -> Converted:
    """Write a dataset in another layout, as ``datafactory convert`` does.

    >>> convert("build/dataset", "build/mcap", to="mcap")  # doctest: +SKIP

    :returns: how many frames were written, and what has no place in the new layout
    :raises InputError: an unknown format, a folder that is there already, a package that is not installed
    :raises OSError: the disk fails; nothing is left behind
    """
    dataset = open_dataset(str(asked.directory))
    return formats.convert(dataset, asked.to, local(asked.out, "--out"), partial(asked.progress, "frames"))


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
