"""Trials of step experiments: one jump of a setpoint each, with the readings around it, if they are usable.

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
MOST_MISSING_SHARE = 0.1  # of a trial's samples after the jump
STAMP_ROUNDING_S = 1e-6  # of time stamps; a sample at the end of a step may belong to its neighbour
LEAST_FOLLOWED_SHARE = 0.5  # of the reference's step; a response that makes less does not follow it
MOST_LOOP_ERROR = 1.0  # of a step; a response that misses its reference by more has wrong units


@dataclass(frozen=True, eq=False)
class StepTrial:
    """One jump, whose response is scaled from 0 before the jump to 1 in the steady part."""

    level: float  # the setpoint after the jump, in the channel's unit
    time: Array  # s since the jump, of all samples after it
    response: Array  # of the step
    steady_error: float  # of the step, by which the steady value falls short of the reference
    steady_from: float  # s since the jump, at which the steady part begins
    noise: float  # of the step, standard deviation of one sample in the steady part
    quantum: float  # of the step, resolution of the readings; 0 if none shows
    error_before: float  # of the step, reading minus reference before the jump
    size_ratio: float = 1.0  # the response's step over the reference's

    def __str__(self) -> str:
        return f"{self.level:.3g}"


@dataclass(frozen=True)
class Jump:
    """A step of the run with the setpoints before and after its jump."""

    step: Step
    start: float  # setpoint before the jump
    target: float  # setpoint after it

    def __str__(self) -> str:
        return f"{self.target:g} at {self.step.start:.1f} s"


def trials_of(run: Run, reference: str, response: str, key: str) -> Noted[list[StepTrial]]:
    """Return every usable trial of the test actuator; notes say why other trials are left out.

    Parameters
    ----------
    reference, response : quantities of the setpoint and of the measurement.
    key : name of the setpoint in a step's parameters after `from_` and `to_`: `current_A`, `angle_rad`.

    Raises
    ------
    MissingChannel : the run lacks one of the quantities.
    NotIdentifiable : the run has no trial, or no usable trial.
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


def clipped_holds(channel: Channel, holds: Sequence[Hold], settle_times: Sequence[float]) -> tuple[float, set[float]]:
    """Return the value at which a channel is clipped, and the starts [s] of the settled parts that reach it.

    `settle_times` are the times [s] from the start of each step to its settled part. If most neighbouring readings are
    equal, a level at rest looks like the end of the range; then only a value that two levels share counts as clipped.
    """
    value, holds_at_end = find_saturation(channel, holds)
    settled_values = [channel.values[samples_between(channel, hold.start, hold.stop)] for hold in holds]
    equal_shares = [np.mean(np.diff(values) == 0.0) for values in settled_values if len(values) > 1]
    if np.median(equal_shares or [0.0]) > 0.5:
        return value, {hold.start for hold in holds_at_end if len({hold.setpoint for hold in holds_at_end}) > 1}
    if not holds_at_end:
        return clipped_peaks(channel, holds, settle_times)
    return value, {hold.start for hold in holds_at_end}


def clipped_peaks(channel: Channel, holds: Sequence[Hold], settle_times: Sequence[float]) -> tuple[float, set[float]]:
    """Return value and starts as `clipped_holds` does, for responses that are clipped before they settle.

    An example is the top of an overshoot.
    """
    slices = [
        samples_between(channel, hold.start - settle_time, hold.stop)
        for hold, settle_time in zip(holds, settle_times, strict=True)
    ]
    values_by_hold = [channel.values[span][np.isfinite(channel.values[span])] for span in slices]
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
        numeric_setpoints = [
            float(value) for value in setpoints if isinstance(value, int | float) and not isinstance(value, bool)
        ]
        if step.name == "step" and len(numeric_setpoints) == 2 and step.parameters.get("role", "test") == "test":
            jumps.append(Jump(step, *numeric_setpoints))
    return jumps


