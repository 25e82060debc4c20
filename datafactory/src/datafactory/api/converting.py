"""Datasets in other layouts: :func:`datafactory.convert`."""

from __future__ import annotations

from functools import partial

from datafactory.api.declared import taking
from datafactory.api.options import ConvertOptions
from datafactory.conversion import formats
from datafactory.conversion.formats import Converted
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
