"""Finished run files spoiled: bytes as disks and transfers spoil them, and the tree as other programs and people do.

A mutation of the tree returns False where it could do nothing to the file that it was given.
"""

import random
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np

from leactl.runfile import layout

OF_SCALES = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "DIMENSION_LABELS")  # HDF5's own, in no seal
TEXTS = (
    "", "abc", "nan", "1e400", "-1", "9" * 5000, "[" * 3000, "{" * 3000, '{"a": ' * 500, "[1, [2, [3", "{'a': 1}",
    "null", "\x1b[2J\x07", "\u202eabc", "../../etc/passwd", "{a: {b: 1}}", "&a [*a]", "!!python/object:os.system x",
    "x" * 60_000,
)  # fmt: skip
NUMBERS = (0, -1, 2**63 - 1, -(2**63), 1e308, -1e308, 5e-324, float("nan"), float("inf"), True)
HUGE = 10**12  # values that a dataset announces and does not hold


def flipped(rng: random.Random, raw: bytes) -> bytes:
    """A few bytes replaced, mostly in one neighbourhood."""
    spoiled, at = bytearray(raw), rng.randrange(len(raw))
    for _ in range(rng.randint(1, 20)):
        spoiled[min(len(raw) - 1, at + rng.randrange(200))] = rng.randrange(256)
    return bytes(spoiled)


def truncated(rng: random.Random, raw: bytes) -> bytes:
    """Cut off anywhere."""
    return raw[: rng.randrange(len(raw))]


def zeroed(rng: random.Random, raw: bytes) -> bytes:
    """A block of a disk, or a part of it, with nothing in it."""
    at, length = rng.randrange(len(raw)), rng.choice((1, 8, 64, 512, 4096))
    return raw[:at] + bytes(len(raw[at : at + length])) + raw[at + length :]


def repeated(rng: random.Random, raw: bytes) -> bytes:
    """A block written over another, or put in once more."""
    at, to, length = rng.randrange(len(raw)), rng.randrange(len(raw)), rng.choice((8, 64, 512, 4096))
    block = raw[at : at + length]
    return raw[:to] + block + raw[to + rng.choice((0, len(block))) :]


def lost(rng: random.Random, raw: bytes) -> bytes:
    """A block missing in the middle."""
    at = rng.randrange(len(raw))
    return raw[:at] + raw[at + rng.choice((1, 8, 512, 4096)) :]


def headed(rng: random.Random, raw: bytes) -> bytes:
    """Bytes of the superblock replaced."""
    spoiled = bytearray(raw)
    spoiled[rng.randrange(48)] = rng.choice((0, 1, 4, 5, 127, 128, 255))
    return bytes(spoiled)


OF_BYTES: tuple[Callable[[random.Random, bytes], bytes], ...] = (flipped, truncated, zeroed, repeated, lost, headed)


def places(file: Any) -> tuple[list[str], list[str]]:
    """Paths of the groups below the root and of the datasets."""
    groups: list[str] = []
    datasets: list[str] = []
    file.visititems(lambda name, item: (groups if isinstance(item, h5py.Group) else datasets).append(f"/{name}"))
    return groups, datasets


def any_attribute(rng: random.Random, file: Any) -> tuple[Any, str]:
    """An object and the name of an attribute of it, each object as likely as another."""
    groups, datasets = places(file)
    nodes = [file[path] for path in ["/", "/", "/", *groups, *datasets]]
    node = rng.choice([node for node in nodes if set(node.attrs) - set(OF_SCALES)])
    return node, rng.choice(sorted(set(node.attrs) - set(OF_SCALES)))


def attribute_removed(rng: random.Random, file: Any) -> bool:
    """An attribute that is gone."""
    node, name = any_attribute(rng, file)
    del node.attrs[name]
    return True


def attribute_renamed(rng: random.Random, file: Any) -> bool:
    """An attribute under a name that nobody looks for."""
    node, name = any_attribute(rng, file)
    value = node.attrs[name]
    del node.attrs[name]
    node.attrs[rng.choice((name[:-1] + "_", name.upper() + "1", "\u202e" + name, "x" * 300))] = value
    return True


def attribute_replaced(rng: random.Random, file: Any) -> bool:
    """An attribute of another type or size."""
    node, name = any_attribute(rng, file)
    before = layout.to_python(node.attrs[name])
    value = rng.choice(
        [
            rng.choice(TEXTS),
            rng.choice(NUMBERS),
            np.arange(rng.choice((2, 1000))),
            np.full((3, 3), np.nan),
            np.array([rng.choice(TEXTS), "abc"], layout.TEXT),
            np.array([1 + 2j, 0]),
            h5py.Empty("f8"),
            np.array([(1, 2.0)], [("a", "i4"), ("b", "f8")]),
            np.void(b"\x00\x01\xff"),
            np.bytes_(b"\xff\xfe\x80"),
            file["/streams"].ref,
        ]
    )
    del node.attrs[name]
    node.attrs[name] = value
    return repr(layout.to_python(node.attrs[name])) != repr(before)


