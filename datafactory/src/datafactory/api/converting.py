"""Datasets in other layouts: :func:`datafactory.convert`."""

from __future__ import annotations

from functools import partial

from datafactory.api.options import FileName, Progress, silent
from datafactory.conversion import formats
from datafactory.conversion.formats import Converted
from shared.dataset.folder import open_dataset
from shared.dataset.locations import local


def convert(directory: FileName, out: FileName, *, to: str, progress: Progress = silent) -> Converted:
    """Write a dataset in another layout, as ``datafactory convert`` does.

    >>> convert("build/cubes", "build/raddet", to="raddet")  # doctest: +SKIP

    :param directory: folder of a finished dataset; local, ``s3://`` or ``gs://``
    :param out: a folder that does not exist yet; it is there once it is whole
    :param to: "raddet" for the layout of RADDet, of a dataset with cubes; "mcap" for files that Foxglove opens
    :param progress: takes what is being done, how much of it is done, and of how much
    :returns: how many frames were written, and what has no place in the new layout
    :raises InputError: an unknown format, a folder that is there already, a dataset without what the format needs
    :raises OSError: the disk fails; nothing is left behind
    """
    dataset = open_dataset(str(directory))
    return formats.convert(dataset, to, local(out, "--out"), partial(progress, "frames"))
