"""A sensor or a converter whose cable is unplugged."""

from collections.abc import Sequence
from typing import Any

from pydantic import Field

from leactl.bench.benchfile import BenchFile, I2cBus
from leactl.emulation.faults.contract import Draw, Drill, FaultTarget, LastingFault, OfDevice, PlannedBench, Undo


class DisconnectedSensor(OfDevice, LastingFault):
    """A plug is out: of the sensor, whose reading is zero then, or of the whole converter, which answers no more."""

    example = "{fault: disconnected_sensor, at_s: 2, device: torque_sensor, quantity: torque}"

    quantity: str | None = Field(
        None, description="the reading whose sensor is unplugged; left out: the device itself, where its bus is I2C"
    )

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """A converter, the torque sensor at a converter, and the current sensor of a drive."""
        return (
            Drill({}, 0.05, "the device's own bus"),
            Drill({"quantity": "torque"}, 2.1, "stuck_s or torque_disagreement"),
            Drill({"quantity": "q_axis_current"}, 2.1, "current_disagreement or stuck_s"),
        )

    def misfits_of(self, planned_bench: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """Reason if the device does not read the quantity, or, with no quantity, if it is not on an I2C bus."""
        if self.quantity is None:
            bus = planned_bench.file.buses.get(planned_bench.devices[self.device].entry.bus or "")
            text = f"'{self.device}' is not on an I2C bus; name the quantity whose sensor is off, or use lost_frames"
            return {} if isinstance(bus, I2cBus) else {"device": text}
        return self.unread(self.quantity, quantities)

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Set the reading to zero, or silence the device."""
        if self.quantity is not None:
            return bench.signals[self.device].change(self.quantity, lambda _value: 0.0)
        silent, far_end = bench.i2c_buses[bench.bus_of[self.device]].silent, bench.far_ends[self.device]
        silent.append(far_end)
        return lambda: silent.remove(far_end)
