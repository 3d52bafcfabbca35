"""Faults that a channel's own samples show: wrapped, frozen, repeated, clipped."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np
import numpy.typing as npt

from leactl.gap.diagnosis import EffectParameter
from leactl.gap.setup.contract import SetUpFault, left_out, with_values
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import Clocked, Key, Record, smallest_step
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
MEASURED = ("q_axis_current", "velocity", "torque", "q_axis_voltage")  # that noise keeps from standing still
SEEN = 0.99  # probability of what samples show by themselves
ALIKE = 0.1  # of a period, by which leaps of a wrapped channel differ
LEAPS = 0.6  # of a channel's whole range, from which a step from one sample to the next is a leap
TURN = 16.0  # steps of an encoder, below which a leap is an angle at rest that flickers
FROZEN = 0.3  # of a record, from which a channel that stands still is no rest
MOVES = 0.2  # of its usual deviation, that a companion has to have meanwhile
LONGEST_REST = 100  # samples
FINE = 200  # levels, from which two equal samples in a row are no rounding
REPEATED = 0.3  # of a channel's samples
CLEAN = 0.1  # of its reference's noise, below which a channel is no measured one
TOPPED, IN_A_ROW = 0.01, 4  # of a channel's samples at its end, and how many of them stand together
COMPANIONS = {
    "velocity": "angle",
    "angle": "velocity",
    "q_axis_current": "q_axis_current_reference",
    "q_axis_current_reference": "q_axis_current",
    "torque": "q_axis_current",
}
"""Channels, and what does not move without them."""


def channels_of(records: Sequence[Record], quantities: Collection[str]) -> Iterator[tuple[Key, dict[str, Clocked]]]:
    """Every channel of these quantities with the clocks of the records that have it, by their names."""
    clocks = {record.name: record.fast for record in records if record.fast is not None}
    for key in sorted({key for clock in clocks.values() for key in clock.values if key[0] in quantities}):
        yield key, {name: clock for name, clock in clocks.items() if key in clock.values}


def share_of(masks: Iterable[Mask]) -> str:
    """The share of some masks' samples, in percent."""
    return f"{100.0 * float(np.mean(np.concatenate(list(masks)))):.0f} %"


def wrapped(records: Sequence[Record], _: Model) -> SetUpFault | None:
    """An angle that leaps by a whole range where it should go on."""
    for key, clocks in channels_of(records, ("angle",)):
        period = max(period_of(clock.values[key][clock.all_valid(key)]) for clock in clocks.values())
        if period > 0.0:
            evidence = f"leaps by {period:.6g} rad from one sample to the next"
            parameters = (EffectParameter("period", period, 0.0, "rad"),)
            mend = partial(unwrapped, key=key, period=period)
            return SetUpFault("wrapped_channel", key, SEEN, evidence, "unwrap it on import", mend, parameters)
    return None


def unwrapped(record: Record, key: Key, period: float) -> Record:
    """A record whose angle goes on where it leapt by a period."""
    if record.fast is None or key not in record.fast.values:
        return record
    return with_values(record, key, np.unwrap(record.fast.values[key], period=period))


def period_of(values: Array) -> float:
    """The period by which values leap, zero where they do not."""
    steps, whole = np.diff(values), float(np.ptp(values))
    leaps = np.abs(steps[np.abs(steps) > LEAPS * whole])
    if len(leaps) < 2 or float(np.median(leaps)) < TURN * smallest_step(values):
        return 0.0
    period = float(np.median(leaps)) + float(np.median(np.abs(steps)))
    near = 2.0 * np.pi if abs(period / (2.0 * np.pi) - 1.0) < ALIKE else period
    return near if float(np.ptp(leaps)) < ALIKE * near else 0.0


def frozen(records: Sequence[Record], _: Model) -> SetUpFault | None:
    """A channel that stands still for long while what must move with it does."""
    mechanical = {record.name: record.mechanical for record in records}
    for key, clocks in channels_of(records, COMPANIONS):
        if all(may_rest(key, mechanical[name]) for name in clocks):
            continue
        rests = {name: rest_of(clock, key) for name, clock in clocks.items() if not may_rest(key, mechanical[name])}
        still = lasting(rests, {record.name: record.run for record in records})
        if still:
            evidence = f"stands still over {share_of(rests.values())} of its samples while {COMPANIONS[key[0]]} moves"
            change = "look at its wire and its column; these samples are left out"
            mend = partial(left_out, key=key, masks=still)
            return SetUpFault("frozen_channel", key, SEEN, evidence, change, mend, shrinks=False)
    return None


def lasting(rests: Mapping[str, Mask], runs: Mapping[str, str]) -> dict[str, Mask]:
    """The rests of runs that rest long enough, over all the stretches that are looked at of each."""
    by_run: dict[str, Mask] = {}
    for run in {runs[name] for name in rests}:
        own = {name: rest for name, rest in rests.items() if runs[name] == run}
        if float(np.mean(np.concatenate(list(own.values())))) >= FROZEN:
            by_run |= {name: rest for name, rest in own.items() if rest.any()}
    return by_run


def may_rest(key: Key, mechanical: str) -> bool:
    """Whether a channel may stand still in a set-up while its companion moves."""
    if mechanical in ("locked", "heated"):
        return key[0] in ("angle", "velocity")
    return mechanical == "free" and key[0] == "torque"


