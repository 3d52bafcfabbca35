"""Rewrite closed runs in the HDF5 format of the writer, for libraries that cannot read newer formats."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from leactl.errors import InputError
from leactl.runfile import layout
from leactl.runfile.hdf5.opening import open_run_file, reading
from leactl.runfile.hdf5.space import reserve, trim
from leactl.runfile.publish import replacement
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import checksums


def convert(path: Path) -> None:
    """Rewrite a run in place; every name, attribute and value stays the same.

    Raises
    ------
    InputError : not a run file, a run that is still being written, or a checksum that does not match.
    """
    with Run.open(path) as run:
        if run.unfinished:
            raise InputError(f"{path}: still being written or left by a kill; close or recover it first")
    checksums_before = checksums(path)
    with replacement(path) as copy:
        source, _ = open_run_file(path)
        with source, reading(path), h5py.File(copy, "w", libver=layout.HDF5_FORMAT) as target:
            reserve(target, 0)
            copy_group(source, target)
            attach_scales(source, target)
        trim(copy)
        if checksums(copy) != checksums_before:
            raise InputError(f"{path}: the rewritten copy does not hold the same values; the file is as it was")


def copy_group(source: Any, target: Any) -> None:
    """Copy a group's attributes and members into an empty group."""
    layout.copy_attributes(source, target)
    for name, item in source.items():
        if isinstance(item, h5py.Dataset):
            copy_dataset(item, target)
        else:
            copy_group(item, target.create_group(name, track_order=True))


def copy_dataset(source: Any, target: Any) -> None:
    """Copy a dataset block by block, with its shape, chunks and compression."""
    storage_keys = ("dtype", "maxshape", "chunks", "compression", "compression_opts", "shuffle", "fillvalue")
    storage = {key: getattr(source, key) for key in storage_keys} if source.chunks else {"dtype": source.dtype}
    dataset = target.create_dataset(source.name.rsplit("/", 1)[-1], source.shape, **storage)
    starts = range(0, len(source), layout.BLOCK_ROWS) if source.shape else ()
    blocks = [slice(start, start + layout.BLOCK_ROWS) for start in starts] if source.shape else [()]
    for block in blocks:
        values = source[block]
        reserve(dataset.file, stored_bytes(values))
        dataset[block] = values
    layout.copy_attributes(source, dataset)


def stored_bytes(values: Any) -> int:
    """Return the bytes that values take in a file, with 64 for HDF5's reference to each string of variable length."""
    array = np.asarray(values)
    return sum(len(text) + 64 for text in array.flat) if array.dtype == object else array.nbytes


def attach_scales(source: Any, target: Any) -> None:
    """Attach the dimension scales of the source's datasets to those of the target."""
    for hdf5_path, dataset in layout.datasets(source):
        if dataset.is_scale:
            target[hdf5_path].make_scale(hdf5_path.rsplit("/", 1)[-1])
    for hdf5_path, dataset in layout.datasets(source):
        for axis, dimension in enumerate(dataset.dims) if dataset.shape else ():
            for scale in dimension.values():
                target[hdf5_path].dims[axis].attach_scale(target[scale.name])
