"""The seal of a run file: what every object of the tree was when the run was closed, names and attributes included.

`/seal` lists each group and dataset with a digest of its kind, its attributes and the checksum of its values; the
root's attribute `seal` is the digest of that list. What is added later carries a `seal` of its own, over its own tree,
and the root's attribute `additions` is the digest of those. How a value is stored (compression, chunks, the version of
HDF5 or of h5py, a scalar or an array of one) is in no digest: a rewritten file keeps its seal.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator
from typing import Any, Final

import h5py

from leactl.runfile import layout

SEAL: Final = "seal"  # attribute of the root and of each addition, and the group with the list
ADDITIONS: Final = "additions"
COLUMNS: Final[dict[str, int | None]] = {"path": 0, "sha256": 0}
OWN: Final = ("sha256", SEAL, ADDITIONS)  # attributes that are digests themselves
FEW: Final = 5  # places with a line each


def entries(node: Any, path: str = "/") -> Iterator[tuple[str, str]]:
    """Every object of a tree, the node itself first, with its digest; additions and the list itself are left out."""
    yield path, object_digest(node)
    if not isinstance(node, h5py.Group):
        return
    for name in node:
        place = f"{path.rstrip('/')}/{name}"
        if place == f"/{SEAL}":
            continue
        link = node.get(name, getlink=True)
        if not isinstance(link, h5py.HardLink):
            yield place, digest_of(["link", type(link).__name__])
        elif SEAL not in (child := node[name]).attrs:
            yield from entries(child, place)


def object_digest(node: Any) -> str:
    """Digest of what a group or dataset is: its kind, shape, attributes, and the stored checksum of its values."""
    digests = {SEAL, ADDITIONS if node.name == "/" else "sha256" if isinstance(node, h5py.Dataset) else SEAL}
    attributes = {name: value for name, value in layout.attributes(node).items() if name not in digests}
    if isinstance(node, h5py.Dataset):
        kind = "text" if layout.is_text(node) else node.dtype.newbyteorder("<").str
        return digest_of(["dataset", kind, list(node.shape), layout.plain(node.attrs.get("sha256", "")), attributes])
    return digest_of(["group", attributes])


def digest_of(value: Any) -> str:
    """SHA-256 of a value as JSON with sorted keys and the shortest numbers that read back the same."""
    text = json.dumps(value, sort_keys=True, ensure_ascii=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def table_of(file: Any) -> list[dict[str, str]]:
    """The rows of `/seal` for a file as it is now."""
    return [{"path": path, "sha256": digest} for path, digest in sorted(entries(file))]


def digest_of_table(rows: list[dict[str, str]]) -> str:
    """What the root's `seal` holds."""
    return digest_of([[row["path"], row["sha256"]] for row in rows])


def additions(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """What was added after the run was closed: the groups below the root that carry a seal of their own."""
    for name in node:
        place = f"{path}/{name}"
        if place == f"/{SEAL}" or not isinstance(node.get(name, getlink=True), h5py.HardLink):
            continue
        child = node[name]
        if SEAL in child.attrs:
            yield place, child
        elif isinstance(child, h5py.Group):
            yield from additions(child, place)


def seal_additions(file: Any, places: Iterable[str]) -> None:
    """Seal what was added at these places, or taken from them, where the file is sealed itself."""
    if SEAL not in file.attrs:
        return
    for place in places:
        if place in file:
            file[place].attrs[SEAL] = digest_of(sorted(entries(file[place], place)))
    file.attrs[ADDITIONS] = digest_of_additions(file)


def digest_of_additions(file: Any) -> str:
    """What the root's `additions` holds."""
    return digest_of(sorted((place, layout.plain(node.attrs[SEAL])) for place, node in additions(file)))


def broken(file: Any) -> list[str]:
    """What is not as it was when the run was closed or the addition made; empty for a file without a seal."""
    sealed = SEAL in file.attrs
    if not sealed and SEAL not in file:
        return []
    try:
        rows = [
            {"path": path, "sha256": digest}
            for path, digest in zip(*(layout.texts(file[SEAL][column]) for column in COLUMNS), strict=True)
        ]
    except (KeyError, ValueError, TypeError, AttributeError):
        return [f"/{SEAL}: the list of what the file held at its close is missing or damaged"]
    if not sealed or layout.plain(file.attrs[SEAL]) != digest_of_table(rows):
        return [f"/{SEAL}: the list of what the file held at its close does not match the root's seal"]
    if more := more_than_the_list(file[SEAL]):
        return [f"/{SEAL}: holds more than the list of what the file held at its close: {more}"]
    then, now = {row["path"]: row["sha256"] for row in rows}, dict(entries(file))
    findings = [
        *told(without_members(then.keys() - now.keys()), "is missing; it was there when the run was closed"),
        *told(without_members(now.keys() - then.keys()), "was not there when the run was closed"),
        *told(
            {path for path in then.keys() & now.keys() if then[path] != now[path]},
            "attributes, kind or checksum are not those of when the run was closed",
        ),
    ]
    later = dict(additions(file))
    for place, node in later.items():
        if layout.plain(node.attrs[SEAL]) != digest_of(sorted(entries(node, place))):
            findings.append(f"{place}: is not as it was added after the run was closed")
    noted = layout.plain(file.attrs.get(ADDITIONS, ""))
    if noted != (digest_of_additions(file) if later or noted else ""):
        findings.append("/: what was added after the run was closed is not all there, or more was added")
    return findings


def more_than_the_list(group: Any) -> str:
    """What else the group of the list holds, which the list does not cover itself; empty where that is nothing."""
    members = [name for name in group if name not in COLUMNS]
    columns = {name for column in COLUMNS for name in layout.attributes(group[column])}
    return ", ".join(map(repr, [*members, *layout.attributes(group), *(columns - {"sha256"})]))


def told(paths: Iterable[str], reason: str) -> list[str]:
    """A line for each path, or one for all of them where they are many."""
    places = sorted(paths)
    if len(places) > FEW:
        return [f"{places[0]} and {len(places) - 1} more: {reason}"]
    return [f"{place}: {reason}" for place in places]


def without_members(paths: set[str]) -> set[str]:
    """The topmost of paths that lie below one another."""
    return {path for path in paths if not any(path.startswith(f"{other}/") for other in paths if other != path)}
