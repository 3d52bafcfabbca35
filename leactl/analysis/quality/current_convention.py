"""Ratios of torque constants by which a wrong convention of current shows, or of voltages by a back-EMF constant.

q-axis current, power-invariant, is sqrt(3/2) times the amplitude of a phase and sqrt(3) times its rms value.
"""

import math
from collections.abc import Mapping

CONVENTIONS = {
    math.sqrt(3 / 2): "the current may be a phase amplitude taken for q-axis current",
    math.sqrt(2 / 3): "the current may be q-axis current taken for a phase amplitude",
    math.sqrt(3): "the current may be a phase rms taken for q-axis current",
    math.sqrt(1 / 3): "the current may be q-axis current taken for a phase rms",
}
VOLTAGES = {
    math.sqrt(3): "the voltages may be those from lead to star point, taken for line to line",
    math.sqrt(1 / 3): "the voltages may be line to line already, and multiplied by sqrt(3) as if they were of a phase",
}
WITHIN = 0.02


def reason_for_torque_constant(ratio: float) -> str:
    """What a torque constant this many times too large says of its current; empty where it says nothing."""
    why = reason_for_factor(ratio, CONVENTIONS)
    return f"{why}; check current_convention" if why else ""


def reason_for_ratio(ratio: float, measured: bool) -> str:
    """The same where it is too large for a back-EMF constant; in a model that has it no current was `measured`."""
    why, volts = reason_for_torque_constant(ratio), reason_for_factor(ratio, VOLTAGES)
    if why and not measured:
        why = "the model's torque constant may be one per ampere of another current than that of the q axis"
    return "; or ".join(filter(None, (why, volts) if measured else (volts, why)))


def reason_for_factor(ratio: float, reasons: Mapping[float, str]) -> str:
    """The reason whose factor this is; empty where there is none."""
    return next((why for factor, why in reasons.items() if abs(ratio / factor - 1.0) < WITHIN), "")
