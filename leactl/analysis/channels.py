"""Channels of a protocol of one's own: mean, deviation and drift of each hold, gain and phase of each excitation.

It needs no model and no other experiment. Intervals take the autocorrelation of the record into account (levels.py);
gain and phase are those of Blackman and Tukey (blackman_tukey.py), known where the coherence is enough.
"""

import math
from collections.abc import Sequence

import numpy as np

from leactl.analysis.channel_response import EXCITATIONS, gain_and_phase
from leactl.analysis.estimate import NAN, Estimate, Grid, Plot, Result, Series, tally
from leactl.analysis.levels import FEWEST_SAMPLES, settled_mean, span, standard_error
from leactl.analysis.regression import CONFIDENCE, Array, t_quantile
from leactl.errors import InputError, MissingChannel
from leactl.runfile.reader import Channel, Run, Step

RESULTS: dict[str, str] = {}  # named by the steps and channels of a run

BINS = 40  # of a histogram
MOST_PLOTTED = 3  # channels that are plotted where none is chosen


def analyze(runs: Sequence[Run], *, channel: Sequence[str] | None = None) -> Result:
    """Mean, deviation and drift of each channel over the settled part of each hold, and the response to excitations.

    `hold_1_torque` is the mean over the first hold, `hold_1_torque_deviation` the deviation of single readings,
    `hold_1_torque_drift` the slope over time; `chirp_1_velocity_gain_at_10_Hz` and `..._phase_at_10_Hz` [rad] are from
    the setpoint that moves to the channel. A run without steps counts as one hold, `whole`. Repeats are averaged.

    Parameters
    ----------
    runs : of one actuator under one condition, with the same steps.
    channel : what to look at, such as `torque` or `load_velocity`; every measured channel by default.

    Raises
    ------
    MissingChannel : a run has no such channel.
    InputError : runs whose steps differ.
    """
    notes: list[str] = []
    every = []
    plots: list[Plot] = []
    grids: list[Grid] = []
    for run in runs:
        measured = chosen(run, channel)
        holds = held(run)
        found = [item for label, step in holds for item in over_hold(run, label, step, measured, notes)]
        for label, step in excited(run):
            estimates, more_plots, more_grids = gain_and_phase(run, label, step, measured, notes)
            found, plots, grids = found + estimates, plots + more_plots, grids + more_grids
        every.append(found)
        if channel or len(measured) <= MOST_PLOTTED:
            plots += [plot for name, one in measured.items() for plot in pictures(name, one, holds)]
        elif run is runs[0]:
            notes.append("plots and histograms are those of chosen channels: --channel NAME")
        grids += [histogram(name, one) for name, one in measured.items() if np.isfinite(one.values).any()]
    paths = tuple(str(run.path) for run in runs)
    return Result("channels", paths, tuple(averaged(every, paths)), tuple(notes), tuple(plots), (), tuple(grids))


def chosen(run: Run, wanted: Sequence[str] | None) -> dict[str, Channel]:
    """Measured channels by name: quantity, after a role other than test and before a location."""
    known = {}
    for stream, specs in run.streams.items():
        for spec in specs:
            role = "" if spec.role == "test" else f"{spec.role}_"
            location = f"_{spec.location}" if spec.location else ""
            known[f"{role}{spec.quantity or spec.name}{location}".replace(" ", "_")] = f"{stream}/{spec.name}"
    lacking = [name for name in wanted or () if name not in known and name not in known.values()]
    if lacking:
        raise MissingChannel(f"{run.path}: no channel {', '.join(lacking)}; the run has {', '.join(known)}")
    if wanted:
        kept = {name: place for name, place in known.items() if name in wanted or place in wanted}
    else:
        kept = {name: place for name, place in known.items() if not name.endswith("_reference")}
    return {name: run.channel_at(place) for name, place in kept.items()}


def held(run: Run) -> list[tuple[str, Step]]:
    """Holds of a run with their labels; the whole of a run that has no steps."""
    steps = run.steps
    if not steps:
        times = [time for stream in run.streams if len(time := run.time(stream))]
        if not times:
            return []
        stop = float(np.nextafter(max(time[-1] for time in times), math.inf))
        return [("whole", Step("whole", float(min(time[0] for time in times)), stop, 0.0, {}))]
    return [(f"hold_{number}", step) for number, step in enumerate((s for s in steps if s.name == "hold"), start=1)]


def excited(run: Run) -> list[tuple[str, Step]]:
    """Steps of a run that excite it with many frequencies, with their labels."""
    counts = dict.fromkeys(EXCITATIONS, 0)
    found = []
    for step in run.steps:
        if step.name in counts:
            counts[step.name] += 1
            found.append((f"{step.name}_{counts[step.name]}", step))
    return found


