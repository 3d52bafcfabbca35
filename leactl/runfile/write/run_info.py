"""Define the description of a run before it starts, its identifier, and the checks that both fit the file format."""

import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from leactl.quantities import ROLES, SETUPS, UNITS, ChannelSpec, accepted_units
from leactl.runfile import layout


@dataclass(frozen=True)
class RunInfo:
    """Description of a run before it starts; it becomes the root attributes of the file."""

    run_id: str
    protocol: str
    bench: str
    actuator: str
    condition: str
    operator: str
    simulated: bool
    mechanical: str
    software: str
    created: str  # ISO 8601, UTC
    seed: int | None = None  # of an emulated bench
    sources: Mapping[str, str] = field(default_factory=dict)  # "protocol", "bench", "model": YAML as used
    setup: Mapping[str, float | str] = field(default_factory=dict)  # drive_gain, load_mass, ...: over the model file's
    parameters: Mapping[str, Any] = field(default_factory=dict)  # of the protocol, with the values that were used
    instruments: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # of each device, `layout.INSTRUMENT`


def new_run_id(protocol: str, start: datetime) -> str:
    """Return a new run identifier, sortable by time, with random last digits: `20261120T101530Z-friction-7f3a`."""
    slug = re.sub(r"[^a-z0-9]+", "-", protocol.lower()).strip("-") or "run"
    return f"{start.astimezone(UTC):%Y%m%dT%H%M%SZ}-{slug}-{secrets.token_hex(2)}"


def faults_of(info: RunInfo, streams: Mapping[str, Sequence[ChannelSpec]]) -> list[str]:
    """Return one line for each part of the description or of the channels that the file format does not allow."""
    faults = []
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", info.run_id):
        faults.append(f"run_id: {info.run_id!r} is no file name; use letters, digits, '.', '_' and '-'")
    if info.mechanical not in SETUPS:
        faults.append(f"mechanical: {info.mechanical!r} is none of {', '.join(SETUPS)}")
    faults += [
        f"sources: {name!r} is none of {', '.join(layout.SOURCES)}" for name in info.sources.keys() - {*layout.SOURCES}
    ]
    path_by_identity: dict[tuple[str, str, str], str] = {}
    for stream, specs in streams.items():
        names = [spec.name for spec in specs]
        for spec in specs:
            channel_path = f"streams/{stream}/{spec.name}"
            faults += faults_of_channel(channel_path, spec)
            if names.count(spec.name) > 1:
                faults.append(f"{channel_path}: the name occurs twice in its stream")
            first_path = path_by_identity.setdefault((spec.quantity, spec.role, spec.location), channel_path)
            if first_path != channel_path:
                faults.append(f"{channel_path}: same quantity, role and location as {first_path}; give each a location")
    return faults


def faults_of_channel(channel_path: str, spec: ChannelSpec) -> list[str]:
    """Return one line for each fault of a channel's name, quantity, unit, role, sampling or data type."""
    faults = []
    if (
        any(not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", name) for name in channel_path.split("/"))
        or "/" in spec.name  # it would be a group of its own in the file
        or spec.name == "time"
    ):
        faults.append(f"{channel_path}: not a usable name for a channel")
    if spec.quantity not in UNITS:
        return [*faults, f"{channel_path}: quantity {spec.quantity!r} is not in the vocabulary"]
    if spec.unit not in accepted_units(spec.quantity):
        faults.append(f"{channel_path}: unit {spec.unit!r} is none of {', '.join(accepted_units(spec.quantity))}")
    if spec.role not in ROLES:
        faults.append(f"{channel_path}: role {spec.role!r} is none of {', '.join(ROLES)}")
    if spec.sampling not in ("", "instant", "mean"):
        faults.append(f"{channel_path}: sampling {spec.sampling!r} is neither instant nor mean")
    if np.dtype(spec.dtype).kind != "f":
        faults.append(f"{channel_path}: dtype {spec.dtype!r} cannot hold NaN for a missed sample; use f4 or f8")
    return faults
