"""A sensor whose reading is noisy."""

from collections.abc import Callable, Sequence

from pydantic import Field

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Draw, Drill, OfSensor, PlannedBench, Positive
from leactl.quantities import UNITS


class NoisySensor(OfSensor):
    """A reading carries normal noise of a given spread: a broken shield, a loose plug, a worn slip ring."""

    example = "{fault: noisy_sensor, at_s: 2, device: torque_sensor, quantity: torque, spread: 6, unit: N*m}"

    spread: Positive = Field(description="standard deviation of the noise, in the unit given")
    unit: str = Field(description="unit of the spread, which is the quantity's own")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """A torque with noise as large as its limit: one sample in three exceeds the limit."""
        spread = file.limits.torque_Nm
        return (Drill({"quantity": "torque", "spread": spread, "unit": "N*m"}, 0.5, "limit of torque_Nm"),)

    def misfits(self, planned_bench: PlannedBench) -> dict[str, str]:
        """Reasons of any sensor fault, and the reason if the unit is not the quantity's."""
        faults, unit = super().misfits(planned_bench), UNITS.get(self.quantity, self.unit)
        return faults if self.unit == unit else faults | {"unit": f"{self.quantity} is in {unit}, not in {self.unit}"}

    def reads(self, draw: Draw) -> Callable[[float], float]:
        """Return a function that adds normal noise to a value."""
        return lambda value: value + self.spread * float(draw.standard_normal())
