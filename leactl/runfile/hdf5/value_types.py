"""Types of stored values, looked at before h5py makes NumPy types or values of them.

h5py needs 0.9 GB for the NumPy type of 2000 arrays in one another, whose header has 50 kB. An attribute whose values
have any length may refer to one of 16 MB as often as it likes. HDF5's own class of a type costs nothing.
"""

from collections.abc import Callable
from typing import Any, Final

import h5py

from leactl.yamlfile import shown

NUMBERS_AND_TEXTS: Final = {h5py.h5t.INTEGER, h5py.h5t.FLOAT, h5py.h5t.STRING, h5py.h5t.ENUM}
MOST_MEMBERS: Final = 256  # of an enumeration or a compound; a truth value has 2, a complex number 2


def is_plain(type_id: Any) -> bool:
    """Whether values of a type are numbers, texts or members of a short enumeration."""
    kind = type_id.get_class()
    return kind in NUMBERS_AND_TEXTS and (kind != h5py.h5t.ENUM or type_id.get_nmembers() <= MOST_MEMBERS)


def is_shallow(type_id: Any) -> bool:
    """Whether a type is plain, a compound of plain ones, or of a class without members, such as a reference."""
    kind = type_id.get_class()
    if kind == h5py.h5t.COMPOUND:
        members = type_id.get_nmembers()
        return members <= MOST_MEMBERS and all(is_plain(type_id.get_member_type(number)) for number in range(members))
    return is_plain(type_id) or kind not in (*NUMBERS_AND_TEXTS, h5py.h5t.ARRAY, h5py.h5t.VLEN)


def is_text_of_any_length(type_id: Any) -> bool:
    """Whether values of a type are references to texts in the file's heaps."""
    return type_id.get_class() == h5py.h5t.STRING and bool(type_id.is_variable_str())


def faults_of_attribute_types(item: Any, hdf5_path: str, is_read: Callable[[bytes], bool]) -> list[str]:
    """One line for each attribute of an object that is read and holds neither numbers nor text."""
    return [
        f"{hdf5_path}: attribute {shown(name.decode('utf-8', 'replace'))} holds neither numbers nor text"
        for name in attribute_names(item)
        if is_read(name) and not is_plain(h5py.h5a.open(item, name).get_type())
    ]


def attribute_names(item: Any) -> list[bytes]:
    """Names of an object's attributes."""
    names: list[bytes] = []
    h5py.h5a.iterate(item, names.append)
    return names
