"""Channels of a protocol of one's own: mean, deviation and drift of each hold, gain and phase of each excitation.

It needs no model and no other experiment. Intervals take the autocorrelation of the record into account (levels.py);
gain and phase follow from the method of Blackman and Tukey (blackman_tukey.py), at frequencies with enough coherence.
"""

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Grid, Noted, Plot, Result, Series, listed, tally
from leactl.analysis.quality.channel_plausibility import CONSTANT_AT_REST
from leactl.analysis.responses.channel_response import EXCITATIONS, gain_and_phase
from leactl.analysis.signals.levels import FEWEST_SAMPLES, samples_between, settled_mean, standard_error
from leactl.analysis.statistics.regression import CONFIDENCE, Array, t_quantile
from leactl.errors import InputError, MissingChannel
from leactl.runfile.read.reader import Channel, Run, Step

RESULTS: dict[str, str] = {}  # none is fixed: the steps and channels of a run give the names

HISTOGRAM_BINS = 40
NOISY_QUANTITIES = ("torque", "q_axis_current", "velocity")  # their readings differ by noise even if nothing moves
MOST_PLOTTED = 3  # channels; of a run with more, only chosen ones are plotted
SETPOINT_KEYS = ("current_A", "velocity_rad_s", "angle_rad")  # parameters of a hold that moves to a setpoint
KEPT_SETPOINT_KEYS = ({"repeat"}, {"repeat", "until"})  # the only parameters of a hold that keeps the last setpoint


def analyze(runs: Sequence[Run], *, channel: Sequence[str] | None = None) -> Result:
    """Estimate mean, deviation and drift of each channel over each hold, and its response to each excitation.

    `hold_1_torque` is the mean over the first hold, `hold_1_torque_deviation` the deviation of single readings,
    `hold_1_torque_drift` the slope over time, `steady_1_torque` the mean over the first hold with the name `steady`.
    `chirp_1_velocity_gain_at_10_Hz` and `..._phase_at_10_Hz` [rad] are from the setpoint that moves to the channel. A
    run without steps counts as one hold, `whole`. Runs of one protocol with the same parameters are repeats and are
    averaged. If there are several protocols or parameter sets, those that differ open the names.

    Parameters
    ----------
    runs : of one actuator under one condition.
    channel : names of channels, such as `torque` or `load_velocity`; every measured channel by default.

    Raises
    ------
    MissingChannel : a run has no such channel.
    InputError : complete repeats whose steps differ.
    """
    notes: list[str] = []
    results: list[Estimate] = []
    plots: list[Plot] = []
    grids: list[Grid] = []
    for label, members in by_protocol(runs).items():
        answers = [result_of_run(run, channel) for run in members]
        comparable_runs = comparable_indices(members, answers)
        averaged_indices = comparable_runs.value
        notes += [*(note for answer in answers for note in answer.notes), *comparable_runs.notes]
        mean_estimates = mean_results(
            [answers[index].results for index in averaged_indices],
            [str(members[index].path) for index in averaged_indices],
        )
        results += [replace(estimate, name=f"{label}{estimate.name}") for estimate in mean_estimates]
        plots += [plot for index in averaged_indices for plot in answers[index].plots]
        grids += [grid for index in averaged_indices for grid in answers[index].grids]
    if not channel and any(len(chosen_channels(run, channel)) > MOST_PLOTTED for run in runs):
        notes.append("plots and histograms are those of chosen channels: --channel NAME")
    paths = tuple(str(run.path) for run in runs)
    return Result("channels", paths, tuple(results), tuple(notes), tuple(plots), (), tuple(grids))


