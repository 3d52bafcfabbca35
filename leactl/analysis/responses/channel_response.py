"""Gain and phase of each measured channel over the setpoint that a chirp, a multisine or noise moves."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from leactl.analysis.estimate import Estimate, Grid, Noted, Plot, Series, listed, plot_slice
from leactl.analysis.responses.blackman_tukey import POINTS_PER_RESOLUTION, BlackmanTukey, Mask, Response
from leactl.analysis.responses.noise_records import MOST_INTERVAL_DEVIATION
from leactl.analysis.responses.noise_response import LEAST_COHERENCE, MOST_POINTS
from leactl.analysis.signals.levels import samples_between
from leactl.analysis.statistics.regression import Array, t_quantile
from leactl.runfile.read.reader import Channel, Run, Step

EXCITATIONS = ("chirp", "multisine", "noise")
RECORD_TO_LAG_RATIO = 8  # length of the record over the longest lag of its covariances
FEWEST_SAMPLES = 80  # ten lags at RECORD_TO_LAG_RATIO
LEAST_POWER_SHARE = 1e-3  # of the setpoint's greatest power (-30 dB); below it, a frequency is not excited
LEAST_LINE_POWER_SHARE = 0.5  # of the greatest power within a line's width; less is leakage of the window
LISTED_FREQUENCIES = 5  # frequencies that are results; all are in the grid


class Responses(NamedTuple):
    """Responses of the channels in one step, as the parts of a result."""

    estimates: list[Estimate]
    plots: list[Plot]
    grids: list[Grid]


def gain_and_phase(run: Run, label: str, step: Step, measured: dict[str, Channel]) -> Noted[Responses]:
    """Return the response of every channel to the setpoint that moves in a step.

    Notes name the channels whose response is not known, and why. `label` is the prefix of the results' names;
    `measured` has the channels by name.
    """
    estimates: list[Estimate] = []
    plots: list[Plot] = []
    grids: list[Grid] = []
    setpoint = moving_setpoint(run, step)
    if setpoint is None:
        note = f"{run.path}: {label}: no setpoint moves in this step, so gain and phase are not known"
        return Noted(Responses(estimates, plots, grids), (note,))
    names_by_reason: dict[str, list[str]] = {}
    for name, channel in measured.items():
        response = response_of(setpoint, channel, step)
        if isinstance(response, str):
            names_by_reason.setdefault(response, []).append(name)
            continue
        title, units = f"{label}_{name}", f"{channel.units}/({setpoint.units})"
        if channel.units == setpoint.units:
            units = "1"
        estimates += gain_and_phase_estimates(title, response, units)
        plots += response_plots(title, response, units)
        grids.append(response_grid(title, step, response, units))
    notes = tuple(f"{run.path}: {label}: {reason}: {listed(names)}" for reason, names in names_by_reason.items())
    return Noted(Responses(estimates, plots, grids), notes)


def moving_setpoint(run: Run, step: Step) -> Channel | None:
    """Return the first setpoint channel of the step's role that changes in the step; None if none does."""
    role = str(step.parameters.get("role", "test"))
    for stream, specs in run.streams.items():
        for spec in specs:
            if spec.quantity.endswith("_reference") and spec.role == role:
                channel = run.channel_at(f"{stream}/{spec.name}")
                values = channel.values[samples_between(channel, step.start + step.settle, step.stop)]
                if np.isfinite(values).any() and np.nanmax(values) > np.nanmin(values):
                    return channel
    return None


