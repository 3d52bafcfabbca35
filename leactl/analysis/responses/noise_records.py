"""Records of noise experiments: reference and response over each stretch of noise, without gaps.

A stretch is a step named `noise` (`signal: {kind: noise}` of a protocol); its parameters have the level, and seed and
cut-off of the noise where these are known.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import Noted, tally
from leactl.analysis.quality.saturation import find_saturation
from leactl.analysis.signals.levels import Hold
from leactl.analysis.statistics.regression import Array
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel, Run, Step

FEWEST_GAPLESS_SAMPLES = 1600  # 4 x WINDOW_LAGS of noise_response: record over longest lag
STAMP_ROUNDING_S = 1e-6  # of time stamps; a sample at the end of a step may belong to its neighbour
MOST_INTERVAL_DEVIATION = 0.2  # largest difference of an interval from the median one, as a share of it


@dataclass(frozen=True)
class NoiseExperiment:
    """The quantities, the setup and the filter of a noise experiment."""

    experiment: str
    reference: str
    response: str
    level_key: str  # key of the level in a step's parameters
    setup: str
    # Butterworth filter of both records: order, and cut-off as a multiple of the noise's cut-off
    record_filter: tuple[int, float]


@dataclass(frozen=True, eq=False)
class NoiseRecord:
    """Reference and response over one stretch of noise, without gaps."""

    level: float
    seed: object  # seed of the noise; a text that is unique to the record if the run states none
    interval: float  # s
    cutoff: float  # Hz, of the noise; infinite where the run states none
    reference: Array
    response: Array


def records_of(run: Run, experiment: NoiseExperiment) -> Noted[list[NoiseRecord]]:
    """Return the usable records of noise of a run; notes say why others are left out.

    Raises
    ------
    MissingChannel : the run lacks the reference or the response.
    NotIdentifiable : the run has no usable stretch of noise, or reference and response are not sampled together.
    """
    reference, response = run.channel(experiment.reference, role="test"), run.channel(experiment.response, role="test")
    steps = [step for step in run.steps if _is_noise(step, experiment.level_key)]
    if len(reference.time) != len(response.time) or np.any(np.abs(reference.time - response.time) > STAMP_ROUNDING_S):
        raise NotIdentifiable(f"{run.path}: {experiment.reference} and {experiment.response} are not sampled together")
    holds = [
        Hold(float(step.parameters[experiment.level_key]), 0, step.start + step.settle, step.stop) for step in steps
    ]
    clipping_value, clipped = find_saturation(response, holds)
    clipped_starts = {hold.start for hold in clipped}
    records: list[NoiseRecord] = []
    stretches_by_reason: dict[str, list[str]] = {}
    for step, hold in zip(steps, holds, strict=True):
        record: NoiseRecord | str
        if hold.start in clipped_starts:
            record = f"{experiment.response} is clipped at {clipping_value:g} {response.units}"
        else:
            record = _longest_gapless_record(str(run.path), reference, response, step, experiment)
        if isinstance(record, str):
            stretches_by_reason.setdefault(record, []).append(f"{hold.setpoint:g} at {step.start:.1f} s")
        else:
            records.append(record)
    if not records:
        reasons = "; ".join(f"{len(stretches)}: {reason}" for reason, stretches in stretches_by_reason.items())
        description = (
            f"{len(steps)} stretches of noise, none of use ({reasons})"
            if steps
            else f"no noise with {experiment.level_key}"
        )
        raise NotIdentifiable(
            f"{run.path}: found {description}; one with {FEWEST_GAPLESS_SAMPLES} samples in a row is needed"
        )
    return Noted(records, tuple(tally(stretches_by_reason, str(run.path))))


def _is_noise(step: Step, level_key: str) -> bool:
    """Return whether a step is noise of the test actuator about a level, whose key is `level_key`."""
    level = step.parameters.get(level_key)
    numeric = isinstance(level, int | float) and not isinstance(level, bool)
    return step.name == "noise" and numeric and step.parameters.get("role", "test") == "test"


def _longest_gapless_record(
    run_path: str, reference: Channel, response: Channel, step: Step, experiment: NoiseExperiment
) -> NoiseRecord | str:
    """Return the longest gapless part of a stretch of noise, filtered; or the reason why the stretch is not used."""
    from scipy.signal import butter, sosfilt

    begin, end = np.searchsorted(reference.time, (step.start + STAMP_ROUNDING_S, step.stop - STAMP_ROUNDING_S))
    time = reference.time[begin:end]
    if end - begin < FEWEST_GAPLESS_SAMPLES:
        return "too few samples"
    interval = float(np.median(np.diff(time)))
    is_missing = ~np.isfinite(reference.values[begin:end] + response.values[begin:end])
    gap_after = np.flatnonzero(np.abs(np.diff(time) / interval - 1.0) > MOST_INTERVAL_DEVIATION)
    stops = np.unique(np.concatenate([[-1], np.flatnonzero(is_missing), [end - begin]]))
    pieces = [
        piece
        for low, high in zip(stops[:-1] + 1, stops[1:], strict=True)
        for piece in _split_at_time_gaps(low, high, gap_after)
    ]
    settles_at = int(np.searchsorted(time, step.start + step.settle, side="right"))
    piece_start, piece_stop = max(pieces, key=lambda piece: piece[1] - max(piece[0], settles_at))
    settled = np.arange(piece_start, piece_stop) >= settles_at
    if settled.sum() < FEWEST_GAPLESS_SAMPLES:
        return "too few samples in a row"
    stated_cutoff = step.parameters.get("cutoff_Hz")
    noise_cutoff = float(stated_cutoff) if isinstance(stated_cutoff, int | float) and stated_cutoff > 0 else math.inf
    order, cutoff = experiment.record_filter[0], experiment.record_filter[1] * noise_cutoff
    sections = butter(order, cutoff, fs=1.0 / interval, output="sos") if cutoff < 0.5 / interval else None
    columns = []
    for channel in (reference, response):
        values = channel.values[begin + piece_start : begin + piece_stop]
        # less the first value, so that the filter starts at rest and does not answer it as a step
        filtered = values if sections is None else sosfilt(sections, values - values[:1])
        columns.append(filtered[settled])
    if not columns[0].std() > 0.0:
        return "the reference does not move"
    seed = step.parameters.get("seed", f"{run_path} {step.start:g}")
    level = float(step.parameters[experiment.level_key])
    return NoiseRecord(level, seed, interval, noise_cutoff, *columns)


def _split_at_time_gaps(low: int, high: int, gap_after: npt.NDArray[np.intp]) -> list[tuple[int, int]]:
    """Split the samples from `low` to before `high` at gaps of the time stamps; return start and stop of each piece.

    `gap_after` has the indices of the samples after which there is a gap.
    """
    inside = [int(index) + 1 for index in gap_after if low <= index < high - 1]
    return list(zip([low, *inside], [*inside, high], strict=True))
