"""Noise of the angle of a free shaft: how far up in frequency a drive's position servo follows."""

from collections.abc import Sequence

from leactl.analysis.estimate import Result
from leactl.analysis.responses.noise_records import NoiseExperiment
from leactl.analysis.responses.noise_response import NOISE_RESULTS, noise_response
from leactl.runfile.read.reader import Run

RESULTS = NOISE_RESULTS

# the paper's cut-off [Hz] of the record over that of its noise, so that a loop of any speed is filtered alike
LOOP = NoiseExperiment("position-noise", "angle_reference", "angle", "offset_rad", "free", (5, 50.0 / 40.0))


def analyze(runs: Sequence[Run]) -> Result:
    """Estimate bandwidth and coherent band; see `noise_response`."""
    return noise_response(runs, LOOP)
