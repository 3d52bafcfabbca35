"""Trials of step experiments: one jump of a setpoint each, the readings around it, and whether it is usable.

A trial is a step of the run named `step` whose parameters have both setpoints (`signal: {kind: step}` of a protocol).
The jump is taken from the recorded reference: each row has the reference that the drive followed up to it, so the
response begins at the last row of the old reference.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import Noted, tally
from leactl.analysis.quality.saturation import find_saturation, piles_up
from leactl.analysis.quality.wrong_units import unit_question
from leactl.analysis.signals.levels import Hold, samples_between
from leactl.analysis.statistics.regression import Array
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel, Run, Step

SETTLING_BAND = 0.02  # of the step, about the steady value
FEWEST_SAMPLES = 20  # before the jump or in the steady part
MOST_MISSING = 0.1  # of a trial's samples
STAMP_ROUNDING_S = 1e-6  # of time stamps; a sample at the end of a step may belong to its neighbour
LEAST_FOLLOWED = 0.5  # of the reference's step, which the response must make
MOST_LOOP_ERROR = 1.0  # of a step; a response that misses its reference by more has wrong units


@dataclass(frozen=True, eq=False)
class StepTrial:
    """One jump, whose response is scaled from 0 before the jump to 1 in the steady part."""

    level: float  # the setpoint after the jump, in the channel's unit
    time: Array  # s since the jump, all samples behind it
    response: Array
    steady_error: float  # by which the steady value falls short of the reference, of the step
    steady_from: float  # s since the jump
    noise: float  # standard deviation of one sample in the steady part, of the step
    quantum: float  # resolution of the readings, of the step; 0 where none shows
    error_before: float  # reading less reference before the jump, of the step
    size_ratio: float = 1.0  # the response's step over the reference's

    def __str__(self) -> str:
        return f"{self.level:.3g}"


@dataclass(frozen=True)
class Jump:
    """A step of the run with the setpoints before and after its jump."""

    step: Step
    start: float
    target: float

    def __str__(self) -> str:
        return f"{self.target:g} at {self.step.start:.1f} s"


def trials_of(run: Run, reference: str, response: str, key: str) -> Noted[list[StepTrial]]:
    """Return every usable trial of the test actuator; notes say why others are left out.

    Parameters
    ----------
    reference, response : quantities of the setpoint and of the measurement.
    key : of the setpoint in a step's parameters, behind `from_` and `to_`: `current_A`, `angle_rad`.

    Raises
    ------
    MissingChannel : the run lacks one of the quantities.
    NotIdentifiable : the run has no trial, or no usable one.
    """
    setpoint, measured = run.channel(reference, role="test"), run.channel(response, role="test")
    jumps = jumps_of(run, key)
    holds = [Hold(jump.target, 0, jump.step.start + jump.step.settle, jump.step.stop) for jump in jumps]
    clipping_value, clipped_starts = clipped_holds(measured, holds, [jump.step.settle for jump in jumps])
    left_out: dict[str, list[str]] = {}
    trials = []
    for jump, hold in zip(jumps, holds, strict=True):
        trial: StepTrial | str = f"{response} is clipped at {clipping_value:g} {measured.units}"
        if hold.start not in clipped_starts:
            trial = _trial(setpoint, measured, jump)
        if isinstance(trial, str):
            left_out.setdefault(trial, []).append(str(jump))
        else:
            trials.append(trial)
    if not trials:
        reasons = "; ".join(f"{len(jumps_left_out)}: {reason}" for reason, jumps_left_out in left_out.items())
        description = (
            f"{len(jumps)} steps of {response}, none of use ({reasons})" if jumps else f"no step from and to a {key}"
        )
        raise NotIdentifiable(f"{run.path}: found {description}; one response that settles is needed")
    return Noted(trials, tuple(tally(left_out, str(run.path))))


def clipped_holds(channel: Channel, holds: Sequence[Hold], befores: Sequence[float]) -> tuple[float, set[float]]:
    """Return the value at which a channel is clipped, and the starts [s] of the settled parts that reach it.

    `befores` are the times [s] from the jump to each settled part. Where most neighbouring readings are equal, a level
    at rest looks like the end of the range; only a value that two levels share then counts as clipped.
    """
    value, at_end = find_saturation(channel, holds)
    settled = [channel.values[samples_between(channel, hold.start, hold.stop)] for hold in holds]
    equal_shares = [np.mean(np.diff(values) == 0.0) for values in settled if len(values) > 1]
    if np.median(equal_shares or [0.0]) > 0.5:
        return value, {hold.start for hold in at_end if len({hold.setpoint for hold in at_end}) > 1}
    if not at_end:
        return clipped_peaks(channel, holds, befores)
    return value, {hold.start for hold in at_end}


def clipped_peaks(channel: Channel, holds: Sequence[Hold], befores: Sequence[float]) -> tuple[float, set[float]]:
    """Return value and starts as `clipped_holds` does, for responses that are clipped before they settle.

    An example is the top of an overshoot.
    """
    spans = [
        samples_between(channel, hold.start - before, hold.stop) for hold, before in zip(holds, befores, strict=True)
    ]
    values_by_hold = [channel.values[samples][np.isfinite(channel.values[samples])] for samples in spans]
    readings = np.concatenate(values_by_hold) if values_by_hold else np.zeros(0)
    for extreme in (readings.max(), readings.min()) if len(readings) else ():
        starts = {
            hold.start
            for hold, values in zip(holds, values_by_hold, strict=True)
            if piles_up(values, float(extreme), share=0.0)
        }
        if starts:
            return float(extreme), starts
    return float("nan"), set()


def jumps_of(run: Run, key: str) -> list[Jump]:
    """Return the steps of the run that jump from one setpoint of the test actuator to another."""
    jumps = []
    for step in run.steps:
        setpoints = [step.parameters.get(f"{prefix}_{key}") for prefix in ("from", "to")]
        numbers = [
            float(value) for value in setpoints if isinstance(value, int | float) and not isinstance(value, bool)
        ]
        if step.name == "step" and len(numbers) == 2 and step.parameters.get("role", "test") == "test":
            jumps.append(Jump(step, *numbers))
    return jumps


def _trial(setpoint: Channel, measured: Channel, jump: Jump) -> StepTrial | str:
    """Return the trial of a jump, or the reason why it is not used."""
    step = jump.step
    in_step = slice(*np.searchsorted(setpoint.time, (step.start + STAMP_ROUNDING_S, step.stop - STAMP_ROUNDING_S)))
    references, stamps = setpoint.values[in_step], setpoint.time[in_step]
    nearer = np.abs(references - jump.target) < np.abs(references - jump.start)
    if not nearer.any() or nearer[0] or jump.target == jump.start:
        return "the recorded reference does not jump"
    first_new = int(np.argmax(nearer))
    jump_time = float(stamps[first_new - 1])
    start, target = (float(np.nanmedian(values)) for values in (references[:first_new], references[first_new:]))

    time = measured.time - (0.5 * float(np.median(np.diff(measured.time))) if measured.sampling == "mean" else 0.0)
    within = (time > step.start + STAMP_ROUNDING_S) & (time < step.stop - STAMP_ROUNDING_S)
    time, values = time[within] - jump_time, measured.values[within]
    after_jump, steady = time > 0.0, time >= step.start + step.settle - jump_time
    resting = (time <= 0.0) & (time >= 0.5 * (step.start - jump_time))  # the later half of the wait for the jump
    finite = np.isfinite(values)
    if (~finite[after_jump]).mean() > MOST_MISSING if after_jump.any() else True:
        return "too many samples are missing"
    if step.settle <= jump_time - step.start or min((finite & resting).sum(), (finite & steady).sum()) < FEWEST_SAMPLES:
        return f"fewer than {FEWEST_SAMPLES} samples before the jump or in the steady part"
    before_value, steady_value = float(values[finite & resting].mean()), float(values[finite & steady].mean())
    response_step, reference_step = steady_value - before_value, target - start
    if response_step * reference_step < 0.0 and abs(response_step) > LEAST_FOLLOWED * abs(reference_step):
        return "the response goes against the reference: a sign is swapped"
    if abs(response_step) < LEAST_FOLLOWED * abs(reference_step):
        return f"the response makes less than {LEAST_FOLLOWED:.0%} of the step"
    response = (values - before_value) / response_step
    residual = response[finite & steady] - 1.0
    quarters = np.array([quarter.mean() for quarter in np.array_split(residual, 4)])
    if np.max(np.abs(quarters)) > SETTLING_BAND:
        return f"the response never settles within {SETTLING_BAND:.0%}"
    return StepTrial(
        level=jump.target,
        time=time[finite & after_jump],
        response=response[finite & after_jump],
        steady_error=(target - steady_value) / reference_step,
        steady_from=float(step.start + step.settle - jump_time),
        noise=float(np.sqrt(0.5 * np.mean(np.diff(residual) ** 2))),  # differences, so that drift is not noise
        quantum=quantum_of(values[finite]) / abs(response_step),
        error_before=(before_value - start) / response_step,
        size_ratio=response_step / reference_step,
    )


def rounding_limit_of(noise: float, quantum: float) -> float:
    """Return the limit of a reading's rounding error; zero where the noise averages it out.

    Noise (standard deviation of a reading), quantum (resolution of the readings) and the limit have one unit.
    """
    return 0.0 if noise > 0.5 * quantum else 0.5 * quantum


def quantum_of(values: Array) -> float:
    """Return the smallest difference between two readings; zero where few readings are equal."""
    distinct = np.unique(values)
    if len(distinct) < 2 or len(distinct) > 0.9 * len(values):
        return 0.0
    steps = np.diff(distinct)
    steps = steps[steps > 1e-6 * np.max(np.abs(distinct))]  # smaller steps are rounding in single precision
    return float(steps.min()) if len(steps) else 0.0


def drift_notes(levels: Sequence[Sequence[StepTrial]]) -> list[str]:
    """Return notes on levels that stay off their reference, and on readings that drift before the jump."""
    notes = []
    for trials in levels:
        shortfall = mean_steady_error(trials)
        if SETTLING_BAND < abs(shortfall) <= MOST_LOOP_ERROR:
            notes.append(
                f"at {trials[0]} the response stays {shortfall:+.1%} of the step short of its reference: a channel that"
                " is clipped or drifts, or a loop that lets it; every figure counts from where it stays"
            )
        drift = float(np.ptp([trial.error_before for trial in trials]))
        if drift > SETTLING_BAND:
            notes.append(
                f"at {trials[0]} what is read before the jump moves by {drift:.1%} of the step over the trials: the"
                " channel drifts, and overshoot and settling time contain the drift"
            )
    return notes


def wrong_size_notes(levels: Sequence[Sequence[StepTrial]], response: str) -> list[str]:
    """Return a note on levels whose response misses the reference by more than the whole step."""
    wrong_levels = [trials for trials in levels if abs(mean_steady_error(trials)) > MOST_LOOP_ERROR]
    if not wrong_levels:
        return []
    ratio = float(np.mean([trial.size_ratio for trials in wrong_levels for trial in trials]))
    listing = ", ".join(str(trials[0]) for trials in wrong_levels)
    return [
        f"at {listing} the response makes {ratio:.4g} times the step of its reference:"
        f" {unit_question(ratio, [response])}"
    ]


def mean_steady_error(trials: Sequence[StepTrial]) -> float:
    """Return the mean shortfall of a level's steady values from the reference, as a share of the step."""
    return float(np.mean([trial.steady_error for trial in trials]))


def repeat_notes(levels: Sequence[Sequence[StepTrial]]) -> list[str]:
    """Return notes on levels that have fewer trials than others, or a single one."""
    counts = {str(trials[0]): len(trials) for trials in levels}
    notes = []
    if len(set(counts.values())) > 1:
        shown = ", ".join(f"{count} at {level}" for level, count in counts.items())
        notes.append(f"repeats are missing: trials are {shown}; every level counts the same")
    if lone := [level for level, count in counts.items() if count == 1]:
        notes.append(f"one trial alone at {', '.join(lone)}: its scatter is not known, so that there are no intervals")
    return notes
