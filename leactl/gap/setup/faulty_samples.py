"""Find faults in a channel's own samples: wrapped, frozen, repeated, clipped."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np
import numpy.typing as npt

from leactl.gap.diagnosis import EffectParameter
from leactl.gap.setup.contract import SetUpFault, with_values, without_samples
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import Clocked, Key, Record, smallest_step
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
NOISY_QUANTITIES = ("q_axis_current", "velocity", "torque", "q_axis_voltage")  # quantities that noise always changes
FAULT_PROBABILITY = 0.99  # probability of a fault that samples show
LEAP_TOLERANCE = 0.1  # largest difference of two leaps of a wrapped channel, or of its period from 2 pi, as a share
LEAST_LEAP_SHARE = 0.6  # share of a channel's range from which a step is a leap
LEAST_LEAP_STEPS = 16.0  # encoder steps; a smaller leap is an angle at rest that flickers
LEAST_FROZEN_SHARE = 0.3  # share of a record from which a constant channel is frozen, not at rest
LEAST_COMPANION_MOTION = 0.2  # deviation of the companion while a channel is constant, as a share of its usual one
LONGEST_REST = 100  # samples for which a sound channel may be constant
FEWEST_FINE_LEVELS = 200  # levels from which two equal samples in a row are not due to rounding
MOST_REPEATED_SHARE = 0.3  # largest share of repeated samples in a sound channel
LEAST_NOISE_RATIO = 0.1  # noise over that of the reference; with less, a channel is computed, not measured
LEAST_CLIPPED_SHARE = 0.01  # share of a clipped channel's samples at an end of its range
FEWEST_CLIPPED_IN_ROW = 4  # consecutive samples of a clipped channel at an end of its range
COMPANIONS = {
    "velocity": "angle",
    "angle": "velocity",
    "q_axis_current": "q_axis_current_reference",
    "q_axis_current_reference": "q_axis_current",
    "torque": "q_axis_current",
}
"""For each quantity a companion: while the companion moves, a sound channel of the quantity moves, too."""


def channels_with_clocks(
    records: Sequence[Record], quantities: Collection[str]
) -> Iterator[tuple[Key, dict[str, Clocked]]]:
    """Yield every channel of these quantities with the clocks that have it, by record name."""
    clocks = {record.name: record.fast for record in records if record.fast is not None}
    for key in sorted({key for clock in clocks.values() for key in clock.values if key[0] in quantities}):
        yield key, {name: clock for name, clock in clocks.items() if key in clock.values}


def percent_text(masks: Iterable[Mask]) -> str:
    """Return the share of set samples in masks, as text in percent."""
    return f"{100.0 * float(np.mean(np.concatenate(list(masks)))):.0f} %"


def find_wrapped_angle(records: Sequence[Record], _: Model) -> SetUpFault | None:
    """Return the fault of an angle that leaps by a whole range, if there is one."""
    for key, clocks in channels_with_clocks(records, ("angle",)):
        period = max(period_of(clock.values[key][clock.all_valid(key)]) for clock in clocks.values())
        if period > 0.0:
            evidence = f"leaps by {period:.6g} rad from one sample to the next"
            parameters = (EffectParameter("period", period, 0.0, "rad"),)
            mend = partial(with_unwrapped_angle, key=key, period=period)
            return SetUpFault(
                "wrapped_channel", key, FAULT_PROBABILITY, evidence, "unwrap it on import", mend, parameters
            )
    return None


def with_unwrapped_angle(record: Record, key: Key, period: float) -> Record:
    """Return a record whose angle is unwrapped by a period [rad]."""
    if record.fast is None or key not in record.fast.values:
        return record
    return with_values(record, key, np.unwrap(record.fast.values[key], period=period))


def period_of(values: Array) -> float:
    """Return the period by which values leap, in their unit; zero if they do not leap by equal amounts."""
    steps, value_range = np.diff(values), float(np.ptp(values))
    leaps = np.abs(steps[np.abs(steps) > LEAST_LEAP_SHARE * value_range])
    if len(leaps) < 2 or float(np.median(leaps)) < LEAST_LEAP_STEPS * smallest_step(values):
        return 0.0
    period = float(np.median(leaps)) + float(np.median(np.abs(steps)))
    likely_period = 2.0 * np.pi if abs(period / (2.0 * np.pi) - 1.0) < LEAP_TOLERANCE else period
    return likely_period if float(np.ptp(leaps)) < LEAP_TOLERANCE * likely_period else 0.0


def find_frozen_channel(records: Sequence[Record], _: Model) -> SetUpFault | None:
    """Return the fault of a channel that is constant for long while its companion moves, if there is one."""
    mechanical = {record.name: record.mechanical for record in records}
    for key, clocks in channels_with_clocks(records, COMPANIONS):
        if all(may_rest(key, mechanical[name]) for name in clocks):
            continue
        rests = {
            name: frozen_samples(clock, key) for name, clock in clocks.items() if not may_rest(key, mechanical[name])
        }
        frozen = long_rests(rests, {record.name: record.run for record in records})
        if frozen:
            evidence = (
                f"stands still over {percent_text(rests.values())} of its samples while {COMPANIONS[key[0]]} moves"
            )
            change = "look at its wire and its column; these samples are left out"
            mend = partial(without_samples, key=key, masks=frozen)
            return SetUpFault("frozen_channel", key, FAULT_PROBABILITY, evidence, change, mend, shrinks=False)
    return None


def long_rests(rests: Mapping[str, Mask], runs: Mapping[str, str]) -> dict[str, Mask]:
    """Return the rests, by record, of runs that rest for at least `LEAST_FROZEN_SHARE` of all their stretches."""
    rests_by_record: dict[str, Mask] = {}
    for run in {runs[name] for name in rests}:
        rests_of_run = {name: mask for name, mask in rests.items() if runs[name] == run}
        if float(np.mean(np.concatenate(list(rests_of_run.values())))) >= LEAST_FROZEN_SHARE:
            rests_by_record |= {name: mask for name, mask in rests_of_run.items() if mask.any()}
    return rests_by_record


def may_rest(key: Key, mechanical: str) -> bool:
    """Return whether a sound channel may be constant in a mechanical set-up while its companion moves."""
    if mechanical in ("locked", "heated"):
        return key[0] in ("angle", "velocity")
    return mechanical == "free" and key[0] == "torque"


def frozen_samples(clock: Clocked, key: Key) -> Mask:
    """Return the samples over which a channel is constant too long while its companion moves.

    All samples are returned if more than 1 - `LEAST_FROZEN_SHARE` of a record are frozen.
    """
    values, frozen = nan_where_unmeasured(clock, key), np.zeros(len(clock.time), np.bool_)
    companion = clock.get(COMPANIONS[key[0]], key[1])
    begin, end = longest_run(np.diff(values) == 0.0)
    if companion is None or end - begin < max(LONGEST_REST, LEAST_FROZEN_SHARE * len(values)):
        return frozen
    # the motion of a companion: the size of a speed, the change of an angle, the deviation of a current from its mean
    motion = np.abs(companion) if key[0] == "angle" else np.diff(companion, prepend=companion[0])
    if key[0] not in ("angle", "velocity"):
        motion = companion - companion.mean()
    usual_motion, motion_meanwhile = (
        float(np.sqrt(np.mean(samples**2))) for samples in (motion, motion[begin : end + 1])
    )
    if key[0] not in ("angle", "velocity"):
        motion_meanwhile = float(np.std(motion[begin : end + 1]))  # another constant level is no motion
    if (
        usual_motion == 0.0
        or motion_meanwhile < LEAST_COMPANION_MOTION * usual_motion
        or noise_of(companion) > 0.5 * float(np.std(companion))
    ):
        return frozen
    frozen[begin : end + 1] = True
    return np.ones_like(frozen) if frozen.mean() > 1.0 - LEAST_FROZEN_SHARE else frozen


def nan_where_unmeasured(clock: Clocked, key: Key) -> Array:
    """Return the values of a channel, with NaN where it was not measured."""
    return np.where(clock.all_valid(key), clock.values[key], np.nan)


def longest_run(mask: Mask) -> tuple[int, int]:
    """Return the begin and the end (exclusive) of the longest run of set samples; (0, 0) if none is set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))).reshape(-1, 2)
    if len(edges) == 0:
        return 0, 0
    begin, end = edges[int(np.argmax(edges[:, 1] - edges[:, 0]))]
    return int(begin), int(end)


