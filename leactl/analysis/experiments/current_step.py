"""Steps of the q-axis current with the shaft locked: how fast and how truly a drive's current follows."""

from collections.abc import Sequence

from leactl.analysis.estimate import Result
from leactl.analysis.responses.step_response import STEP_RESULTS, step_response
from leactl.runfile.read.reader import Run

RESULTS = STEP_RESULTS


def analyze(runs: Sequence[Run]) -> Result:
    """Estimate rise time, overshoot, settling time and steady-state error of the current; see `step_response`."""
    return step_response("current-step", runs, "q_axis_current_reference", "q_axis_current", "current_A", "locked")
