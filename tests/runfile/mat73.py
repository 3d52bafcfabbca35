"""MAT files of version 7.3 as MATLAB writes them with `save -v7.3`: HDF5 behind a block of 512 bytes, columns first."""

import h5py
import numpy as np

HEADER = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Fri Nov 20 10:15:30 2026 HDF5 schema 1.00 ."
CLASSES = {"f8": "double", "f4": "single", "u1": "uint8", "i2": "int16", "i4": "int32", "u4": "uint32", "b1": "logical"}
CHARACTERS, LOGICAL = 2, 1  # MATLAB_int_decode
OBJECT = 3  # MATLAB_object_decode
MAGIC = 0xDD000000  # of an object's numbers


class Object:
    """A MATLAB object of this class, such as a timeseries: six numbers that point into `#subsystem#`."""

    def __init__(self, kind):
        self.kind = kind


class Sparse:
    """A sparse matrix of one column."""


def save(path, content):
    """Write variables: numbers, texts, dicts as structs, lists as cells, lists of dicts as arrays of structs."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in content.items():
            _put(file, name, value)
    with open(path, "r+b") as file:
        file.write(HEADER.ljust(124) + b"\x00\x02IM")


def _put(parent, name, value):
    if isinstance(value, dict):
        _struct(parent, name, value)
    elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
        group = _struct(parent, name, {})
        for field in value[0]:
            _references(group, field, [item[field] for item in value])
    elif isinstance(value, list):
        _references(parent, name, value).attrs["MATLAB_class"] = np.bytes_("cell")
    elif isinstance(value, str | np.ndarray) and np.asarray(value).dtype.kind == "U":
        codes = np.array([[ord(c) for c in row] for row in np.atleast_1d(value)], "u2")
        _array(parent, name, codes.T, "char", MATLAB_int_decode=CHARACTERS)
    elif isinstance(value, Object):
        numbers = np.array([[MAGIC, 2, 1, 1, 1, 1]], "u4")
        _array(parent, name, numbers, value.kind, MATLAB_object_decode=OBJECT)
    elif isinstance(value, Sparse):
        group = parent.create_group(name)
        group.attrs["MATLAB_class"], group.attrs["MATLAB_sparse"] = np.bytes_("double"), np.uint64(400)
        group["data"], group["ir"], group["jc"] = np.ones(2), np.array([0, 1], "u8"), np.array([0, 2], "u8")
    else:
        _numbers(parent, name, np.asarray(value))


def _numbers(parent, name, value):
    """An array; a vector becomes a column."""
    array = np.atleast_1d(value)
    array = array[:, np.newaxis] if array.ndim == 1 else array
    if not array.size:
        _array(parent, name, np.array(array.shape, "u8"), "double", MATLAB_empty=1)
    elif array.dtype.kind == "c":
        parts = np.empty(array.T.shape, [("real", "f8"), ("imag", "f8")])
        parts["real"], parts["imag"] = array.T.real, array.T.imag
        _array(parent, name, parts, "double")
    elif array.dtype.kind == "b":
        _array(parent, name, array.T.astype("u1"), "logical", MATLAB_int_decode=LOGICAL)
    else:
        _array(parent, name, array.T, CLASSES[array.dtype.str[1:]])


def _array(parent, name, stored, kind, **attributes):
    chunked = {"chunks": True, "compression": 3} if stored.size > 100 else {}
    dataset = parent.create_dataset(name, data=stored, **chunked)
    dataset.attrs["MATLAB_class"] = np.bytes_(kind)
    for key, value in attributes.items():
        dataset.attrs[key] = np.int32(value)


def _struct(parent, name, fields):
    group = parent.create_group(name)
    group.attrs["MATLAB_class"] = np.bytes_("struct")
    if fields:
        letters = np.empty(len(fields), object)
        letters[:] = [np.array(list(field), "S1") for field in fields]
        group.attrs.create("MATLAB_fields", letters, dtype=h5py.vlen_dtype(np.dtype("S1")))
    for field, value in fields.items():
        _put(group, field, value)
    return group


def _references(parent, name, values):
    room = parent.file.require_group("#refs#")
    dataset = parent.create_dataset(name, (len(values), 1), h5py.ref_dtype)
    for row, value in enumerate(values):
        label = f"v{len(room)}"
        _put(room, label, value)
        dataset[row, 0] = room[label].ref
    return dataset
