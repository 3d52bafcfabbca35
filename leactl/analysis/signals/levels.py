"""Held levels of runs: the mean of each channel over the settled part of each hold, with its standard error.

Channels live in streams with clocks of their own; each is averaged on its own stamps. Every hold gives one point:
a level that is repeated gives a point for each repeat.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import Noted, tally
from leactl.errors import InputError, NotIdentifiable
from leactl.runfile.read.reader import Channel, Run

Array = npt.NDArray[np.float64]

DIRECTIONS = {"rising": 1, "falling": -1}
FEWEST_SAMPLES = 3
LEAST_COVERED_SHARE = 0.5  # of a settled part, that its samples must span
MOST_MISSING_SHARE = 0.01  # of the samples; a note names a larger share
# smallest spread of the means over their standard error; below it, errors of the regressor bias the slope
LEAST_SPREAD_RATIO = 10.0
# lags summed, as a multiple of tau, which is twice Sokal's integrated autocorrelation time (1997, section 3)
SOKAL_WINDOW = 5.0


@dataclass(frozen=True)
class Hold:
    """A hold of a setpoint, limited to its settled part."""

    setpoint: float
    direction: int  # 1 reached by rising, -1 by falling, 0 if not stated
    start: float  # s, of the settled part
    stop: float  # s
    unit: str = "A"

    def __str__(self) -> str:
        return f"{self.setpoint:g} {self.unit} at {self.start:.1f} s"


@dataclass(frozen=True)
class SettledMean:
    """Mean of a channel over the settled part of a hold."""

    value: float
    std: float  # standard error of the mean, with autocorrelation
    samples: int
    missing: int
    quarters: tuple[float, ...]  # means of the four quarters, to judge whether the channel is steady


@dataclass(frozen=True, eq=False)
class HoldMeans:
    """Settled means of every hold of some runs; element k of each array, shape (holds,), belongs to hold k."""

    run_index: npt.NDArray[np.int64]
    setpoint: Array
    direction: npt.NDArray[np.int64]
    means: Mapping[str, Array]  # by quantity
    standard_errors: Mapping[str, Array]  # of the means
    quarter_means: Mapping[str, Array]  # means of the four quarters, shape (holds, 4)
    holds: tuple[Hold, ...]
    units: Mapping[str, str]

    def __len__(self) -> int:
        return len(self.run_index)

    def where(self, mask: npt.NDArray[np.bool_]) -> "HoldMeans":
        """Return the holds for which `mask`, of shape (holds,), is true."""
        return replace(
            self,
            run_index=self.run_index[mask],
            setpoint=self.setpoint[mask],
            direction=self.direction[mask],
            means={name: column[mask] for name, column in self.means.items()},
            standard_errors={name: column[mask] for name, column in self.standard_errors.items()},
            quarter_means={name: column[mask] for name, column in self.quarter_means.items()},
            holds=tuple(hold for hold, selected in zip(self.holds, mask, strict=True) if selected),
        )


@dataclass(frozen=True)
class HoldSelector:
    """Selects the holds of an experiment by the key of their setpoint and the role of the actuator."""

    key: str  # of the setpoint in a step's parameters, such as current_A
    unit: str
    role: str = "test"
    unstated_role: str = ""  # role of a hold that states none; empty: `role`

    def holds_of(self, run: Run) -> list[Hold]:
        """Return the holds of a run that state this setpoint for this role, in order."""
        holds = []
        for step in run.steps:
            setpoint = step.parameters.get(self.key)
            numeric = isinstance(setpoint, int | float) and not isinstance(setpoint, bool) and math.isfinite(setpoint)
            role = step.parameters.get("role", self.unstated_role or self.role)
            if step.name == "hold" and numeric and role == self.role:
                direction = DIRECTIONS.get(str(step.parameters.get("direction", "")), 0)
                settled = step.start + step.settle
                # mypy does not see that `numeric` implies a number
                holds.append(Hold(float(setpoint), direction, settled, step.stop, self.unit))  # type: ignore[arg-type]
        return holds


CURRENT_HOLDS = HoldSelector("current_A", "A")


def current_holds(run: Run) -> list[Hold]:
    """Return the holds of the test actuator's current, in order."""
    return CURRENT_HOLDS.holds_of(run)


