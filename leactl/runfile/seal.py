"""Seal run files: compute and check digests of all objects of a closed run, with their names and attributes.

The group `/seal` lists each group and dataset with a digest of its kind, its attributes and the checksum of its values;
the root's attribute `seal` is the digest of that list. A group that is added after the close has an attribute `seal`
for its tree, and the root's attribute `additions` is the digest of all those seals. No digest depends on the storage of
a value (compression, chunks, version of HDF5 or h5py, scalar or array of one), so that a rewritten file keeps its seal.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator
from typing import Any, Final

import h5py

from leactl.runfile import layout

SEAL: Final = "seal"  # attribute of the root and of each addition, and group with the list
ADDITIONS: Final = "additions"
COLUMNS: Final[dict[str, int | None]] = {"path": 0, "sha256": 0}
DIGEST_ATTRIBUTES: Final = ("sha256", SEAL, ADDITIONS)  # attributes that are digests themselves
MOST_LISTED_PATHS: Final = 5  # paths that get a line each in findings


def entries(node: Any, path: str = "/") -> Iterator[tuple[str, str]]:
    """Yield path and digest of every object of a tree, `node` first, without additions and `/seal`."""
    yield path, object_digest(node)
    if not isinstance(node, h5py.Group):
        return
    for name in node:
        child_path = f"{path.rstrip('/')}/{name}"
        if child_path == f"/{SEAL}":
            continue
        link = node.get(name, getlink=True)
        if not isinstance(link, h5py.HardLink):
            yield child_path, digest_of(["link", type(link).__name__])
        elif SEAL not in (child := node[name]).attrs:
            yield from entries(child, child_path)


def object_digest(node: Any) -> str:
    """Return the digest of a group or dataset: of its kind, shape, attributes and the stored checksum of its values."""
    digest_names = {SEAL, ADDITIONS if node.name == "/" else "sha256" if isinstance(node, h5py.Dataset) else SEAL}
    attributes = {name: value for name, value in layout.attributes(node).items() if name not in digest_names}
    if isinstance(node, h5py.Dataset):
        kind = "text" if layout.is_text(node) else node.dtype.newbyteorder("<").str
        return digest_of(
            ["dataset", kind, list(node.shape), layout.to_python(node.attrs.get("sha256", "")), attributes]
        )
    return digest_of(["group", attributes])


def digest_of(value: Any) -> str:
    """Return the SHA-256 of a value as JSON with sorted keys and shortest round-trip numbers."""
    text = json.dumps(value, sort_keys=True, ensure_ascii=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def table_of(file: Any) -> list[dict[str, str]]:
    """Return the rows of `/seal` for the present state of a file."""
    return [{"path": path, "sha256": digest} for path, digest in sorted(entries(file))]


def digest_of_table(rows: list[dict[str, str]]) -> str:
    """Return the value of the root's attribute `seal` for the rows of `/seal`."""
    return digest_of([[row["path"], row["sha256"]] for row in rows])


def additions(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield path and object of each addition after the close: each object with an attribute `seal`."""
    for name in node:
        child_path = f"{path}/{name}"
        if child_path == f"/{SEAL}" or not isinstance(node.get(name, getlink=True), h5py.HardLink):
            continue
        child = node[name]
        if SEAL in child.attrs:
            yield child_path, child
        elif isinstance(child, h5py.Group):
            yield from additions(child, child_path)


def seal_additions(file: Any, hdf5_paths: Iterable[str]) -> None:
    """Update the seals of the additions at these paths and the root's digest of all; leave an unsealed file alone."""
    if SEAL not in file.attrs:
        return
    for hdf5_path in hdf5_paths:
        if hdf5_path in file:
            file[hdf5_path].attrs[SEAL] = digest_of(sorted(entries(file[hdf5_path], hdf5_path)))
    file.attrs[ADDITIONS] = digest_of_additions(file)


def digest_of_additions(file: Any) -> str:
    """Return the value of the root's attribute `additions`."""
    return digest_of(sorted((hdf5_path, layout.to_python(node.attrs[SEAL])) for hdf5_path, node in additions(file)))


def seal_findings(file: Any) -> list[str]:
    """Return one line for each difference to the closed run or its sealed additions; empty if the file has no seal."""
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
    if not sealed or layout.to_python(file.attrs[SEAL]) != digest_of_table(rows):
        return [f"/{SEAL}: the list of what the file held at its close does not match the root's seal"]
    if unlisted := unlisted_content(file[SEAL]):
        return [f"/{SEAL}: holds more than the list of what the file held at its close: {unlisted}"]
    recorded_digests, present_digests = {row["path"]: row["sha256"] for row in rows}, dict(entries(file))
    findings = [
        *findings_for(
            topmost(recorded_digests.keys() - present_digests.keys()),
            "is missing; it was there when the run was closed",
        ),
        *findings_for(
            topmost(present_digests.keys() - recorded_digests.keys()), "was not there when the run was closed"
        ),
        *findings_for(
            {
                path
                for path in recorded_digests.keys() & present_digests.keys()
                if recorded_digests[path] != present_digests[path]
            },
            "attributes, kind or checksum are not those of when the run was closed",
        ),
    ]
    sealed_later = dict(additions(file))
    for hdf5_path, node in sealed_later.items():
        if layout.to_python(node.attrs[SEAL]) != digest_of(sorted(entries(node, hdf5_path))):
            findings.append(f"{hdf5_path}: is not as it was added after the run was closed")
    sealed_additions = layout.to_python(file.attrs.get(ADDITIONS, ""))
    if sealed_additions != (digest_of_additions(file) if sealed_later or sealed_additions else ""):
        findings.append("/: what was added after the run was closed is not all there, or more was added")
    return findings


def unlisted_content(group: Any) -> str:
    """Return the members and attributes of `/seal` that do not belong to its list and that no digest covers."""
    members = [name for name in group if name not in COLUMNS]
    column_attributes = {name for column in COLUMNS for name in layout.attributes(group[column])}
    return ", ".join(map(repr, [*members, *layout.attributes(group), *(column_attributes - {"sha256"})]))


def findings_for(paths: Iterable[str], reason: str) -> list[str]:
    """Return a line for each path, or one line for all if there are more than `MOST_LISTED_PATHS`."""
    sorted_paths = sorted(paths)
    if len(sorted_paths) > MOST_LISTED_PATHS:
        return [f"{sorted_paths[0]} and {len(sorted_paths) - 1} more: {reason}"]
    return [f"{path}: {reason}" for path in sorted_paths]


def topmost(paths: set[str]) -> set[str]:
    """Return the paths without those that lie below another path of the set."""
    return {path for path in paths if not any(path.startswith(f"{parent}/") for parent in paths if parent != path)}
