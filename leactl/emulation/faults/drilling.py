"""Rehearsals of all faults on a bench: each fault alone, on every device or bus that it fits."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from leactl.bench.benchfile import BenchFile, CheckedDevice
from leactl.emulation.faults import find_fault, known_faults
from leactl.emulation.faults.contract import Drill, Fault, PlannedBench

ANY_TIME_S = 0.0  # of the fault; whether it fits the bench does not depend on this time


class FaultRehearsal(NamedTuple):
    """One fault on one device or bus: its entry in a bench file without `at_s`, and the expected end of the run."""

    fault: str
    entry: Mapping[str, Any]
    drill: Drill

    @property
    def on(self) -> str:
        """Name of the device or bus; empty for a fault of the whole bench."""
        return str(self.entry.get("device", self.entry.get("bus", "")))

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the fault, except for its time and its device or bus."""
        return dict(self.drill.parameters)


def rehearsals(
    file: BenchFile, devices: Sequence[CheckedDevice], only: Collection[str] = ()
) -> tuple[list[FaultRehearsal], dict[str, str]]:
    """Return the rehearsals of all faults, or of those named in `only`, and why each fault without any is left out.

    Raises
    ------
    InputError : a name in `only` is not that of a fault.
    """
    planned_bench = PlannedBench(file, {device.name: device for device in devices})
    chosen_faults = {name: find_fault(name) for name in only} or known_faults()
    rehearsed: list[FaultRehearsal] = []
    reasons_left_out: dict[str, str] = {}
    for name, fault_class in sorted(chosen_faults.items()):
        if fault_class.not_drilled:
            reasons_left_out[name] = fault_class.not_drilled
            continue
        rehearsals_of_fault = [
            rehearsal
            for drill in fault_class.drills(file)
            for rehearsal in _fitting(name, fault_class, drill, planned_bench)
        ]
        rehearsed += rehearsals_of_fault
        if not rehearsals_of_fault:
            reasons_left_out[name] = "no device of this bench that it could happen to"
    return rehearsed, reasons_left_out


def _fitting(name: str, fault_class: type[Fault], drill: Drill, planned_bench: PlannedBench) -> list[FaultRehearsal]:
    """Return one rehearsal for each device or bus that the drill fits."""
    targets: list[dict[str, Any]] = [{}]
    if "device" in fault_class.model_fields:
        targets = [{"device": device} for device in planned_bench.devices]
    elif "bus" in fault_class.model_fields:
        targets = [{"bus": bus} for bus in planned_bench.file.buses]
    entries = [{"fault": name, **target, **drill.parameters} for target in targets]
    return [
        FaultRehearsal(name, entry, drill)
        for entry in entries
        if not fault_class.model_validate({**entry, "at_s": ANY_TIME_S}).misfits(planned_bench)
    ]
