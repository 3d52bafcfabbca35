"""What is known of a run before it starts, and whether a file that says so keeps to the format."""

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
    """What is known of a run before it starts; it becomes the root attributes."""

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


def new_run_id(protocol: str, when: datetime) -> str:
    """A name that sorts by time and never repeats: `20261120T101530Z-torque-constant-7f3a`."""
    slug = re.sub(r"[^a-z0-9]+", "-", protocol.lower()).strip("-") or "run"
    return f"{when.astimezone(UTC):%Y%m%dT%H%M%SZ}-{slug}-{secrets.token_hex(2)}"


def faults_of(info: RunInfo, streams: Mapping[str, Sequence[ChannelSpec]]) -> list[str]:
    """Everything that would make the file break its own format."""
    faults = []
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", info.run_id):
        faults.append(f"run_id: {info.run_id!r} is no file name; use letters, digits, '.', '_' and '-'")
    if info.mechanical not in SETUPS:
        faults.append(f"mechanical: {info.mechanical!r} is none of {', '.join(SETUPS)}")
    faults += [
        f"sources: {name!r} is none of {', '.join(layout.SOURCES)}" for name in info.sources.keys() - {*layout.SOURCES}
    ]
    seen: dict[tuple[str, str, str], str] = {}
    for stream, specs in streams.items():
        names = [spec.name for spec in specs]
        for spec in specs:
            place = f"streams/{stream}/{spec.name}"
            faults += faults_of_channel(place, spec)
            if names.count(spec.name) > 1:
                faults.append(f"{place}: the name occurs twice in its stream")
            known = seen.setdefault((spec.quantity, spec.role, spec.location), place)
            if known != place:
                faults.append(f"{place}: same quantity, role and location as {known}; give each a location")
    return faults


def faults_of_channel(place: str, spec: ChannelSpec) -> list[str]:
    """What is wrong with one channel's description."""
    faults = []
    if any(not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", part) for part in place.split("/")) or spec.name == "time":
        faults.append(f"{place}: not a usable name for a channel")
    if spec.quantity not in UNITS:
        return [*faults, f"{place}: quantity {spec.quantity!r} is not in the vocabulary"]
    if spec.unit not in accepted_units(spec.quantity):
        faults.append(f"{place}: unit {spec.unit!r} is none of {', '.join(accepted_units(spec.quantity))}")
    if spec.role not in ROLES:
        faults.append(f"{place}: role {spec.role!r} is none of {', '.join(ROLES)}")
    if spec.sampling not in ("", "instant", "mean"):
        faults.append(f"{place}: sampling {spec.sampling!r} is neither instant nor mean")
    if np.dtype(spec.dtype).kind != "f":
        faults.append(f"{place}: dtype {spec.dtype!r} cannot hold NaN for a missed sample; use f4 or f8")
    return faults
