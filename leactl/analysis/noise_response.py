"""Frequency response of a drive's loops to noise about several levels: -3 dB bandwidth and the band that is known.

Paper, section "Controller Performance": Blackman-Tukey with a window of 400 samples, bandwidth at the -3 dB crossover,
mean over trials and levels. A response counts where its coherence is 0.6 or more (Tischler & Remple, Aircraft and
Rotorcraft System Identification, 2nd ed., section 2.2) and the noise was meant to reach; elsewhere it is not known, and
so is a bandwidth that lies there. It is the response to noise of that size: friction takes more of a smaller one.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.blackman_tukey import BlackmanTukey, Response, Spectra
from leactl.analysis.estimate import NAN, Estimate, Plot, Result, Series, tally
from leactl.analysis.jackknife import LevelValue, Reading, mean_of_levels, over_trials
from leactl.analysis.levels import Hold
from leactl.analysis.linefit import expect_setup, place_of
from leactl.analysis.regression import Array
from leactl.analysis.saturation import saturated
from leactl.errors import NotIdentifiable
from leactl.runfile.reader import Channel, Run, Step

LAGS = 400
COHERENT = 0.6
HALF_POWER = math.sqrt(0.5)
ONE_SIDED = 1.645  # standard errors of a bound at 95 %
FEWEST_WINDOWS = 4  # of lags, in a record
EPS_S = 1e-6  # rounding of stamps
EVEN = 0.2  # of an interval that stamps may be off
SHOWN = 80  # points of a level in a plot


@dataclass(frozen=True)
class Loop:
    """What a noise experiment looks at."""

    experiment: str
    reference: str
    response: str
    offset: str  # key of the level in a step's parameters
    setup: str
    record_filter: tuple[int, float]  # order and cut-off [Hz] of the Butterworth filter that both records pass


@dataclass(frozen=True, eq=False)
class Record:
    """Reference and response over one stretch of noise, without gaps."""

    level: float
    key: tuple[float, object]  # the same for records of the same noise, which are no independent trials
    interval: float
    cutoff: float  # Hz, that the noise reaches to
    given: Array
    answer: Array


def noise_response(runs: Sequence[Run], loop: Loop) -> Result:
    """Bandwidth of the test actuator's loop.

    `bandwidth` [Hz]: where the gain first falls below -3 dB, mean over the levels. Where it does not in the band that is
    known, its value is NaN and `low` is how far the gain stays above at 95 % confidence. `coherent_band_low` and
    `coherent_band_high` [Hz]: what is known of every level, without the stretches that the notes name.

    Raises
    ------
    MissingChannel : a run has no reference or no response of the test actuator.
    NotIdentifiable : no noise with data, no band of enough coherence, or a response against its reference.
    """
    place = f"{place_of(runs)}: {loop.experiment}"
    notes = expect_setup(runs, (loop.setup,), "the response is that of another load")
    records = [record for run in runs for record in records_of(run, loop, notes)]
    interval = float(np.median([record.interval for record in records]))
    highest = min(min(record.cutoff for record in records), loop.record_filter[1], 0.5 / interval)
    method = BlackmanTukey(interval, LAGS, highest)
    levels: dict[float, dict[tuple[float, object], Spectra]] = {}
    for record in sorted(records, key=lambda record: record.level):
        spectra, own = method.spectra(record.given, record.answer), levels.setdefault(record.level, {})
        own[record.key] = own[record.key].plus(spectra) if record.key in own else spectra
    counts = {level: len(trials) for level, trials in levels.items()}
    if len(set(counts.values())) > 1:
        shown = ", ".join(f"{count} at {level:.3g}" for level, count in counts.items())
        notes.append(f"repeats are missing: records are {shown}; every level counts the same")

    responses = {level: method.response(_sum(list(trials.values()))) for level, trials in levels.items()}
    known = {level: known_of(response, method.resolved, level, place, notes) for level, response in responses.items()}
    together = np.all(list(known.values()), axis=0)
    if not together.any():
        raise NotIdentifiable(f"{place}: no frequency at which the coherence of every level is {COHERENT:g} or more")
    band = responses[next(iter(levels))].frequency[together]
    for level, response in responses.items():
        refuse_swapped(response, known[level], f"{place}: at {level:.3g}")
    bandwidth = bandwidth_of(method, levels, responses, known, notes)
    ends = [("coherent_band_low", float(band[0])), ("coherent_band_high", float(band[-1]))]
    results = (bandwidth, *(Estimate(name, value, NAN, NAN, NAN, "Hz") for name, value in ends))
    if not bandwidth.high <= 0.1 / interval:
        notes.append(
            f"above {0.1 / interval:g} Hz, a tenth of the record's rate, this is the response of the sampled loop: from "
            "references that are held to samples at their ends"
        )
    units = runs[0].channel(loop.response, role="test").units
    plots = plots_of(responses, known, units)
    return Result(loop.experiment, tuple(str(run.path) for run in runs), results, tuple(notes), plots)


def records_of(run: Run, loop: Loop, notes: list[str]) -> list[Record]:
    """Every stretch of noise of a run with data; what is left out goes into the notes.

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
    found, left_out = [], {}
    for step, hold in zip(steps, holds, strict=True):
        record: Record | str = f"{loop.response} is clipped at {value:g} {measured.units}"
        if hold.start not in at_end:
            record = _record(asked, measured, step, loop)
        if isinstance(record, str):
            left_out.setdefault(record, []).append(f"{hold.setpoint:g} at {step.start:.1f} s")
        else:
            found.append(record)
    notes += tally(left_out, str(run.path))
    if not found:
        why = "; ".join(f"{len(which)}: {reason}" for reason, which in left_out.items())
        what = f"{len(steps)} stretches of noise, none of use ({why})" if steps else f"no noise with {loop.offset}"
        raise NotIdentifiable(f"{run.path}: found {what}; one with {FEWEST_WINDOWS * LAGS} samples in a row is needed")
    return found