def gather_means(
    runs: Sequence[Run],
    quantities: Sequence[str],
    read: Callable[[Run, str], Noted[Channel]],
    hold_selector: HoldSelector = CURRENT_HOLDS,
) -> Noted[HoldMeans]:
    """Average channels of the test actuator over the settled part of every hold; notes name the holds left out.

    Parameters
    ----------
    quantities : names; each has an entry in `means`, `standard_errors` and `quarter_means` of the answer.
    read : returns the channel of a quantity, NaN for readings that must not count.
    hold_selector : which holds are averaged.

    Raises
    ------
    MissingChannel : a run lacks one of the quantities.
    NotIdentifiable : a run has no hold with data.
    InputError : the runs measure one quantity in different units.
    """
    rows: list[tuple[int, Hold, list[SettledMean]]] = []
    notes: list[str] = []
    units: dict[str, str] = {}
    for run_index, run in enumerate(runs):
        for quantity in quantities:
            if not run.has(quantity):  # a missing channel is reported before any fault of the others
                run.channel(quantity)
        readings = [read(run, quantity) for quantity in quantities]
        channels = [reading.value for reading in readings]
        for channel in channels:
            if units.setdefault(channel.quantity, channel.units) != channel.units:
                earlier = units[channel.quantity]
                raise InputError(f"{run.path}: {channel.quantity} in {channel.units}, in {earlier} in the runs before")
        run_rows = _rows_of(run, run_index, channels, hold_selector)
        rows += run_rows.value
        notes += [*(note for reading in readings for note in reading.notes), *run_rows.notes]
    columns = {quantity: [row_means[index] for _, _, row_means in rows] for index, quantity in enumerate(quantities)}
    hold_means = HoldMeans(
        run_index=np.array([run_index for run_index, _, _ in rows]),
        setpoint=np.array([hold.setpoint for _, hold, _ in rows]),
        direction=np.array([hold.direction for _, hold, _ in rows]),
        means={name: np.array([mean.value for mean in means]) for name, means in columns.items()},
        standard_errors={name: np.array([mean.std for mean in means]) for name, means in columns.items()},
        quarter_means={name: np.array([mean.quarters for mean in means]) for name, means in columns.items()},
        holds=tuple(hold for _, hold, _ in rows),
        units=units,
    )
    return Noted(hold_means, tuple(notes))


def _rows_of(
    run: Run, run_index: int, channels: Sequence[Channel], hold_selector: HoldSelector
) -> Noted[list[tuple[int, Hold, list[SettledMean]]]]:
    """Return a row for each hold with enough data: the index of the run, the hold, and the mean of each channel."""
    holds = hold_selector.holds_of(run)
    holds_by_reason: dict[str, list[str]] = {}
    rows = []
    for hold in holds:
        means = [settled_mean(channel, hold.start, hold.stop) for channel in channels]
        lacking = [channel.quantity for channel, mean in zip(channels, means, strict=True) if mean is None]
        if lacking:
            holds_by_reason.setdefault(f"too little {' and '.join(lacking)} in the settled part", []).append(str(hold))
        else:
            rows.append((run_index, hold, [mean for mean in means if mean is not None]))
    notes = tally(holds_by_reason, f"{run.path}")
    if not rows:
        finding = f"{len(holds)} holds, none with data" if holds else f"no step named 'hold' with {hold_selector.key}"
        raise NotIdentifiable(f"{run.path}: found {finding}; two held levels or more are needed")
    for index, channel in enumerate(channels):
        missing = sum(means[index].missing for _, _, means in rows)
        share = missing / (missing + sum(means[index].samples for _, _, means in rows))
        if share > MOST_MISSING_SHARE:
            notes.append(
                f"{run.path}: {share:.1%} of the samples of {channel.quantity} in the settled parts are missing"
            )
    return Noted(rows, tuple(notes))


