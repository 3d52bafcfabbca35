"""Records of noise experiments: reference and response over each stretch of noise, without gaps.

A stretch is a step of the run named `noise` that says its level (`signal: {kind: noise}` of a protocol), and the seed
and cut-off of its noise where it has them.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import Noted, tally
from leactl.analysis.quality.saturation import saturated
from leactl.analysis.signals.levels import Hold
from leactl.analysis.statistics.regression import Array
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel, Run, Step

FEWEST = 1600  # samples in a row, four windows of the estimator
EPS_S = 1e-6  # rounding of stamps; a row at either end of a step may belong to what is before or behind it
EVEN = 0.2  # of an interval that stamps may be off


@dataclass(frozen=True)
class NoiseExperiment:
    """What a noise experiment looks at."""

    experiment: str
    reference: str
    response: str
    offset: str  # key of the level in a step's parameters
    setup: str
    record_filter: tuple[int, float]  # Butterworth, of both records: order, cut-off over the noise's own


@dataclass(frozen=True, eq=False)
class NoiseRecord:
    """Reference and response over one stretch of noise, without gaps."""

    level: float
    noise: object  # its seed; where the run names none, one of its own
    interval: float
    cutoff: float  # Hz, that the noise reaches to
    given: Array
    answer: Array


def records_of(run: Run, loop: NoiseExperiment) -> Noted[list[NoiseRecord]]:
    """Return the usable records of noise of a run; notes say why others are left out.

    Raises
    ------
    MissingChannel : the run lacks the reference or the response.
    NotIdentifiable : there is no stretch of noise, or none with data.
    """
    asked, measured = run.channel(loop.reference, role="test"), run.channel(loop.response, role="test")
    steps = [step for step in run.steps if _is_noise(step, loop.offset)]
    if len(asked.time) != len(measured.time) or np.any(np.abs(asked.time - measured.time) > 1e-6):
        raise NotIdentifiable(f"{run.path}: {loop.reference} and {loop.response} are not sampled together")
    holds = [Hold(float(step.parameters[loop.offset]), 0, step.start + step.settle, step.stop) for step in steps]
    value, clipped = saturated(measured, holds)
    at_end = {hold.start for hold in clipped}
    found: list[NoiseRecord] = []
    left_out: dict[str, list[str]] = {}
    for step, hold in zip(steps, holds, strict=True):
        record: NoiseRecord | str = f"{loop.response} is clipped at {value:g} {measured.units}"
        if hold.start not in at_end:
            record = _record(str(run.path), asked, measured, step, loop)
        if isinstance(record, str):
            left_out.setdefault(record, []).append(f"{hold.setpoint:g} at {step.start:.1f} s")
        else:
            found.append(record)
    if not found:
        why = "; ".join(f"{len(which)}: {reason}" for reason, which in left_out.items())
        what = f"{len(steps)} stretches of noise, none of use ({why})" if steps else f"no noise with {loop.offset}"
        raise NotIdentifiable(f"{run.path}: found {what}; one with {FEWEST} samples in a row is needed")
    return Noted(found, tuple(tally(left_out, str(run.path))))


def _is_noise(step: Step, offset: str) -> bool:
    level = step.parameters.get(offset)
    numeric = isinstance(level, int | float) and not isinstance(level, bool)
    return step.name == "noise" and numeric and step.parameters.get("role", "test") == "test"


def _record(place: str, asked: Channel, measured: Channel, step: Step, loop: NoiseExperiment) -> NoiseRecord | str:
    """The longest part of a stretch without a gap, behind the record's filter; or why it is of no use."""
    from scipy.signal import butter, sosfilt

    begin, end = np.searchsorted(asked.time, (step.start + EPS_S, step.stop - EPS_S))
    time = asked.time[begin:end]
    if end - begin < FEWEST:
        return "too few samples"
    interval = float(np.median(np.diff(time)))
    missed = ~np.isfinite(asked.values[begin:end] + measured.values[begin:end])
    broken = np.flatnonzero(np.abs(np.diff(time) / interval - 1.0) > EVEN)
    stops = np.unique(np.concatenate([[-1], np.flatnonzero(missed), [end - begin]]))
    parts = [part for low, high in zip(stops[:-1] + 1, stops[1:], strict=True) for part in _cut(low, high, broken)]
    first, last = max(parts, key=lambda part: part[1] - part[0])
    kept = time[first:last] > step.start + step.settle
    if kept.sum() < FEWEST:
        return "too few samples in a row"
    reach = step.parameters.get("cutoff_Hz")
    reach = float(reach) if isinstance(reach, int | float) and reach > 0 else math.inf
    order, cutoff = loop.record_filter[0], loop.record_filter[1] * reach
    sections = butter(order, cutoff, fs=1.0 / interval, output="sos") if cutoff < 0.5 / interval else None
    columns = []
    for channel in (asked, measured):
        values = channel.values[begin + first : begin + last]
        filtered = values if sections is None else sosfilt(sections, values - values[:1])
        columns.append(filtered[kept])
    if not columns[0].std() > 0.0:
        return "the reference does not move"
    seed = step.parameters.get("seed", f"{place} {step.start:g}")
    level = float(step.parameters[loop.offset])
    return NoiseRecord(level, seed, interval, reach, *columns)


def _cut(low: int, high: int, broken: npt.NDArray[np.intp]) -> list[tuple[int, int]]:
    """A part without missed samples, cut where its stamps leap."""
    inside = [int(at) + 1 for at in broken if low <= at < high - 1]
    return list(zip([low, *inside], [*inside, high], strict=True))