def _is_noise(step: Step, offset: str) -> bool:
    level = step.parameters.get(offset)
    numeric = isinstance(level, int | float) and not isinstance(level, bool)
    return step.name == "noise" and numeric and step.parameters.get("role", "test") == "test"


def _record(asked: Channel, measured: Channel, step: Step, loop: Loop) -> Record | str:
    """The longest part of a stretch without a gap, behind the record's filter; or why it is of no use."""
    from scipy.signal import butter, sosfilt

    begin, end = np.searchsorted(
        asked.time, (step.start + EPS_S, step.stop + EPS_S)
    )  # the first row is the last of before
    time = asked.time[begin:end]
    if end - begin < FEWEST_WINDOWS * LAGS:
        return "too few samples"
    interval = float(np.median(np.diff(time)))
    missed = ~np.isfinite(asked.values[begin:end] + measured.values[begin:end])
    broken = np.flatnonzero(np.abs(np.diff(time) / interval - 1.0) > EVEN)
    stops = np.unique(np.concatenate([[-1], np.flatnonzero(missed), [end - begin]]))
    parts = [part for low, high in zip(stops[:-1] + 1, stops[1:], strict=True) for part in _cut(low, high, broken)]
    first, last = max(parts, key=lambda part: part[1] - part[0])
    order, cutoff = loop.record_filter
    sections = butter(order, cutoff, fs=1.0 / interval, output="sos") if cutoff < 0.5 / interval else None
    columns = []
    for channel in (asked, measured):
        values = channel.values[begin + first : begin + last]
        filtered = values if sections is None else sosfilt(sections, values - values[:1])
        columns.append(filtered[time[first:last] > step.start + step.settle])
    if len(columns[0]) < FEWEST_WINDOWS * LAGS:
        return "too few samples in a row"
    if not columns[0].std() > 0.0:
        return "the reference does not move"
    reach = step.parameters.get("cutoff_Hz")
    reach = float(reach) if isinstance(reach, int | float) and reach > 0 else math.inf
    seed = step.parameters.get("seed", (id(asked), step.start))
    level = float(step.parameters[loop.offset])
    return Record(level, (level, seed), interval, reach, *columns)


def _cut(low: int, high: int, broken: Array) -> list[tuple[int, int]]:
    """A part without missed samples, cut where its stamps leap."""
    inside = [int(at) + 1 for at in broken if low <= at < high - 1]
    return list(zip([low, *inside], [*inside, high], strict=True))


def known_of(response: Response, resolved: float, level: float, place: str, notes: list[str]) -> Array:
    """Where a level's response is known; stretches of too little coherence go into the notes."""
    frequency = response.frequency
    known = (response.coherence >= COHERENT) & (frequency >= resolved)
    unknown = ~known & (frequency >= resolved)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], unknown, [False]]).astype(np.int8)))
    for first, last in zip(edges[::2], edges[1::2] - 1, strict=True):
        notes.append(
            f"coherence at {level:.3g} is below {COHERENT:g} from {frequency[first]:.1f} to {frequency[last]:.1f} Hz: the "
            "response there is not known"
        )
    return known


def refuse_swapped(response: Response, known: Array, place: str) -> None:
    """Refuse a response that goes against its reference where it should follow it best.

    Raises
    ------
    NotIdentifiable : it does.
    """
    lowest = np.flatnonzero(known)[:4]
    if np.mean(response.value[lowest].real) < 0.0:
        at = response.frequency[lowest[0]]
        raise NotIdentifiable(f"{place} the response goes against the reference at {at:.1f} Hz: a sign is swapped")


