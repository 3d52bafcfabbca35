"""Check the types of stored values before h5py creates NumPy types or values from them.

h5py needs 0.9 GB for the NumPy type of 2000 nested arrays, whose header has 50 kB. An attribute with values of variable
length may refer to one value of 16 MB any number of times. The HDF5 class of a type can be read without such costs.
"""

from collections.abc import Callable
from typing import Any, Final

import h5py

from leactl.yamlfile import shown

NUMBERS_AND_TEXTS: Final = {h5py.h5t.INTEGER, h5py.h5t.FLOAT, h5py.h5t.STRING, h5py.h5t.ENUM}
MOST_MEMBERS: Final = 256  # of an enumeration or a compound; a boolean has 2, a complex number 2
NUMBERS_OF_OTHER_TYPES: Final = {
    h5py.h5t.ARRAY: "arrays as single values",
    h5py.h5t.BITFIELD: "bit fields",
}
NEITHER_NUMBERS_NOR_TEXTS: Final = {
    h5py.h5t.COMPOUND: "compounds of several values",
    h5py.h5t.ENUM: f"an enumeration of more than {MOST_MEMBERS} members",
    h5py.h5t.OPAQUE: "opaque bytes",
    h5py.h5t.REFERENCE: "references",
    h5py.h5t.TIME: "times",
    h5py.h5t.VLEN: "lists of any length",
}


def is_plain(type_id: Any) -> bool:
    """Return whether values of a type are numbers, texts or members of a short enumeration."""
    type_class = type_id.get_class()
    return type_class in NUMBERS_AND_TEXTS and (type_class != h5py.h5t.ENUM or type_id.get_nmembers() <= MOST_MEMBERS)


def is_shallow(type_id: Any) -> bool:
    """Return whether a type is plain, a compound of plain types, or a class without members, such as a reference."""
    type_class = type_id.get_class()
    if type_class == h5py.h5t.COMPOUND:
        member_count = type_id.get_nmembers()
        return member_count <= MOST_MEMBERS and all(
            is_plain(type_id.get_member_type(number)) for number in range(member_count)
        )
    return is_plain(type_id) or type_class not in (*NUMBERS_AND_TEXTS, h5py.h5t.ARRAY, h5py.h5t.VLEN, h5py.h5t.TIME)


def description_of_type(type_id: Any, expected: str = "text") -> str:
    """Describe a type that is not plain, for a message: what its values are, and what was expected.

    `expected` names the values besides numbers that were expected.
    """
    type_class = type_id.get_class()
    if is_complex(type_id):
        return f"complex numbers; real ones or {expected} were expected"
    if type_class in NUMBERS_OF_OTHER_TYPES:
        return f"{NUMBERS_OF_OTHER_TYPES[type_class]}; numbers or {expected} were expected"
    description = NEITHER_NUMBERS_NOR_TEXTS.get(type_class, "values of a type that is not known")
    return f"neither numbers nor {expected} but {description}"


def is_complex(type_id: Any) -> bool:
    """Return whether values of a type are complex numbers; h5py stores them as compounds of `r` and `i`."""
    type_class = type_id.get_class()
    if type_class != h5py.h5t.COMPOUND:
        return bool(type_class == getattr(h5py.h5t, "COMPLEX", None))  # a class of its own from HDF5 2.0 on
    names = [type_id.get_member_name(number) for number in range(min(3, type_id.get_nmembers()))]
    return names in ([b"r", b"i"], [b"real", b"imag"])


def is_text_of_any_length(type_id: Any) -> bool:
    """Return whether values of a type are references to texts in the file's heaps."""
    return type_id.get_class() == h5py.h5t.STRING and bool(type_id.is_variable_str())


def faults_of_attribute_types(item: Any, hdf5_path: str, is_read: Callable[[bytes], bool]) -> list[str]:
    """Return one line for each attribute of an object whose value is read and whose type is not plain.

    Parameters
    ----------
    is_read : returns by its name whether the value of an attribute is read.
    """
    faults = []
    for name in filter(is_read, attribute_names(item)):
        if not is_plain(type_id := h5py.h5a.open(item, name).get_type()):
            text = shown(name.decode("utf-8", "replace"))
            faults.append(f"{hdf5_path}: attribute {text} holds {description_of_type(type_id)}")
    return faults


def attribute_names(item: Any) -> list[bytes]:
    """Return the names of an object's attributes."""
    names: list[bytes] = []
    h5py.h5a.iterate(item, names.append)
    return names
