"""Convert figures of a winding between its leads and the q axis, for wye and delta; power-invariant transform.

A wye's own frame is that of its phases, between lead and neutral; a delta's, whose phases lie between two leads. The
same delta seen as the wye that nobody could tell from it has a third of the resistance and inductance, its torque
constant divided by sqrt(3) and its current times sqrt(3): torque, power and motor constant are the same in both.

Paper, section "Back-EMF Constant", and Lee and Rouse (2023) for the delta.
"""

import math
from dataclasses import dataclass
from typing import Literal

WindingType = Literal["wye", "delta"]


@dataclass(frozen=True)
class QAxisFactors:
    """Factors from what is measured between and in the leads of a winding to its q-axis quantities."""

    resistance: float  # of the line-to-line resistance; of inductance too
    back_emf: float  # of the amplitude of the line-to-line back-EMF constant; of voltages too
    current: float  # of the amplitude of the current in a lead


FRAMES: dict[WindingType, QAxisFactors] = {
    "wye": QAxisFactors(1.0 / 2.0, 1.0 / math.sqrt(2.0), math.sqrt(3.0 / 2.0)),
    "delta": QAxisFactors(3.0 / 2.0, math.sqrt(3.0 / 2.0), 1.0 / math.sqrt(2.0)),
}


@dataclass(frozen=True)
class Electrical:
    """Electrical figures of a winding in one frame, SI; None where not known."""

    winding: WindingType
    resistance: float | None  # ohm
    inductance: float | None  # H
    torque_constant: float | None  # N*m/A, equal to the back-EMF constant in V*s/rad

    def line_to_line(self) -> "LineToLine":
        """As a meter between two leads, the others open, sees it."""
        frame = FRAMES[self.winding]
        return LineToLine(
            _times(self.resistance, 1.0 / frame.resistance),
            _times(self.inductance, 1.0 / frame.resistance),
            _times(self.torque_constant, 1.0 / frame.back_emf),
        )

    def seen_as(self, winding: WindingType) -> "Electrical":
        """The winding of this type that cannot be told from this one at its leads."""
        return self.line_to_line().q_axis(winding)

    def per_line_amplitude(self) -> float | None:
        """Torque per ampere of amplitude in a lead [N*m/A], the same whatever the frame."""
        return _times(self.torque_constant, FRAMES[self.winding].current)


@dataclass(frozen=True)
class LineToLine:
    """What is measured between two leads, SI; None where not known."""

    resistance: float | None  # ohm
    inductance: float | None  # H
    back_emf_constant: float | None  # V*s/rad, amplitude of the voltage

    def q_axis(self, winding: WindingType) -> Electrical:
        """In the own frame of a winding of this type."""
        frame = FRAMES[winding]
        return Electrical(
            winding,
            _times(self.resistance, frame.resistance),
            _times(self.inductance, frame.resistance),
            _times(self.back_emf_constant, frame.back_emf),
        )


def voltage_ceiling(bus_voltage: float, winding: WindingType) -> float:
    """Largest q-axis voltage that a bus gives [V]: between two leads its amplitude is that of the bus."""
    return FRAMES[winding].back_emf * bus_voltage


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor
