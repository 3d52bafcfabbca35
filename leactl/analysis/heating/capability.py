"""What the actuator of a thermal fit can carry, with the fit's own uncertainty.

`leactl thermal limits` says the same of a motor file and its tolerances, for the worst actuator within them; here it is
the one that was heated.
"""

from leactl.analysis.estimate import Estimate
from leactl.analysis.heating.parameters import ThermalParameters
from leactl.analysis.heating.resistance import REFERENCE
from leactl.model.capability import FOR_EVER, STANDING, TURNING, Winding, current_held

PEAKS_S = (1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 300.0)
MOTIONS = {"": TURNING, "_standing": STANDING}


def current_capability(known: ThermalParameters, phase_of_line: float, limit: float, ambient: float) -> list[Estimate]:
    """Continuous and peak q-axis currents [A] from ambient, all phases alike as in the paper, and standing."""
    found = []
    for motion, share in MOTIONS.items():
        for duration in (FOR_EVER, *PEAKS_S):
            kind = "continuous_current" if duration == FOR_EVER else f"peak_current_{duration:g}s"

            def current(one: ThermalParameters, duration: float = duration, share: float = share) -> float:
                cold = phase_of_line * float(one.point[5])
                winding = Winding(one.network, cold, float(one.point[6]), REFERENCE)
                return current_held(winding, limit - ambient, ambient, duration, share)

            found.append(known.estimate(kind + motion, "A", current))
    return found