def by_protocol(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """Group runs of the same protocol and parameters; each key opens the names of its group's results.

    The key is empty if all runs are alike. Else it has the protocol, if there are several, and each parameter whose
    value is not the same in all runs of that protocol.
    """
    protocol_and_parameters = [(str(run.attributes.get("protocol", "")), run.parameters) for run in runs]
    protocols = {protocol for protocol, _ in protocol_and_parameters}
    groups: dict[str, list[Run]] = {}
    for run, (protocol, run_parameters) in zip(runs, protocol_and_parameters, strict=True):
        parameter_sets = [other_parameters for name, other_parameters in protocol_and_parameters if name == protocol]
        differing = [
            name
            for name in run_parameters
            if any(other_parameters.get(name) != run_parameters[name] for other_parameters in parameter_sets)
        ]
        parameter_text = ", ".join(f"{name}={json.dumps(run_parameters[name])}" for name in differing)
        label = " ".join(filter(None, (protocol if len(protocols) > 1 else "", parameter_text)))
        groups.setdefault(f"{label}: " if label else "", []).append(run)
    return groups


def result_of_run(run: Run, channel: Sequence[str] | None) -> Result:
    """Return the result of one run by itself; its notes name the holds and channels that are left out."""
    notes: list[str] = []
    measured = chosen_channels(run, channel)
    holds = labelled_holds(run)
    # labels of holds, by the names of the channels that have too few samples in them
    too_few: dict[tuple[str, ...], list[str]] = {}
    results = [estimate for label, step in holds for estimate in hold_estimates(label, step, measured, too_few)]
    for names, labels in too_few.items():
        reason = f"fewer than {FEWEST_SAMPLES} samples over its settled part"
        notes += tally({reason: list(names)}, f"{run.path}: {listed(labels)}")
    notes += [note for name, values in measured.items() for note in stuck_notes(run, name, values)]
    plots: list[Plot] = []
    grids: list[Grid] = []
    for label, step in labelled_excitations(run):
        response = gain_and_phase(run, label, step, measured)
        results += response.value.estimates
        plots += response.value.plots
        grids += response.value.grids
        notes += response.notes
    if channel or len(measured) <= MOST_PLOTTED:
        plots += [plot for name, values in measured.items() for plot in channel_plots(name, values, holds)]
    grids += [histogram(name, values) for name, values in measured.items() if np.isfinite(values.values).any()]
    return Result("channels", (str(run.path),), tuple(results), tuple(notes), tuple(plots), (), tuple(grids))


def stuck_notes(run: Run, name: str, channel: Channel) -> Iterator[str]:
    """Yield a note on a noisy sensor that gives the same reading throughout the run.

    A constant 0 of a quantity that is zero at rest is no fault: the drive is off, or the shaft stands.
    """
    readings = channel.values[np.isfinite(channel.values)]
    if channel.quantity not in NOISY_QUANTITIES or len(readings) < FEWEST_SAMPLES or np.any(readings != readings[0]):
        return
    if readings[0] or channel.quantity not in CONSTANT_AT_REST:
        yield f"{run.path}: {name} reads exactly {readings[0]:.6g} {channel.units} throughout: is its sensor connected?"


def comparable_indices(runs: Sequence[Run], answers: Sequence[Result]) -> Noted[list[int]]:
    """Return the indices of the runs to average; notes name the others.

    A run that ended early is left out if its results differ from those of the first complete run, or, where all ended
    early, of the run with the most results.
    """
    names = [{estimate.name for estimate in answer.results} for answer in answers]
    complete = [run.status in ("complete", "") for run in runs]
    reference_index = max(range(len(runs)), key=lambda index: (complete[index], len(names[index]), -index))
    usable = [index for index in range(len(runs)) if complete[index] or names[index] == names[reference_index]]
    reason = f"left out: it ended early and has other steps or channels than {runs[reference_index].path}"
    return Noted(usable, tuple(f"{run.path}: {reason}" for index, run in enumerate(runs) if index not in usable))


def chosen_channels(run: Run, names: Sequence[str] | None) -> dict[str, Channel]:
    """Return the channels of these names or paths, by name; without names, all channels but references.

    A name is made of the role, unless it is `test`, the quantity and the location.

    Raises
    ------
    MissingChannel : the run lacks a channel of these names or paths.
    """
    path_of_name = {}
    for stream, specs in run.streams.items():
        for spec in specs:
            role = "" if spec.role == "test" else f"{spec.role}_"
            location = f"_{spec.location}" if spec.location else ""
            path_of_name[f"{role}{spec.quantity or spec.name}{location}".replace(" ", "_")] = f"{stream}/{spec.name}"
    lacking = [name for name in names or () if name not in path_of_name and name not in path_of_name.values()]
    if lacking:
        raise MissingChannel(f"{run.path}: no channel {', '.join(lacking)}; the run has {', '.join(path_of_name)}")
    if names:
        selected = {
            name: channel_path for name, channel_path in path_of_name.items() if name in names or channel_path in names
        }
    else:
        selected = {
            name: channel_path for name, channel_path in path_of_name.items() if not name.endswith("_reference")
        }
    return {name: run.channel_at(channel_path) for name, channel_path in selected.items()}


def labelled_holds(run: Run) -> list[tuple[str, Step]]:
    """Return the holds of a run with their labels; a run without steps is one hold, `whole`."""
    steps = run.steps
    if not steps:
        times = [time for stream in run.streams if len(time := run.time(stream))]
        if not times:
            return []
        stop = float(np.nextafter(max(time[-1] for time in times), math.inf))
        return [("whole", Step("whole", float(min(time[0] for time in times)), stop, 0.0, {}))]
    return with_labels(step for step in steps if is_hold(step))


def is_hold(step: Step) -> bool:
    """Return whether the setpoint stands still over a step, by the step's name or its parameters."""
    states_setpoint = (
        any(key in step.parameters for key in SETPOINT_KEYS) or step.parameters.keys() in KEPT_SETPOINT_KEYS
    )
    return step.name == "hold" or ("kind" not in step.parameters and states_setpoint and step.stop > step.start)


def labelled_excitations(run: Run) -> list[tuple[str, Step]]:
    """Return the steps that excite many frequencies, with their labels."""
    return with_labels(step for step in run.steps if step.name in EXCITATIONS)


def with_labels(steps: Iterable[Step]) -> list[tuple[str, Step]]:
    """Return steps with their labels: the name, and the number among the steps of that name, from 1."""
    counts: Counter[str] = Counter()
    labelled = []
    for step in steps:
        counts[step.name] += 1
        labelled.append((f"{step.name}_{counts[step.name]}", step))
    return labelled


def hold_estimates(
    label: str, step: Step, measured: dict[str, Channel], too_few: dict[tuple[str, ...], list[str]]
) -> list[Estimate]:
    """Estimate mean, deviation and drift of each channel over one hold; add channels with few samples to `too_few`."""
    estimates: list[Estimate] = []
    lacking = []
    start = step.start + step.settle
    for name, channel in measured.items():
        mean = settled_mean(channel, start, step.stop)
        if mean is None:
            lacking.append(name)
            continue
        settled = samples_between(channel, start, step.stop)
        estimates += record_estimates(f"{label}_{name}", channel.time[settled], channel.values[settled], channel.units)
    if lacking:
        too_few.setdefault(tuple(lacking), []).append(label)
    return estimates


def record_estimates(name: str, time: Array, values: Array, units: str) -> list[Estimate]:
    """Estimate mean, deviation of single readings and drift of an evenly sampled record."""
    from scipy.stats import chi2

    finite = np.isfinite(values)
    varies = float(np.ptp(values[finite])) > 0.0
    deviation, mean_error = float(np.std(values[finite], ddof=1)) if varies else 0.0, standard_error(values)
    dof = independent_readings(deviation, mean_error, int(finite.sum())) - 1.0
    mean = with_interval(name, float(values[finite].mean()), mean_error, dof, units)
    low, high = (deviation * math.sqrt(dof / chi2.ppf(0.5 + side * CONFIDENCE / 2, dof)) for side in (1, -1))
    deviation_estimate = Estimate(f"{name}_deviation", deviation, deviation / math.sqrt(2.0 * dof), low, high, units)

    centred_time = time - time[finite].mean()
    time_square_sum = float(np.sum(centred_time[finite] ** 2))
    deviations = values - (values[finite].mean() if varies else values[finite][0])  # exactly zero for a constant
    slope = float(np.sum(centred_time[finite] * deviations[finite])) / time_square_sum
    residual = deviations - slope * centred_time
    residual_deviation, residual_error = float(np.std(residual[finite], ddof=1)), standard_error(residual)
    independent = independent_readings(residual_deviation, residual_error, int(finite.sum()))
    slope_error = residual_deviation * math.sqrt(finite.sum() / independent / time_square_sum)
    drift = with_interval(f"{name}_drift", slope, slope_error, independent - 2.0, f"{units}/s")
    return [mean, deviation_estimate, drift]


def independent_readings(deviation: float, error: float, samples: int) -> float:
    """Return how many independent readings would give the mean the same standard error `error`."""
    return (deviation / error) ** 2 if error > 0.0 else float(samples)


def with_interval(name: str, value: float, std: float, dof: float, units: str) -> Estimate:
    """Return an estimate with the 95 % interval of Student's t with `dof` degrees of freedom."""
    half_width = std * t_quantile(dof)
    return Estimate(name, value, std, value - half_width, value + half_width, units)


def mean_results(results_by_run: Sequence[Sequence[Estimate]], paths: Sequence[str]) -> list[Estimate]:
    """Return each result averaged over repeats; a single run's results stay as they are.

    Raises
    ------
    InputError : a run has other results than the first.
    """
    if len(results_by_run) == 1:
        return list(results_by_run[0])
    by_name = [{estimate.name: estimate for estimate in estimates} for estimates in results_by_run]
    for path, by_name_of_run in zip(paths[1:], by_name[1:], strict=True):
        if unshared_names := sorted(by_name_of_run.keys() ^ by_name[0].keys()):
            raise InputError(
                f"{path}: other steps or channels than {paths[0]} ({unshared_names[0]}); analyse them apart"
            )
    return [mean_of([by_name_of_run[name] for by_name_of_run in by_name]) for name in by_name[0]]


def mean_of(repeats: Sequence[Estimate]) -> Estimate:
    """Return the mean of one result over repeats.

    Its uncertainty is that of the scatter, and at least that which follows from the uncertainties of the repeats.
    """
    count, first = len(repeats), repeats[0]
    values = np.array([estimate.value for estimate in repeats])
    by_scatter = with_interval(
        first.name, float(values.mean()), float(np.std(values, ddof=1)) / math.sqrt(count), count - 1.0, first.units
    )
    std = math.hypot(*(estimate.std for estimate in repeats)) / count
    half_width = math.hypot(*(0.5 * (estimate.high - estimate.low) for estimate in repeats)) / count
    mean = by_scatter.value
    low, high = min(by_scatter.low, mean - half_width), max(by_scatter.high, mean + half_width)
    return replace(by_scatter, std=max(by_scatter.std, std), low=low, high=high)


def histogram_counts(channel: Channel) -> tuple[Array, Array]:
    """Return the middles of a histogram's bins and the number of readings in each, shape (`HISTOGRAM_BINS`,) both."""
    counts, edges = np.histogram(channel.values[np.isfinite(channel.values)], bins=HISTOGRAM_BINS)
    return 0.5 * (edges[1:] + edges[:-1]), counts.astype(np.float64)


def histogram(name: str, channel: Channel) -> Grid:
    """Return the histogram of a channel's readings over the whole run."""
    middles, counts = histogram_counts(channel)
    axes = {"run": (1.0,), f"{name} [{channel.units}]": tuple(middles.tolist())}
    return Grid(f"{name}_histogram", axes, {"readings [1]": (tuple(counts.tolist()),)})


def channel_plots(name: str, channel: Channel, holds: Sequence[tuple[str, Step]]) -> list[Plot]:
    """Return the plots of a channel: the means of the holds over time, if there are several, and the histogram."""
    means = [(step.start, settled_mean(channel, step.start + step.settle, step.stop)) for _, step in holds]
    points = [(start, mean.value if mean is not None else NAN) for start, mean in means]
    plots = []
    if len(points) > 1:
        x, y = zip(*points, strict=True)
        plots.append(Plot("time [s]", f"{name} [{channel.units}]", (Series("mean of a hold", x, y),), ()))
    if np.isfinite(channel.values).any():
        middles, counts = histogram_counts(channel)
        series = Series("readings", tuple(middles.tolist()), tuple(counts.tolist()))
        plots.append(Plot(f"{name} [{channel.units}]", "readings [1]", (series,), ()))
    return plots