def _trial(setpoint: Channel, measured: Channel, jump: Jump) -> StepTrial | str:
    """Return the trial of a jump, or the reason why the jump is not used."""
    step = jump.step
    in_step = slice(*np.searchsorted(setpoint.time, (step.start + STAMP_ROUNDING_S, step.stop - STAMP_ROUNDING_S)))
    references, stamps = setpoint.values[in_step], setpoint.time[in_step]
    is_nearer_target = np.abs(references - jump.target) < np.abs(references - jump.start)
    if not is_nearer_target.any() or is_nearer_target[0] or jump.target == jump.start:
        return "the recorded reference does not jump"
    first_new = int(np.argmax(is_nearer_target))
    jump_time = float(stamps[first_new - 1])
    start, target = (float(np.nanmedian(values)) for values in (references[:first_new], references[first_new:]))

    time = measured.time - (0.5 * float(np.median(np.diff(measured.time))) if measured.sampling == "mean" else 0.0)
    in_trial = (time > step.start + STAMP_ROUNDING_S) & (time < step.stop - STAMP_ROUNDING_S)
    time, values = time[in_trial] - jump_time, measured.values[in_trial]
    after_jump, in_steady_part = time > 0.0, time >= step.start + step.settle - jump_time
    # the second half of the time before the jump
    before_jump = (time <= 0.0) & (time >= 0.5 * (step.start - jump_time))
    finite = np.isfinite(values)
    if (~finite[after_jump]).mean() > MOST_MISSING_SHARE if after_jump.any() else True:
        return "too many samples are missing"
    if (
        step.settle <= jump_time - step.start
        or min((finite & before_jump).sum(), (finite & in_steady_part).sum()) < FEWEST_SAMPLES
    ):
        return f"fewer than {FEWEST_SAMPLES} samples before the jump or in the steady part"
    before_value, steady_value = (
        float(values[finite & before_jump].mean()),
        float(values[finite & in_steady_part].mean()),
    )
    response_step, reference_step = steady_value - before_value, target - start
    if response_step * reference_step < 0.0 and abs(response_step) > LEAST_FOLLOWED_SHARE * abs(reference_step):
        return "the response goes against the reference: a sign is swapped"
    if abs(response_step) < LEAST_FOLLOWED_SHARE * abs(reference_step):
        return f"the response makes less than {LEAST_FOLLOWED_SHARE:.0%} of the step"
    response = (values - before_value) / response_step
    residual = response[finite & in_steady_part] - 1.0
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
    """Return the limit of a reading's rounding error; zero if the noise averages it out.

    `noise` (standard deviation of a reading), `quantum` (resolution of the readings) and the limit have one unit.
    """
    return 0.0 if noise > 0.5 * quantum else 0.5 * quantum


def quantum_of(values: Array) -> float:
    """Return the smallest difference between two readings; zero if few readings are equal."""
    distinct_values = np.unique(values)
    if len(distinct_values) < 2 or len(distinct_values) > 0.9 * len(values):
        return 0.0
    steps = np.diff(distinct_values)
    steps = steps[steps > 1e-6 * np.max(np.abs(distinct_values))]  # smaller steps are rounding in single precision
    return float(steps.min()) if len(steps) else 0.0


def drift_notes(levels: Sequence[Sequence[StepTrial]]) -> list[str]:
    """Return notes on levels that do not reach their reference, and on readings that drift before the jump."""
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
    levels_text = ", ".join(str(trials[0]) for trials in wrong_levels)
    return [
        f"at {levels_text} the response makes {ratio:.4g} times the step of its reference:"
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
        counts_text = ", ".join(f"{count} at {level}" for level, count in counts.items())
        notes.append(f"repeats are missing: trials are {counts_text}; every level counts the same")
    if single_trials := [level for level, count in counts.items() if count == 1]:
        notes.append(
            f"one trial alone at {', '.join(single_trials)}: its scatter is not known, so that there are no intervals"
        )
    return notes
