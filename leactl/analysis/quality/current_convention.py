"""Wrong conventions of current and voltage, recognised by the factor that each causes in a torque constant.

q-axis current, power-invariant, is sqrt(3/2) times the amplitude of a phase and sqrt(3) times its rms value.
"""

import math
from collections.abc import Mapping

CURRENT_REASONS = {
    math.sqrt(3 / 2): "the current may be a phase amplitude taken for q-axis current",
    math.sqrt(2 / 3): "the current may be q-axis current taken for a phase amplitude",
    math.sqrt(3): "the current may be a phase rms taken for q-axis current",
    math.sqrt(1 / 3): "the current may be q-axis current taken for a phase rms",
}
VOLTAGE_REASONS = {
    math.sqrt(3): "the voltages may be those from lead to star point, taken for line to line",
    math.sqrt(1 / 3): "the voltages may be line to line already, and multiplied by sqrt(3) as if they were of a phase",
}
FACTOR_TOLERANCE = 0.02  # largest relative difference of a ratio from a factor that explains it


def reason_for_torque_constant(ratio: float) -> str:
    """Return why a torque constant may be `ratio` times too large; empty if no wrong convention of current fits."""
    reason = reason_for_factor(ratio, CURRENT_REASONS)
    return f"{reason}; check current_convention" if reason else ""


def reason_for_ratio(ratio: float, measured: bool) -> str:
    """Return why the ratio of torque constant to back-EMF constant is not one; empty if no wrong convention fits.

    `measured` is False if the torque constant is that of a model, for which no current was measured.
    """
    current_reason, voltage_reason = reason_for_torque_constant(ratio), reason_for_factor(ratio, VOLTAGE_REASONS)
    if current_reason and not measured:
        current_reason = "the model's torque constant may be one per ampere of another current than that of the q axis"
    return "; or ".join(
        filter(None, (current_reason, voltage_reason) if measured else (voltage_reason, current_reason))
    )


def reason_for_factor(ratio: float, reasons: Mapping[float, str]) -> str:
    """Return the reason whose factor is within `FACTOR_TOLERANCE` of the ratio; empty if there is none."""
    return next((reason for factor, reason in reasons.items() if abs(ratio / factor - 1.0) < FACTOR_TOLERANCE), "")