def settled_mean(channel: Channel, start: float, stop: float) -> SettledMean | None:
    """Average the samples from start to before stop [s].

    Return None with fewer than `FEWEST_SAMPLES` samples, or if they span less than `LEAST_COVERED_SHARE` of the time.
    """
    in_interval = samples_between(channel, start, stop)
    values, time = channel.values[in_interval], channel.time[in_interval]
    finite = np.isfinite(values)
    count = int(finite.sum())
    if count < FEWEST_SAMPLES or np.ptp(time[finite]) < LEAST_COVERED_SHARE * (stop - start):
        return None
    quarter = np.minimum(((time[finite] - start) / (stop - start) * 4).astype(np.int64), 3)
    counts = np.bincount(quarter, minlength=4)
    with np.errstate(invalid="ignore"):
        quarters = np.bincount(quarter, values[finite], minlength=4) / counts
    value = float(values[finite].mean())
    return SettledMean(value, standard_error(values), count, len(values) - count, tuple(quarters.tolist()))


def samples_between(channel: Channel, start: float, stop: float) -> slice:
    """Return the slice of the samples taken from start to before stop [s].

    A sample that is itself a mean over the interval before its stamp counts if the whole interval is inside.
    """
    begin, end = (int(index) for index in np.searchsorted(channel.time, (start, stop), side="left"))
    if channel.sampling == "mean":
        begin, end = begin + 1, int(np.searchsorted(channel.time, stop, side="right"))
    return slice(begin, max(begin, end))


def standard_error(values: Array) -> float:
    """Return the standard error of the mean of an evenly sampled, autocorrelated record; NaN samples are gaps.

    It is sqrt(variance * tau / n), where tau is one plus twice the sum of the autocorrelation up to `SOKAL_WINDOW` tau
    (Sokal, Monte Carlo Methods in Statistical Mechanics, 1997, section 3), and at least one.
    """
    finite = np.isfinite(values)
    count = int(finite.sum())
    if count < 2:
        return math.nan
    deviation = np.where(finite, values - values[finite].mean(), 0.0)
    square_sum = float(deviation @ deviation)
    # constant but for rounding, 1e-15 of the largest value
    if square_sum <= 1e-30 * count * float(np.max(np.abs(values[finite]))) ** 2:
        return 0.0
    size = 1 << (2 * len(values) - 1).bit_length()
    spectrum = np.fft.rfft(deviation, size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2, size)[: len(values)] / square_sum
    tau = 2.0 * np.cumsum(correlation) - 1.0
    long_enough = np.flatnonzero(np.arange(len(tau)) >= SOKAL_WINDOW * tau)
    # without a window that is long enough, tau is at least about this
    correlation_samples = float(tau[long_enough[0]]) if len(long_enough) else len(values) / SOKAL_WINDOW
    return math.sqrt(square_sum / (count - 1) * max(correlation_samples, 1.0) / count)


def require_levels(error_prefix: str, regressor: str, quantity: str, hold_means: HoldMeans) -> None:
    """Raise if the means of a regressor over one hold or more do not determine a slope.

    Parameters
    ----------
    error_prefix : text before a message, such as the path of the run.
    regressor : name of the regressor in messages.
    quantity : key of its means and their standard errors in `hold_means`.

    Raises
    ------
    NotIdentifiable : fewer than two distinct setpoints, or means whose spread is at most `LEAST_SPREAD_RATIO` times
        their error.
    """
    means, errors = hold_means.means[quantity], hold_means.standard_errors[quantity]
    distinct = np.unique(np.round(hold_means.setpoint, 9))
    if len(distinct) < 2:
        raise NotIdentifiable(
            f"{error_prefix}: found one level ({distinct[0]:g} {hold_means.holds[0].unit} in {len(hold_means)} holds); "
            "two distinct levels or more are needed"
        )
    spread, error = float(np.std(means)), math.sqrt(float(np.mean(errors**2)))
    if spread <= LEAST_SPREAD_RATIO * error:
        raise NotIdentifiable(
            f"{error_prefix}: the {regressor} of {len(means)} holds is spread by {spread:.2g}, its means are known to"
            f" {error:.2g}; a spread above {LEAST_SPREAD_RATIO * error:.2g} is needed"
        )
