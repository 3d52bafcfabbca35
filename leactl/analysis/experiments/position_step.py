"""Steps of the angle of a free shaft: how fast and how truly a drive's position servo follows."""

from collections.abc import Sequence

from leactl.analysis.estimate import Result
from leactl.analysis.responses.step_response import STEP_RESULTS, step_response
from leactl.runfile.read.reader import Run

RESULTS = STEP_RESULTS


def analyze(runs: Sequence[Run]) -> Result:
    """Estimate rise time, overshoot, settling time and steady-state error of the angle; see `step_response`."""
    return step_response("position-step", runs, "angle_reference", "angle", "angle_rad", "free")