def attribute_huge(rng: random.Random, file: Any) -> bool:
    """More in one attribute, or more attributes, than anybody writes."""
    node, name = any_attribute(rng, file)
    match rng.randrange(3):
        case 0:
            del node.attrs[name]
            node.attrs.create(name, np.zeros(10**6))
        case 1:
            del node.attrs[name]
            node.attrs[name] = "x" * 4_000_000
        case _:
            for number in range(2000):
                node.attrs[f"more_{number}"] = number
    return True


def attribute_added(rng: random.Random, file: Any) -> bool:
    """An attribute that does not belong there, among them those that say how a channel is to be read."""
    groups, datasets = places(file)
    node = file[rng.choice(["/", *groups, *datasets])]
    names = ("skew", "scale_std", "location", "sampling", "drive_gain", "load_mass", "units", "sha256", "seal", "extra")
    name = rng.choice(names)
    if name in node.attrs:
        return False
    node.attrs[name] = rng.choice([*TEXTS, *NUMBERS, np.zeros(5)])
    return True


def removed(rng: random.Random, file: Any) -> bool:
    """A group or a dataset that is gone."""
    groups, datasets = places(file)
    del file[rng.choice(groups if rng.random() < 0.3 else datasets)]
    return True


def renamed(rng: random.Random, file: Any) -> bool:
    """A group or a dataset under another name, or where another of its kind stood."""
    groups, datasets = places(file)
    path = rng.choice(groups if rng.random() < 0.3 else datasets)
    if rng.random() < 0.3:
        other = rng.choice([item for item in datasets if item != path and not item.startswith(f"{path}/")])
        del file[other]
        file.move(path, other) if path in file else None
    else:
        file.move(path, path[:-1] + rng.choice(("_", "\u202e", "\x1b[2J", " ", "x" * 300)))
    return True


def emptied(rng: random.Random, file: Any) -> bool:
    """A group where a dataset was, a dataset where a group was, or a named type where either was."""
    groups, datasets = places(file)
    path = rng.choice(groups if rng.random() < 0.5 else datasets)
    group = isinstance(file[path], h5py.Group)
    del file[path]
    match rng.randrange(3):
        case 0 if not group:
            file.create_group(path)
        case 1:
            file[path] = np.dtype("f8")
        case _:
            file[path] = rng.choice([1.0, "abc", np.zeros((2, 2)), h5py.Empty("f8")])
    return True


def kind_of_values(rng: random.Random, file: Any) -> bool:
    """A dataset of another type, shape or length, its attributes kept."""
    path = rng.choice(places(file)[1])
    before = file[path]
    rows = len(before) if before.shape else 1
    attributes = {name: before.attrs[name] for name in before.attrs if name not in OF_SCALES}
    del before
    del file[path]
    compound = np.dtype([("a", "i4"), ("b", "f8")])
    values = rng.choice(
        [
            np.zeros(rows, "i2"),
            np.zeros(rows, "c16"),
            np.zeros(rows, "?"),
            np.zeros(rows, compound),
            np.zeros(rows, "S4"),
            np.zeros(rows, "V3"),
            np.zeros(rows, "f2"),
            np.zeros(rows, ">u8"),
            np.zeros((rows, 2)),
            np.zeros(rows + 1),
            np.zeros(0),
            np.zeros(1),
            np.float64(3.0),
            h5py.Empty("f8"),
            np.array(["abc"] * min(rows, 100), layout.TEXT),
            np.array([None] * 3, h5py.ref_dtype),
        ]
    )
    if isinstance(values, np.ndarray) and values.dtype == object and values.size and values[0] is None:
        file.create_dataset(path, (3,), h5py.ref_dtype)
    else:
        file[path] = values
    for name, value in attributes.items():
        file[path].attrs[name] = value
    return True


def announced(rng: random.Random, file: Any) -> bool:
    """A dataset of 1e12 values that were never written, in an object's place or beside it."""
    path = rng.choice(places(file)[1])
    attributes = {name: file[path].attrs[name] for name in file[path].attrs if name not in OF_SCALES}
    if rng.random() < 0.5:
        del file[path]
    else:
        path += "_more"
    kind = rng.choice(("f8", "i1", "S512", layout.TEXT))
    packed = {"compression": "gzip"} if rng.random() < 0.5 and kind != layout.TEXT else {}
    fill = 1.0 if kind == "f8" else None
    file.create_dataset(path, (HUGE,), kind, maxshape=(None,), chunks=(4096,), fillvalue=fill, **packed)
    for name, value in attributes.items():
        file[path].attrs[name] = value
    return True