def noisy_quantities(model: Model) -> tuple[str, ...]:
    """Return the quantities that noise always changes; not a voltage that a servo computes or a test commands."""
    return (
        NOISY_QUANTITIES
        if model.drive is None and model.feedforward is None
        else tuple(name for name in NOISY_QUANTITIES if name != "q_axis_voltage")
    )


def find_repeated_samples(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """Return the fault of a measured channel with many repeated samples, if there is one."""
    for key, clocks in channels_with_clocks(records, noisy_quantities(model)):
        shares = [float(repeated_samples(clock, key).mean()) for clock in clocks.values()]
        if float(np.median(shares)) > MOST_REPEATED_SHARE:
            evidence = f"repeats {100.0 * float(np.median(shares)):.0f} % of its samples"
            change = "it is sampled slower than it is logged: log it at its own rate, in a stream of its own"
            mend = partial(with_repeats_interpolated, key=key)
            return SetUpFault("repeated_samples", key, FAULT_PROBABILITY, evidence, change, mend, shrinks=False)
    return None


def with_repeats_interpolated(record: Record, key: Key) -> Record:
    """Return a record whose repeated samples of a channel are interpolated."""
    clock = record.fast
    if clock is None or key not in clock.values:
        return record
    not_repeated = ~repeated_samples(clock, key)
    return with_values(record, key, np.interp(clock.time, clock.time[not_repeated], clock.values[key][not_repeated]))


def repeated_samples(clock: Clocked, key: Key) -> Mask:
    """Return the samples that repeat the one before; none in a channel of few levels, or with a long rest."""
    values = clock.values[key]
    repeated = np.concatenate([[False], np.diff(values) == 0.0])
    begin, end = longest_run(repeated)
    if len(np.unique(values)) < min(FEWEST_FINE_LEVELS, len(values) // 4) or end - begin >= LONGEST_REST:
        return np.zeros(len(values), np.bool_)
    return repeated


def find_clipped_channel(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """Return the fault of a measured channel that stays at an end of its range, if there is one."""
    for key, clocks in channels_with_clocks(records, noisy_quantities(model)):
        clipped = {
            name: mask
            for name, clock in clocks.items()
            if has_own_noise(clock, key) and (mask := samples_at_ends(clock, key)).any()
        }
        if clipped:
            level = max(float(np.max(np.abs(clocks[name].values[key]))) for name in clipped)
            runs = len({record.run for record in records if record.name in clipped})
            evidence = f"stands at {level:.6g} over {percent_text(clipped.values())} of the samples of {runs} runs"
            parameters = (EffectParameter("level", level, 0.0, next(iter(clocks.values())).units.get(key, "")),)
            mend = partial(without_samples, key=key, masks=clipped)
            change = "widen its range; these samples are left out"
            return SetUpFault(
                "clipped_channel", key, FAULT_PROBABILITY, evidence, change, mend, parameters, shrinks=False
            )
    return None


def initial_rest(values: Array) -> slice:
    """Return the samples before a channel's first non-zero value; a one-sided run begins at an end of its range."""
    return slice(0, int(np.argmax(values != 0.0)))


def has_own_noise(clock: Clocked, key: Key) -> bool:
    """Return whether a channel has noise, compared with its reference; a computed setpoint may stay at a limit."""
    reference, values = clock.get(f"{key[0]}_reference", key[1]), clock.values[key]
    changed_values = values[np.diff(values, prepend=np.nan) != 0.0]  # repeated values would hide the noise
    return reference is None or noise_of(changed_values, 0.0) >= LEAST_NOISE_RATIO * noise_of(reference, 0.0)


def samples_at_ends(clock: Clocked, key: Key) -> Mask:
    """Return the samples at which a channel of many levels stays at its largest or smallest value."""
    values = nan_where_unmeasured(clock, key)
    at_limit = np.zeros(len(values), np.bool_)
    if len(np.unique(values[np.isfinite(values)])) < min(FEWEST_FINE_LEVELS, len(values) // 4):
        return at_limit
    repeats = np.concatenate([[False], np.diff(values) == 0.0])
    at_top, at_bottom = values == np.nanmax(values), values == np.nanmin(values)
    if float(np.mean(repeats[~(at_top | at_bottom)])) >= LEAST_CLIPPED_SHARE:
        return at_limit  # the channel repeats samples elsewhere as well
    for at_end in (at_top, at_bottom):
        at_end[initial_rest(values)] = False
        begin, end = longest_run(at_end)
        if end - begin >= FEWEST_CLIPPED_IN_ROW and float(at_end.mean()) >= LEAST_CLIPPED_SHARE:
            at_limit |= at_end
    return at_limit