def over_hold(run: Run, label: str, step: Step, measured: dict[str, Channel], notes: list[str]) -> list[Estimate]:
    """Mean, deviation and drift of each channel over one hold; what has too few samples goes into the notes."""
    found: list[Estimate] = []
    too_few = []
    start = step.start + step.settle
    for name, one in measured.items():
        mean = settled_mean(one, start, step.stop)
        if mean is None:
            too_few.append(name)
            continue
        part = span(one, start, step.stop)
        found += statistics(f"{label}_{name}", one.time[part], one.values[part], one.units)
    if too_few:
        notes += tally({f"fewer than {FEWEST_SAMPLES} samples over its settled part": too_few}, f"{run.path}: {label}")
    return found


def statistics(name: str, time: Array, values: Array, units: str) -> list[Estimate]:
    """Mean, deviation of single readings and drift of an evenly sampled record, with 95 % intervals."""
    from scipy.stats import chi2

    good = np.isfinite(values)
    deviation, error = float(np.std(values[good], ddof=1)), standard_error(values)
    dof = independent(deviation, error, int(good.sum())) - 1.0
    mean = with_interval(name, float(values[good].mean()), error, dof, units)
    low, high = (deviation * math.sqrt(dof / chi2.ppf(0.5 + side * CONFIDENCE / 2, dof)) for side in (1, -1))
    scatter = Estimate(f"{name}_deviation", deviation, deviation / math.sqrt(2.0 * dof), low, high, units)

    since = time - time[good].mean()
    length = float(np.sum(since[good] ** 2))
    slope = float(np.sum(since[good] * values[good])) / length
    rest = values - values[good].mean() - slope * since
    rest_deviation, rest_error = float(np.std(rest[good], ddof=1)), standard_error(rest)
    effective = independent(rest_deviation, rest_error, int(good.sum()))
    error = rest_deviation * math.sqrt(good.sum() / effective / length)
    drift = with_interval(f"{name}_drift", slope, error, effective - 2.0, f"{units}/s")
    return [mean, scatter, drift]


def independent(deviation: float, error: float, samples: int) -> float:
    """How many independent readings know a mean as well: at least the five that the autocorrelation is summed by."""
    return (deviation / error) ** 2 if error > 0.0 else float(samples)


def with_interval(name: str, value: float, std: float, dof: float, units: str) -> Estimate:
    """An estimate with the interval of Student's t."""
    half = std * t_quantile(dof)
    return Estimate(name, value, std, value - half, value + half, units)


def averaged(every: Sequence[Sequence[Estimate]], paths: Sequence[str]) -> list[Estimate]:
    """Each result over all runs: the mean, with the scatter between runs where there is more than one.

    Raises
    ------
    InputError : a run has other results than the first.
    """
    if len(every) == 1:
        return list(every[0])
    named = [{item.name: item for item in found} for found in every]
    for path, other in zip(paths[1:], named[1:], strict=True):
        if differing := sorted(other.keys() ^ named[0].keys()):
            raise InputError(f"{path}: other steps or channels than {paths[0]} ({differing[0]}); analyse them apart")
    means = []
    for name, item in named[0].items():
        values = np.array([other[name].value for other in named])
        error = float(np.std(values, ddof=1)) / math.sqrt(len(values))
        means.append(with_interval(name, float(values.mean()), error, len(values) - 1.0, item.units))
    return means


def counted(channel: Channel) -> tuple[Array, Array]:
    """Middles of the bins of a histogram, and how many readings fall into each."""
    counts, edges = np.histogram(channel.values[np.isfinite(channel.values)], bins=BINS)
    return 0.5 * (edges[1:] + edges[:-1]), counts.astype(np.float64)


def histogram(name: str, channel: Channel) -> Grid:
    """How often a channel read what, over the whole run."""
    middles, counts = counted(channel)
    axes = {"run": (1.0,), f"{name} [{channel.units}]": tuple(middles.tolist())}
    return Grid(f"{name}_histogram", axes, {"readings [1]": (tuple(counts.tolist()),)})


def pictures(name: str, channel: Channel, holds: Sequence[tuple[str, Step]]) -> list[Plot]:
    """The means of the holds over time, and the histogram."""
    means = [(step.start, settled_mean(channel, step.start + step.settle, step.stop)) for _, step in holds]
    points = [(start, mean.value if mean is not None else NAN) for start, mean in means]
    found = []
    if len(points) > 1:
        x, y = zip(*points, strict=True)
        found.append(Plot("time [s]", f"{name} [{channel.units}]", (Series("mean of a hold", x, y),), ()))
    if np.isfinite(channel.values).any():
        middles, counts = counted(channel)
        series = Series("readings", tuple(middles.tolist()), tuple(counts.tolist()))
        found.append(Plot(f"{name} [{channel.units}]", "readings [1]", (series,), ()))
    return found
