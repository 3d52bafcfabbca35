"""The faults of a bench file that rehearse the whole catalogue on it: each by itself, on every device that it fits."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from leactl.bench.benchfile import BenchFile, CheckedDevice
from leactl.emulation.faults import find_fault, known_faults
from leactl.emulation.faults.contract import Drill, Fault, PlannedBench

AT_ONCE = 0.0  # any moment serves to ask whether a fault fits a bench


class FaultRehearsal(NamedTuple):
    """One fault on one device or bus: its entry of a bench file but for `at_s`, and what is asked of the bench."""

    fault: str
    entry: Mapping[str, Any]
    drill: Drill

    @property
    def on(self) -> str:
        """The device or the bus; empty where it is of the whole bench."""
        return str(self.entry.get("device", self.entry.get("bus", "")))

    @property
    def parameters(self) -> dict[str, Any]:
        """What the fault is given besides."""
        return dict(self.drill.parameters)


def rehearsals(
    file: BenchFile, devices: Sequence[CheckedDevice], only: Collection[str] = ()
) -> tuple[list[FaultRehearsal], dict[str, str]]:
    """What of the catalogue, or of these faults `only`, is rehearsed on a bench, and why the rest is not.

    Raises
    ------
    InputError : a name among `only` that is no fault's.
    """
    standing = PlannedBench(file, {device.name: device for device in devices})
    chosen = {name: find_fault(name) for name in only} or known_faults()
    rehearsed: list[FaultRehearsal] = []
    left_out: dict[str, str] = {}
    for name, kind in sorted(chosen.items()):
        if kind.not_drilled:
            left_out[name] = kind.not_drilled
            continue
        fitting = [item for drill in kind.drills(file) for item in _fitting(name, kind, drill, standing)]
        rehearsed += fitting
        if not fitting:
            left_out[name] = "no device of this bench that it could happen to"
    return rehearsed, left_out


def _fitting(name: str, kind: type[Fault], drill: Drill, standing: PlannedBench) -> list[FaultRehearsal]:
    places: list[dict[str, Any]] = [{}]
    if "device" in kind.model_fields:
        places = [{"device": device} for device in standing.devices]
    elif "bus" in kind.model_fields:
        places = [{"bus": bus} for bus in standing.file.buses]
    entries = [{"fault": name, **place, **drill.parameters} for place in places]
    return [
        FaultRehearsal(name, entry, drill)
        for entry in entries
        if not kind.model_validate({**entry, "at_s": AT_ONCE}).misfits(standing)
    ]
