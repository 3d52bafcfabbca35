"""Compute ties of two clocks from events at which one channel jumps and another channel begins to change.

Example: a current is switched on and a winding begins to warm. The two channels measure different quantities, so that
they do not correlate, but both show the moment of the switch.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from leactl.errors import InputError
from leactl.runfile.align.alignment import Array, Tie, autocorrelated_variance

FEWEST_SAMPLES_AROUND = 8  # on either side of an onset
ONSET_SIGNIFICANCE = 5.0  # least change of slope at an onset, in standard deviations of that change
LARGEST_DISAGREEMENT = 10.0  # standard deviations; ties that differ by more belong to different events
LARGEST_CLOCK_RATE = 1e-3  # bound of the drift, as a share of the time between two ties; that of real clocks is smaller


def jumps(time: Array, values: Array, smallest_jump: float) -> list[Tie]:
    """Return the moments at which a channel jumps by at least `smallest_jump`, as ties with two equal times."""
    finite = np.isfinite(values)
    time, values = time[finite], values[finite]
    jump_indices = np.flatnonzero(np.abs(np.diff(values)) >= smallest_jump)
    # a jump that takes two samples is one jump
    first_indices = jump_indices[np.diff(jump_indices, prepend=-10) > 1]
    return [
        Tie(
            0.5 * (time[index] + time[index + 1]),
            0.5 * (time[index] + time[index + 1]),
            (time[index + 1] - time[index]) / math.sqrt(12.0),
        )
        for index in first_indices
    ]


def fit_onset(
    time: Array, values: Array, near: float, within: float, fit_s: float, rising: float
) -> tuple[float, float] | None:
    """Find the time at which a channel leaves a straight line, and its standard deviation [s]; None if there is none.

    The model is a line before the onset and, after it, the line plus a cubic that starts from zero, as for the
    temperature of a body into which a constant heat begins or ceases to flow. It is fitted by least squares on a grid
    of onsets, and the best onset is refined by Gauss-Newton steps.

    Parameters
    ----------
    near, within : the onset is searched from near - within to near + within on the channel's clock [s].
    fit_s : length of the fitted part before and after the onset [s].
    rising : positive to seek the strongest upward bend, negative for the strongest downward one.
    """
    finite = np.isfinite(values) & (time > near - within - fit_s) & (time < near + within + fit_s)
    time, values = time[finite], values[finite]
    if len(time) < 2 * FEWEST_SAMPLES_AROUND + 4:
        return None
    interval = float(np.median(np.diff(time)))
    strongest: tuple[float, float] | None = None
    for onset in np.arange(near - within, near + within, max(interval, within / 400.0)):
        fit = hinge(time, values, float(onset), fit_s)
        strength = math.copysign(1.0, rising) * fit[1] if fit is not None else 0.0
        if strength >= ONSET_SIGNIFICANCE and (strongest is None or strength > strongest[0]):
            strongest = strength, float(onset)
    if strongest is None:
        return None
    onset = strongest[1]
    for _ in range(20):
        fit = hinge(time, values, onset, fit_s)
        if fit is None:
            return None
        _slope, _significance, step, onset_sd = fit
        onset = onset + step
        if abs(step) < 1e-3 * interval:
            break
    return (onset, onset_sd) if abs(onset - near) <= within + fit_s else None


def hinge(time: Array, values: Array, onset_time: float, fit_s: float) -> tuple[float, float, float, float] | None:
    """Fit a line, and after the time `onset_time` [s] a cubic that starts from the line.

    Returns
    -------
    Change of slope at the onset, its ratio to its standard deviation, correction of `onset_time` [s], and standard
    deviation of the correction [s]; None if there are too few samples.
    """
    is_inside = (time >= onset_time - fit_s) & (time <= onset_time + fit_s)
    time_from_onset, channel_values = time[is_inside] - onset_time, values[is_inside]
    time_after_onset = np.maximum(time_from_onset, 0.0)
    if (time_from_onset < 0).sum() < FEWEST_SAMPLES_AROUND or (time_from_onset > 0).sum() < FEWEST_SAMPLES_AROUND:
        return None
    design = np.stack(
        [np.ones_like(time_from_onset), time_from_onset, time_after_onset, time_after_onset**2, time_after_onset**3],
        axis=1,
    )
    coefficients, _, rank, _ = np.linalg.lstsq(design, channel_values, rcond=None)
    if rank < design.shape[1]:
        return None
    residual = channel_values - design @ coefficients
    # derivative of the model by the time of the onset
    onset_column = np.where(
        time_from_onset > 0.0,
        -(
            coefficients[2]
            + 2.0 * coefficients[3] * time_from_onset
            + 3.0 * coefficients[4] * time_from_onset * time_from_onset
        ),
        0.0,
    )
    full_design = np.column_stack([design, onset_column])
    try:
        full_inverse = np.linalg.inv(full_design.T @ full_design)
        design_inverse = np.linalg.inv(design.T @ design)
    except np.linalg.LinAlgError:
        return None
    correction = full_inverse @ full_design.T @ residual
    variance = autocorrelated_variance(residual - full_design @ correction, least_share=1.0) / (
        len(time_from_onset) - full_design.shape[1]
    )
    slope, step = float(coefficients[2]), float(correction[5])
    significance = slope / math.sqrt(max(variance * design_inverse[2, 2], 1e-300))
    return (
        slope,
        significance,
        max(-0.5 * fit_s, min(0.5 * fit_s, step)),
        math.sqrt(max(variance * full_inverse[5, 5], 1e-18)),
    )


def ties_by_onset(
    time: Array,
    values: Array,
    reference_time: Array,
    reference: Array,
    smallest_jump: float,
    near: float,
    within: float,
    fit_s: float,
) -> list[Tie]:
    """Compute ties of a channel that begins to change when the reference jumps.

    Since it is not known whether a jump raises or lowers the channel, both senses are tried. A sense counts if the
    times between its onsets equal those between the jumps. If both senses count, the ties of the sense with more ties
    are returned, or with smaller standard deviations if the numbers are equal.

    Parameters
    ----------
    time, values : stamps on the device's clock [s] and values of the channel.
    reference_time, reference : stamps on the run's clock [s] and values of the reference.
    smallest_jump : smallest change of the reference that counts as a jump, in its unit.
    near, within : offsets of the clocks from near - within to near + within are searched [s].
    fit_s : length of the fitted part before and after an onset [s].

    Raises
    ------
    InputError : the times between the onsets differ from those between the jumps.
    """
    ties_by_sense = [
        _onset_at_each_jump(time, values, reference_time, reference, smallest_jump, near, within, fit_s, sense)
        for sense in (1.0, -1.0)
    ]
    consistent_ties = [ties for ties in ties_by_sense if ties and _largest_disagreement(ties) <= LARGEST_DISAGREEMENT]
    ties = min(consistent_ties or ties_by_sense, key=lambda ties: (-len(ties), sum(tie.sd for tie in ties)))
    if ties and not consistent_ties:
        offsets = ", ".join(f"{tie.run_time - tie.device_time:.1f}" for tie in ties)
        raise InputError(
            f"onsets do not lie as far apart as the jumps do: offsets of {offsets} s; near_s and a lower within_s tell"
            " which belong together"
        )
    return ties


def _onset_at_each_jump(
    time: Array,
    values: Array,
    reference_time: Array,
    reference: Array,
    smallest_jump: float,
    near: float,
    within: float,
    fit_s: float,
    sense: float,
) -> list[Tie]:
    """Fit the strongest onset near each jump; `sense` is 1 if the channel rises when the reference grows, else -1."""
    ties = []
    finite = np.isfinite(reference)
    magnitudes, stamps = np.abs(reference[finite]), reference_time[finite]
    for jump in jumps(reference_time, reference, smallest_jump):
        index_after_jump = int(np.searchsorted(stamps, jump.run_time))
        growth = float(magnitudes[index_after_jump] - magnitudes[index_after_jump - 1])
        fitted_onset = fit_onset(time, values, jump.run_time - near, within, fit_s, sense * growth)
        if fitted_onset is not None:
            onset_time, onset_sd = fitted_onset
            ties.append(Tie(onset_time, jump.run_time, math.hypot(jump.sd, onset_sd)))
    return ties


def _largest_disagreement(ties: Sequence[Tie]) -> float:
    """Return the largest difference of the offsets of two ties, over their standard deviation plus largest drift."""
    ratios = (
        abs((first.run_time - first.device_time) - (second.run_time - second.device_time))
        / (math.hypot(first.sd, second.sd) + LARGEST_CLOCK_RATE * abs(first.run_time - second.run_time))
        for first, second in itertools.combinations(ties, 2)
    )
    return max(ratios, default=0.0)
