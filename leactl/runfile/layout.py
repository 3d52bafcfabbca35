"""Define the layout of a run file, version 1: names of groups and attributes, storage of text, and checksums.

docs/reference/run-format.md describes the same contract in prose. A change of the layout requires a new `VERSION`.
"""

import hashlib
import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

import h5py
import numpy as np

from leactl.quantities import ChannelSpec

FORMAT: Final = "leactl-run"
VERSION: Final = 1
# the file format of HDF5 1.10, the oldest with SWMR: under "latest" h5py 3.16 writes a data layout that no library
# before HDF5 2.0 reads (h5dump 1.10 and 1.14, MATLAB, h5py below 3.16)
HDF5_FORMAT: Final = ("v110", "v110")

ROOT_ATTRIBUTES: Final = (
    "format",
    "format_version",
    "run_id",
    "created",
    "status",
    "status_reason",
    "protocol",
    "bench",
    "actuator",
    "condition",
    "operator",
    "software",
    "simulated",
)
CHANNEL_ATTRIBUTES: Final = ("units", "quantity", "role", "device", "long_name")
SOURCES: Final = ("protocol", "bench", "model")
# attributes by which HDF5 itself stores dimension scales
OF_SCALES: Final = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "DIMENSION_LABELS")
INSTRUMENT: Final = ("model", "serial", "firmware", "calibrated", "calibration_due")

# bytes of a column's strings in a live file, None for numbers; SWMR allows strings of fixed length only
TABLES: Final[dict[str, dict[str, int | None]]] = {
    "steps": {"name": 128, "start": None, "stop": None, "settle": None, "parameters": 4096},
    "events": {"time": None, "level": 16, "source": 64, "message": 512},
}
NOTES: Final[dict[str, int | None]] = {"time": 0, "author": 0, "text": 0}

BLOCK_ROWS: Final = 1 << 18  # rows that are read at a time: 2 MiB of float64, whatever the length of the run
TEXT: Final = h5py.string_dtype("utf-8")


def to_python(value: Any) -> Any:
    """Convert an attribute to a Python value: bytes to str, one-element arrays (as MATLAB writes them) to scalars."""
    if isinstance(value, np.ndarray):
        if value.size == 1:
            return to_python(value.reshape(-1)[0])
        return value.tolist() if value.dtype.kind in "fiub" else [to_python(item) for item in value]
    if isinstance(value, bytes):
        return value.rstrip(b"\0").decode("utf-8", "replace")
    if isinstance(value, h5py.Empty):
        return ""
    return value.item() if isinstance(value, np.generic) else value


def attributes(node: Any) -> dict[str, Any]:
    """Return the attributes of a group or dataset as Python values, without those of HDF5's dimension scales."""
    return {name: to_python(node.attrs[name]) for name in node.attrs if name not in OF_SCALES}


def storable(text: str) -> str:
    """Replace characters that HDF5 cannot store: NUL, which ends a string, and lone surrogates, which UTF-8 forbids."""
    return text.replace("\0", "\N{REPLACEMENT CHARACTER}").encode("utf-8", "replace").decode("utf-8")


def parameter_value(value: Any) -> Any:
    """Convert a protocol's parameter to an attribute: text, a number, or a list of either."""
    if isinstance(value, str):
        return storable(value)
    if isinstance(value, list | tuple) and any(isinstance(item, str) for item in value):
        return np.array([storable(str(item)) for item in value], TEXT)
    numbers = np.asarray(value)
    return numbers if numbers.dtype.kind in "if" else numbers.astype(float)  # an integer beyond 64 bit


def describe(file: Any, parameters: Mapping[str, Any], instruments: Mapping[str, Mapping[str, str]]) -> None:
    """Write `/parameters` and `/instruments`; an instrument without known facts gets no group."""
    group = file.create_group("parameters")
    for name, value in parameters.items():
        group.attrs[name] = parameter_value(value)
    group = file.create_group("instruments")
    for device, facts in instruments.items():
        known_facts = {name: fact for name, fact in facts.items() if fact}
        for name, fact in known_facts.items():
            group.require_group(device).attrs[name] = storable(fact)


def parameters(file: Any) -> dict[str, Any]:
    """Return the parameters of the protocol with the values of the run; empty if the file has none."""
    group = file.get("parameters")
    values = attributes(group) if isinstance(group, h5py.Group) else {}
    return {name: value for name, value in values.items() if is_parameter(value)}


