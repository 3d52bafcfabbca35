"""Currents that the actuator of a thermal fit can carry, with the uncertainty of the fit.

`leactl thermal limits` computes them from a motor file and its tolerances, for the worst actuator within them; here
they are those of the actuator that was heated.
"""

from leactl.analysis.estimate import Estimate
from leactl.analysis.heating.parameters import FittedParameters
from leactl.analysis.heating.resistance import REFERENCE_TEMPERATURE
from leactl.model.continuous_current import STANDING, STEADY_STATE, TURNING, ThermalActuator, current_for_rise

PEAKS_S = (1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 300.0)
MOTIONS = {"": TURNING, "_standing": STANDING}


def current_capability(
    parameters: FittedParameters, phase_of_line: float, limit: float, ambient: float
) -> list[Estimate]:
    """Estimate continuous and peak q-axis currents [A] from ambient, turning (all phases alike) and standing.

    `phase_of_line` is the resistance of a phase over that between two leads; limit and ambient are in degC.
    """
    estimates = []
    for motion, share in MOTIONS.items():
        for duration in (STEADY_STATE, *PEAKS_S):
            kind = "continuous_current" if duration == STEADY_STATE else f"peak_current_{duration:g}s"

            def current(moved: FittedParameters, duration: float = duration, share: float = share) -> float:
                cold = phase_of_line * float(moved.point[5])
                actuator = ThermalActuator(moved.network, cold, float(moved.point[6]), REFERENCE_TEMPERATURE)
                return current_for_rise(actuator, limit - ambient, ambient, duration, share)

            estimates.append(parameters.estimate(kind + motion, "A", current))
    return estimates
