"""Convert parameters of a winding: between its leads and the q axis, for wye and delta, and from cold to warm.

The transform is power-invariant.
The frame of a wye is that of its phases between lead and neutral, the frame of a delta that of its phases between two
leads. The wye that is equivalent to a delta at the leads has a third of its resistance and inductance, its torque
constant divided by sqrt(3) and its current times sqrt(3): torque, power and motor constant are the same in both.

Paper, section "Back-EMF Constant", and Lee and Rouse (2023) for the delta.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeVar

if TYPE_CHECKING:  # numpy is imported where it is needed
    import numpy as np
    import numpy.typing as npt

WindingType = Literal["wye", "delta"]
Temperature = TypeVar("Temperature", float, "npt.NDArray[np.float64]")


@dataclass(frozen=True)
class QAxisFactors:
    """Factors that convert measurements between and in the leads of a winding to q-axis quantities."""

    resistance: float  # multiplies the line-to-line resistance or inductance
    back_emf: float  # multiplies the amplitude of the line-to-line back-EMF constant or voltage
    current: float  # multiplies the amplitude of the current in a lead


FRAMES: dict[WindingType, QAxisFactors] = {
    "wye": QAxisFactors(1.0 / 2.0, 1.0 / math.sqrt(2.0), math.sqrt(3.0 / 2.0)),
    "delta": QAxisFactors(3.0 / 2.0, math.sqrt(3.0 / 2.0), 1.0 / math.sqrt(2.0)),
}


@dataclass(frozen=True)
class Electrical:
    """Electrical parameters of a winding in its frame, SI; None if not known."""

    winding: WindingType
    resistance: float | None  # ohm
    inductance: float | None  # H
    torque_constant: float | None  # N*m/A, equal to the back-EMF constant in V*s/rad

    def line_to_line(self) -> "LineToLine":
        """Return the values that a meter between two leads measures, the third lead open."""
        frame = FRAMES[self.winding]
        return LineToLine(
            _times(self.resistance, 1.0 / frame.resistance),
            _times(self.inductance, 1.0 / frame.resistance),
            _times(self.torque_constant, 1.0 / frame.back_emf),
        )

    def seen_as(self, winding: WindingType) -> "Electrical":
        """Return the winding of the given type that is equivalent at the leads."""
        return self.line_to_line().q_axis(winding)

    def per_line_amplitude(self) -> float | None:
        """Return the torque per ampere of amplitude in a lead [N*m/A], which is equal in both frames."""
        return _times(self.torque_constant, FRAMES[self.winding].current)


@dataclass(frozen=True)
class LineToLine:
    """Electrical parameters measured between two leads, SI; None if not known."""

    resistance: float | None  # ohm
    inductance: float | None  # H
    back_emf_constant: float | None  # V*s/rad, amplitude of the voltage

    def q_axis(self, winding: WindingType) -> Electrical:
        """Return the parameters in the frame of a winding of the given type."""
        frame = FRAMES[winding]
        return Electrical(
            winding,
            _times(self.resistance, frame.resistance),
            _times(self.inductance, frame.resistance),
            _times(self.back_emf_constant, frame.back_emf),
        )


def voltage_ceiling(bus_voltage: float, winding: WindingType) -> float:
    """Return the largest q-axis voltage [V], at which the amplitude between two leads equals the bus voltage."""
    return FRAMES[winding].back_emf * bus_voltage


def resistance_ratio(temperature: Temperature, coefficient: float, reference: float) -> Temperature:
    """Return the ratio of a winding's resistance at a temperature to that at the reference temperature.

    Parameters
    ----------
    temperature, reference : degC.
    coefficient : temperature coefficient of the resistance at the reference temperature [1/K].
    """
    return 1.0 + coefficient * (temperature - reference)


def _times(value: float | None, factor: float) -> float | None:
    """Return the product; None if the value is not known."""
    return None if value is None else value * factor