def is_parameter(value: Any) -> bool:
    """Return whether an attribute has a type that a parameter may have: text, a finite number, or a list of either."""
    if isinstance(value, list):
        return all(not isinstance(item, list) and is_parameter(item) for item in value)
    return isinstance(value, str) or (isinstance(value, int | float) and math.isfinite(value))


def instruments(file: Any) -> dict[str, dict[str, str]]:
    """Return the known facts of each device, by its name in the bench file; empty if the file has none."""
    group = file.get("instruments")
    devices = group.items() if isinstance(group, h5py.Group) else ()
    attributes_by_device = {name: attributes(device) for name, device in devices if isinstance(device, h5py.Group)}
    return {
        name: {key: str(facts[key]) for key in INSTRUMENT if key in facts}
        for name, facts in attributes_by_device.items()
    }


def copy_attributes(source: Any, target: Any) -> None:
    """Copy attributes with their types, except those of HDF5's dimension scales."""
    for name in attributes(source):
        identifier = source.attrs.get_id(name)
        target.attrs.create(name, source.attrs[name], identifier.shape, identifier.dtype)


def copy_description(source: Any, target: Any) -> None:
    """Copy `/parameters` and `/instruments`, where the file has them."""
    for name in ("parameters", "instruments"):
        group = source.get(name)
        if isinstance(group, h5py.Group):
            copy_attributes(group, target.create_group(name))
            for device, facts in group.items():
                if isinstance(facts, h5py.Group):
                    copy_attributes(facts, target.create_group(f"{name}/{device}"))


def is_text(dataset: Any) -> bool:
    """Return whether a dataset holds strings, of fixed or variable length."""
    return h5py.check_string_dtype(dataset.dtype) is not None


def texts(dataset: Any, rows: int | None = None) -> list[str]:
    """Return the first `rows` values, or all, of a 1-D string dataset of fixed or variable length."""
    return [str(to_python(value)) for value in dataset[:rows]]


def create_stream(streams: Any, name: str, specs: list[ChannelSpec], **storage: Any) -> Any:
    """Create a stream: `time` as dimension scale, then the channels in order, with attributes and that scale."""
    group = streams.create_group(name, track_order=True)
    time = group.create_dataset("time", dtype="<f8", **storage)
    time.make_scale("time")
    time.attrs["units"] = "s"
    time.attrs["long_name"] = "time since the run's start"
    for spec in specs:
        dataset = group.create_dataset(spec.name, dtype=np.dtype(spec.dtype).newbyteorder("<"), **storage)
        dataset.dims[0].attach_scale(time)
        for key, value in channel_attributes(spec).items():
            dataset.attrs[key] = value
    return group


def channel_attributes(spec: ChannelSpec) -> dict[str, str | float]:
    """Return the attributes of a channel, without optional attributes that are empty or 0."""
    required: dict[str, str | float] = {
        "units": spec.unit,
        "quantity": spec.quantity,
        "role": spec.role,
        "device": spec.device,
        "long_name": spec.long_name or f"{spec.role} {spec.quantity.replace('_', ' ')}",
    }
    optional: dict[str, str | float] = {
        "sampling": spec.sampling,
        "location": spec.location,
        "skew": spec.skew_s,
        "scale_std": spec.scale_std,
    }
    return required | {key: value for key, value in optional.items() if value}


def datasets(node: Any, parent_path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every dataset below a group with its path; soft and external links are not followed."""
    for name in node:
        if not isinstance(node.get(name, getlink=True), h5py.HardLink):
            continue
        child = node[name]
        path = f"{parent_path}/{name}"
        if isinstance(child, h5py.Group):
            yield from datasets(child, path)
        elif isinstance(child, h5py.Dataset):
            yield path, child


def digest(dataset: Any) -> str:
    """Return the SHA-256 of a dataset's values.

    Numbers count as their little-endian bytes, a scalar string as its UTF-8 bytes (so that `sha256sum` of the YAML
    file gives the same), an array of strings as the UTF-8 bytes of each with a NUL after it.
    """
    sha = hashlib.sha256()
    if is_text(dataset):
        if dataset.shape == ():
            sha.update(str(to_python(dataset[()])).encode())
        else:
            for text in texts(dataset):
                sha.update(text.encode() + b"\0")
    elif dataset.shape == ():
        sha.update(little_endian(np.asarray(dataset[()])).tobytes())
    else:
        for start in range(0, dataset.shape[0], BLOCK_ROWS):
            sha.update(little_endian(dataset[start : start + BLOCK_ROWS]).tobytes())
    return sha.hexdigest()


def little_endian(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the same values in little-endian byte order, by which checksums are defined."""
    return values.astype(values.dtype.newbyteorder("<"), copy=False)