def rest_of(clock: Clocked, key: Key) -> Mask:
    """Samples over which a channel stands still too long, its companion moving; all of them in most of a record."""
    values, resting = where_measured(clock, key), np.zeros(len(clock.time), np.bool_)
    companion = clock.get(COMPANIONS[key[0]], key[1])
    begin, end = longest_run(np.diff(values) == 0.0)
    if companion is None or end - begin < max(LONGEST_REST, FROZEN * len(values)):
        return resting
    # a speed moves with the change of an angle, and an angle with the size of a speed
    moving = np.abs(companion) if key[0] == "angle" else np.diff(companion, prepend=companion[0])
    if key[0] not in ("angle", "velocity"):
        moving = companion - companion.mean()
    usual, meanwhile = (float(np.sqrt(np.mean(part**2))) for part in (moving, moving[begin : end + 1]))
    if key[0] not in ("angle", "velocity"):
        meanwhile = float(np.std(moving[begin : end + 1]))  # one that holds another level than usual does not move
    if usual == 0.0 or meanwhile < MOVES * usual or noise_of(companion) > 0.5 * float(np.std(companion)):
        return resting
    resting[begin : end + 1] = True
    return np.ones_like(resting) if resting.mean() > 1.0 - FROZEN else resting


def where_measured(clock: Clocked, key: Key) -> Array:
    """A channel with NaN where it was not measured."""
    return np.where(clock.all_valid(key), clock.values[key], np.nan)


def longest_run(mask: Mask) -> tuple[int, int]:
    """Begin and end of the longest run of a mask; an empty one where there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))).reshape(-1, 2)
    if len(edges) == 0:
        return 0, 0
    begin, end = edges[int(np.argmax(edges[:, 1] - edges[:, 0]))]
    return int(begin), int(end)


def measured_by(model: Model) -> tuple[str, ...]:
    """Quantities that are measured and no drive works out: a voltage that a servo counts, or a test asks for, rests."""
    return (
        MEASURED
        if model.drive is None and model.feedforward is None
        else tuple(name for name in MEASURED if name != "q_axis_voltage")
    )


def repeated(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """A measured channel of which many samples are the one before them once more."""
    for key, clocks in channels_of(records, measured_by(model)):
        shares = [float(again(clock, key).mean()) for clock in clocks.values()]
        if float(np.median(shares)) > REPEATED:
            evidence = f"repeats {100.0 * float(np.median(shares)):.0f} % of its samples"
            change = "it is sampled slower than it is logged: log it at its own rate, in a stream of its own"
            mend = partial(taken_between, key=key)
            return SetUpFault("repeated_samples", key, SEEN, evidence, change, mend, shrinks=False)
    return None


def taken_between(record: Record, key: Key) -> Record:
    """A record whose channel goes on a straight line from one fresh sample to the next."""
    clock = record.fast
    if clock is None or key not in clock.values:
        return record
    fresh = ~again(clock, key)
    return with_values(record, key, np.interp(clock.time, clock.time[fresh], clock.values[key][fresh]))


def again(clock: Clocked, key: Key) -> Mask:
    """Samples that are the one before them once more; none in a channel of few levels, or at rest."""
    values = clock.values[key]
    repeated = np.concatenate([[False], np.diff(values) == 0.0])
    begin, end = longest_run(repeated)
    if len(np.unique(values)) < min(FINE, len(values) // 4) or end - begin >= LONGEST_REST:
        return np.zeros(len(values), np.bool_)
    return repeated


def clipped(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """A measured channel that stands at an end of its range, sample after sample, where noise should move it."""
    for key, clocks in channels_of(records, measured_by(model)):
        topped = {
            name: top for name, clock in clocks.items() if noisy(clock, key) and (top := at_ends(clock, key)).any()
        }
        if topped:
            level = max(float(np.max(np.abs(clocks[name].values[key]))) for name in topped)
            runs = len({record.run for record in records if record.name in topped})
            evidence = f"stands at {level:.6g} over {share_of(topped.values())} of the samples of {runs} runs"
            parameters = (EffectParameter("level", level, 0.0, next(iter(clocks.values())).units.get(key, "")),)
            mend = partial(left_out, key=key, masks=topped)
            change = "widen its range; these samples are left out"
            return SetUpFault("clipped_channel", key, SEEN, evidence, change, mend, parameters, shrinks=False)
    return None


def begins_at_rest(values: Array) -> slice:
    """Samples at zero before a channel first moves: a run to one side begins at an end of its range."""
    return slice(0, int(np.argmax(values != 0.0)))


def noisy(clock: Clocked, key: Key) -> bool:
    """Whether noise moves a channel, as far as its reference tells: a setpoint may well stand at a limit."""
    reference, values = clock.get(f"{key[0]}_reference", key[1]), clock.values[key]
    moving = values[np.diff(values, prepend=np.nan) != 0.0]  # a channel that mostly stands at its ends shows none
    return reference is None or noise_of(moving, 0.0) >= CLEAN * noise_of(reference, 0.0)


def at_ends(clock: Clocked, key: Key) -> Mask:
    """Samples at which a channel of many levels stands at its largest or smallest value, several in a row."""
    values = where_measured(clock, key)
    at_limit = np.zeros(len(values), np.bool_)
    if len(np.unique(values[np.isfinite(values)])) < min(FINE, len(values) // 4):
        return at_limit
    still = np.concatenate([[False], np.diff(values) == 0.0])
    ends = [values == np.nanmax(values), values == np.nanmin(values)]
    if float(np.mean(still[~(ends[0] | ends[1])])) >= TOPPED:
        return at_limit  # samples in a row are alike elsewhere as well
    for there in ends:
        there[begins_at_rest(values)] = False
        begin, stop = longest_run(there)
        if stop - begin >= IN_A_ROW and float(there.mean()) >= TOPPED:
            at_limit |= there
    return at_limit