def stamps(rng: random.Random, file: Any) -> bool:
    """Times that are missing, infinite, repeated, backwards or far away."""
    time = file[rng.choice([path for path in places(file)[1] if path.endswith("/time") and file[path].size > 9])]
    if time.dtype.kind != "f":
        return False
    values, at = time[:], rng.randrange(1, time.size - 1)
    match rng.randrange(8):
        case 0:
            values[at] = np.nan
        case 1:
            values[at] = rng.choice((np.inf, -np.inf))
        case 2:
            values[at] = values[at - 1]
        case 3:
            values = values[::-1]
        case 4:
            values[:] = values[0]
        case 5:
            values[at:] += rng.choice((1e9, 1e300))
        case 6:
            values *= rng.choice((1e-12, 1e12, 1e-320))
        case _:
            values[:] = np.nan
    time[:] = values
    return True


def numbers(rng: random.Random, file: Any) -> bool:
    """Values of a channel or of a table's column that no sensor gives."""
    path = rng.choice([path for path in places(file)[1] if file[path].dtype.kind in "fiu" and file[path].size])
    values = file[path][:]
    if values.dtype.kind == "f":
        at = slice(None) if rng.random() < 0.5 else slice(rng.randrange(values.size), None)
        values[at] = rng.choice((np.nan, np.inf, -np.inf, 0.0, 1e30, -1e30, 1e-40))
    else:
        values[:] = np.iinfo(values.dtype).max
    if np.array_equal(values, file[path][:], equal_nan=True):
        return False
    file[path][:] = values
    return True


def hostile_text(rng: random.Random, file: Any) -> bool:
    """A step's parameters, a name, a message or a source that is something else."""
    path = rng.choice([path for path in places(file)[1] if layout.is_text(file[path])])
    dataset = file[path]
    attributes = {name: dataset.attrs[name] for name in dataset.attrs if name not in OF_SCALES}
    shape = dataset.shape
    before = [layout.to_python(dataset[()])] if shape == () else layout.texts(dataset)
    text = rng.choice(TEXTS)
    after = [text] if shape == () else [text if rng.random() < 0.5 else item for item in before]
    del dataset
    del file[path]
    file[path] = text if shape == () else np.array(after, layout.TEXT)
    for name, value in attributes.items():
        file[path].attrs[name] = value
    return before != after


def linked(rng: random.Random, file: Any) -> bool:
    """A link in an object's place or beside it: to elsewhere, to nowhere, to itself, to what holds it."""
    groups, datasets = places(file)
    path = rng.choice([*groups, *datasets])
    if rng.random() < 0.5:
        del file[path]
    else:
        path += "_link"
    at = path.rsplit("/", 1)[0] or "/"
    link = rng.choice(
        [
            h5py.SoftLink("/nowhere"),
            h5py.SoftLink(path),
            h5py.SoftLink("/streams"),
            h5py.ExternalLink("/dev/zero", "/streams"),
            h5py.ExternalLink("nowhere.h5", "/streams"),
            h5py.ExternalLink(file.filename, "/streams"),
            file["/"],
            file[at],
        ]
    )
    file[path] = link
    return True


def twice(rng: random.Random, file: Any) -> bool:
    """An object under a second name."""
    groups, datasets = places(file)
    path, at = rng.choice([*groups, *datasets]), rng.choice(["", *groups])
    name = rng.choice(("again", "time", "steps", "notes", "seal", "source", "parameters", "instruments"))
    if f"{at}/{name}" in file:
        return False
    file[f"{at}/{name}"] = file[path]
    return True


def extra(rng: random.Random, file: Any) -> bool:
    """Groups that the layout does not have, or that it has elsewhere, with something in them."""
    groups, _ = places(file)
    at = rng.choice(["", *groups])
    name = rng.choice(("extra", "\u202e", "notes", "model", "x" * 1000, "seal", "attached", "a b", "$(id)", "-rf"))
    if f"{at}/{name}" in file:
        return False
    group = file.create_group(f"{at}/{name}")
    match rng.randrange(5):
        case 0:
            group["time"] = np.arange(5.0)
            group["more"] = np.zeros(5)
        case 1:
            for number in range(2000):
                group.create_group(str(number))
        case 2:
            for _ in range(30):
                group = group.create_group("deeper")
        case 3:
            group["source"] = rng.choice(TEXTS)
        case _:
            group.attrs["a"] = rng.choice(TEXTS)
    return True


OF_TREE: tuple[Callable[[random.Random, Any], bool], ...] = (
    attribute_removed,
    attribute_renamed,
    attribute_replaced,
    attribute_huge,
    attribute_added,
    removed,
    renamed,
    emptied,
    kind_of_values,
    announced,
    stamps,
    numbers,
    hostile_text,
    linked,
    twice,
    extra,
)