def response_of(setpoint: Channel, channel: Channel, step: Step) -> Response | str:
    """Return the response at the frequencies that are excited and coherent, or the reason why it is not known."""
    from scipy.ndimage import maximum_filter1d

    if not np.array_equal(channel.time, setpoint.time):
        return "not sampled with the setpoint"
    settled = samples_between(setpoint, step.start + step.settle, step.stop)
    time, reference, response_values = setpoint.time[settled], setpoint.values[settled], channel.values[settled]
    if len(time) < FEWEST_SAMPLES:
        return f"fewer than {FEWEST_SAMPLES} samples"
    intervals = np.diff(time)
    interval = float(np.median(intervals))
    if not np.isfinite(reference + response_values).all() or np.any(
        np.abs(intervals / interval - 1.0) > MOST_INTERVAL_DEVIATION
    ):
        return "samples are missing"
    if not np.ptp(response_values) > 0.0:
        return "the channel does not move"
    estimator = BlackmanTukey(interval, len(time) // RECORD_TO_LAG_RATIO, 0.5 / interval)
    spectra = estimator.spectra(reference, response_values)
    response = estimator.response(spectra)
    power = spectra.input[: len(response.frequency)]
    # Hann's main lobe reaches two resolved frequencies to either side
    greatest_nearby_power = maximum_filter1d(power, 4 * POINTS_PER_RESOLUTION + 1)
    is_usable = (
        (power > LEAST_POWER_SHARE * power.max())
        & (power > LEAST_LINE_POWER_SHARE * greatest_nearby_power)
        & (response.coherence >= LEAST_COHERENCE)
    )
    is_usable &= excited_frequencies(reference, interval, response.frequency, estimator.resolution)
    is_usable &= (response.frequency >= estimator.resolution) & (response.frequency < estimator.highest_frequency)
    if not is_usable.any():
        return f"no frequency with a coherence of {LEAST_COHERENCE:g} or more"
    return response.at(is_usable)


def excited_frequencies(reference: Array, interval: float, frequency: Array, resolution: float) -> Mask:
    """Return the mask of the frequencies [Hz] that the setpoint excites, shape (frequencies,).

    A frequency counts if the setpoint has power within half a `resolution` [Hz] of it, seen through a window whose side
    lobes are below -90 dB.
    """
    from scipy.ndimage import maximum_filter1d
    from scipy.signal.windows import blackmanharris

    power = np.abs(np.fft.rfft((reference - reference.mean()) * blackmanharris(len(reference)))) ** 2
    bin_frequency = np.fft.rfftfreq(len(reference), interval)
    half_width_bins = round(0.5 * resolution / bin_frequency[1])
    greatest_nearby_power = maximum_filter1d(power, 2 * half_width_bins + 1)
    return np.asarray(np.interp(frequency, bin_frequency, greatest_nearby_power) > LEAST_POWER_SHARE * power.max())


def gain_and_phase_estimates(title: str, response: Response, units: str) -> list[Estimate]:
    """Estimate gain and phase at the known frequencies nearest to `LISTED_FREQUENCIES` logarithmically spaced ones."""
    spaced_frequencies = np.geomspace(response.frequency[0], response.frequency[-1], LISTED_FREQUENCIES)
    indices = dict.fromkeys(int(np.argmin(np.abs(response.frequency - frequency))) for frequency in spaced_frequencies)
    estimates, phases = [], response.phase
    for index in indices:
        suffix = f"at_{response.frequency[index]:.4g}_Hz"
        gain, phase = float(response.gain[index]), float(phases[index])
        relative_std = float(response.relative_std[index])  # of the gain; in rad, the standard uncertainty of the phase
        half_width = relative_std * t_quantile(np.inf)
        low = max(gain * (1.0 - half_width), 0.0)
        estimates.append(
            Estimate(f"{title}_gain_{suffix}", gain, gain * relative_std, low, gain * (1.0 + half_width), units)
        )
        estimates.append(
            Estimate(f"{title}_phase_{suffix}", phase, relative_std, phase - half_width, phase + half_width, "rad")
        )
    return estimates


def response_plots(title: str, response: Response, units: str) -> list[Plot]:
    """Return plots of gain, phase and coherence over frequency."""
    shown = plot_slice(len(response.frequency), MOST_POINTS)
    x = tuple(response.frequency[shown].tolist())
    columns = {f"gain [{units}]": response.gain, "phase [rad]": response.phase, "coherence [1]": response.coherence}
    plot = Plot("frequency [Hz]", "", (), (), x_log=True)
    return [
        replace(plot, y_label=f"{title} {label}", points=(Series(title, x, tuple(values[shown].tolist())),))
        for label, values in columns.items()
    ]


def response_grid(title: str, step: Step, response: Response, units: str) -> Grid:
    """Return gain, phase and coherence at every known frequency, with half the width of their 95 % intervals."""
    axes = {"start [s]": (step.start,), "frequency [Hz]": tuple(response.frequency.tolist())}
    columns = {
        f"gain [{units}]": response.gain,
        "phase [rad]": response.phase,
        "relative half width of gain, half width of phase [rad]": t_quantile(np.inf) * response.relative_std,
        "coherence [1]": response.coherence,
    }
    return Grid(f"{title}_response", axes, {name: (tuple(values.tolist()),) for name, values in columns.items()})