def bandwidth_of(
    method: BlackmanTukey,
    levels: Mapping[float, Mapping[tuple[float, object], Spectra]],
    responses: Mapping[float, Response],
    known: Mapping[float, Array],
    notes: list[str],
) -> Estimate:
    """Mean of the levels' -3 dB frequencies, or what is known of it where one of them is not."""
    bounds = [within(responses[level], known[level]) for level in levels]
    if all(low == high for low, high in bounds):
        values = []
        for level, trials in levels.items():
            spectra = list(trials.values())
            values.append(_crossing_over(method, spectra, known[level]))
        return mean_of_levels("bandwidth", "Hz", values)
    low, high = (float(np.mean(side)) for side in zip(*bounds, strict=True))
    low = min(held(responses[level], known[level]) for level in levels) if math.isinf(high) else low
    if math.isinf(high):
        notes.append(f"the gain stays above -3 dB up to {low:.4g} Hz (95 %), as far as it is known: bandwidth is above")
    else:
        notes.append(f"the gain passes -3 dB where the response is not known, between {low:.4g} and {high:.4g} Hz")
    return Estimate("bandwidth", NAN, NAN, low, high, "Hz")


def within(response: Response, known: Array) -> tuple[float, float]:
    """Between which frequencies the gain first passes -3 dB; equal where it does so between two known ones."""
    at = np.flatnonzero(known)
    below = np.flatnonzero(response.gain[at] < HALF_POWER)
    if not len(below):
        return float(response.frequency[at[-1]]), math.inf
    index = int(at[below[0]])
    if not below[0]:
        return 0.0, float(response.frequency[index])
    before = int(at[below[0] - 1])
    if index - before > 1:
        return float(response.frequency[before]), float(response.frequency[index])
    value = _between(response, index)
    return value, value


def held(response: Response, known: Array) -> float:
    """How far from the bottom the gain surely stays above -3 dB [Hz]."""
    surely = ~known | (response.gain * (1.0 - ONE_SIDED * response.relative_std) > HALF_POWER)
    first = int(np.argmax(~surely)) if not surely.all() else len(surely)
    inside = np.flatnonzero(known[:first])
    return float(response.frequency[inside[-1]]) if len(inside) else 0.0


def _crossing_over(method: BlackmanTukey, spectra: Sequence[Spectra], known: Array) -> LevelValue:
    whole = _sum(spectra)

    def crossing(kept: Sequence[int]) -> Reading:
        left = [spectrum for k, spectrum in enumerate(spectra) if k not in kept]
        rest = whole.plus(_sum(left), -1) if left else whole
        low, high = within(method.response(rest), known)
        return Reading(low if low == high else NAN)

    return over_trials(len(spectra), crossing)


def _between(response: Response, index: int) -> float:
    gains, frequency = response.gain[index - 1 : index + 1], response.frequency[index - 1 : index + 1]
    share = (gains[0] - HALF_POWER) / (gains[0] - gains[1])
    return float(frequency[0] + share * (frequency[1] - frequency[0]))


def _sum(spectra: Sequence[Spectra]) -> Spectra:
    whole = spectra[0]
    for other in spectra[1:]:
        whole = whole.plus(other)
    return whole


def plots_of(responses: Mapping[float, Response], known: Mapping[float, Array], units: str) -> tuple[Plot, ...]:
    """Gain, phase and coherence over frequency; what is not known of gain and phase is left out."""
    gains, limits, phases, coherences = [], [], [], []
    for level, response in responses.items():
        every = slice(0, None, max(1, len(response.frequency) // SHOWN))
        label, x = f"{level:.3g} {units}", tuple(response.frequency[every].tolist())
        shown = np.where(known[level], response.gain, NAN)
        gains.append(Series(label, x, _tuple(20.0 * np.log10(shown)[every])))
        for side in (-1.96, 1.96):
            limit = np.maximum(shown * (1.0 + side * response.relative_std), 1e-6)
            limits.append(Series(f"{label}, 95 %", x, _tuple(20.0 * np.log10(limit)[every])))
        phase = np.where(known[level], np.unwrap(np.angle(response.value)), NAN)
        phases.append(Series(label, x, _tuple(np.degrees(phase)[every])))
        coherences.append(Series(label, x, _tuple(response.coherence[every])))
    ends = (0.0, max(series.x[-1] for series in gains))
    minus_3_db = Series("-3 dB", ends, (20.0 * math.log10(HALF_POWER),) * 2)
    threshold = Series("known from here", ends, (COHERENT,) * 2)
    return (
        Plot("frequency [Hz]", "gain [dB]", tuple(gains), (minus_3_db, *limits)),
        Plot("frequency [Hz]", "phase [deg]", tuple(phases), ()),
        Plot("frequency [Hz]", "coherence [1]", tuple(coherences), (threshold,)),
    )


def _tuple(values: Array) -> tuple[float, ...]:
    return tuple(values.tolist())
