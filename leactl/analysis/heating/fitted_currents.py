"""Currents that the actuator of a thermal fit can carry, with the uncertainty of the fit.

`leactl thermal limits` computes these currents from a motor file, for the worst actuator within its tolerances; this
module computes them for the actuator that was heated.
"""

from leactl.analysis.estimate import Estimate
from leactl.analysis.heating.parameters import LINE_RESISTANCE, RESISTANCE_COEFFICIENT, FittedParameters
from leactl.analysis.heating.resistance import REFERENCE_TEMPERATURE
from leactl.model.continuous_current import (
    STANDING_HEAT_SHARE,
    STEADY_STATE,
    TURNING_HEAT_SHARE,
    ThermalActuator,
    current_for_rise,
)

PEAK_DURATIONS_S = (1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 300.0)
HEAT_SHARE_BY_SUFFIX = {"": TURNING_HEAT_SHARE, "_standing": STANDING_HEAT_SHARE}  # of the estimates' names


def current_capability(
    parameters: FittedParameters, phase_to_line_ratio: float, limit_temperature: float, ambient: float
) -> list[Estimate]:
    """Estimate continuous and peak q-axis currents [A] from ambient, turning (all phases alike) and standing.

    `phase_to_line_ratio` is the resistance of a phase over that between two leads; `limit_temperature` and `ambient`
    are in degC.
    """
    estimates = []
    for suffix, share in HEAT_SHARE_BY_SUFFIX.items():
        for duration in (STEADY_STATE, *PEAK_DURATIONS_S):
            name = "continuous_current" if duration == STEADY_STATE else f"peak_current_{duration:g}s"

            def current(
                shifted_parameters: FittedParameters, duration: float = duration, share: float = share
            ) -> float:
                phase_resistance = phase_to_line_ratio * float(shifted_parameters.point[LINE_RESISTANCE])
                actuator = ThermalActuator(
                    shifted_parameters.network,
                    phase_resistance,
                    float(shifted_parameters.point[RESISTANCE_COEFFICIENT]),
                    REFERENCE_TEMPERATURE,
                )
                return current_for_rise(actuator, limit_temperature - ambient, ambient, duration, share)

            estimates.append(parameters.estimate(name + suffix, "A", current))
    return estimates
