"""Compare two runs channel by channel without a model: simulated and measured ones, or repeats."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.signal import correlate, correlation_lags

from leactl.errors import InputError
from leactl.gap.signals.record import INTERPOLATION_REACH, bridging_interval, median_interval, near_stamps
from leactl.runfile.read.reader import Channel, Run
from leactl.runfile.verify.integrity import refuse_altered

Array = npt.NDArray[np.float64]
FEWEST_COMMON_SAMPLES = 10  # samples of a channel that both runs need
LONGEST_LAG_SHARE = 0.25  # longest lag that is tried, as a share of the common span


@dataclass(frozen=True)
class Distance:
    """Difference of one channel between two runs."""

    quantity: str
    role: str
    location: str
    units: str
    samples: int
    rms: float  # of the second minus the first
    mean: float
    correlation: float | None  # null where a channel is constant
    lag_s: float | None  # delay of the second after the first, to a sample; null where a channel is constant


def compare_runs(first: Path, second: Path) -> list[Distance]:
    """Return the distance of every channel that both runs have, at the stamps of the first, where both were recording.

    Raises
    ------
    InputError : a file cannot be used, the runs have no channel in common, or one is in different units.
    """
    refuse_altered([first, second])
    with Run.open(first) as first_run, Run.open(second) as second_run:
        first_channels, second_channels = _channels(first_run), _channels(second_run)
    common = [key for key in first_channels if key in second_channels]
    faults = [
        f"{second}: {key[0]} of {key[1]} is in {second_channels[key].units}, {first} has {first_channels[key].units}"
        for key in common
        if second_channels[key].units != first_channels[key].units
    ]
    if faults:
        raise InputError(faults)
    distances = [
        channel for key in common if (channel := distance(first_channels[key], second_channels[key])) is not None
    ]
    if not distances:
        raise InputError(f"{second}: no channel in common with {first} for {FEWEST_COMMON_SAMPLES} samples or more")
    return distances


def distance(first: Channel, second: Channel) -> Distance | None:
    """Return the difference of two channels; None where they have too few common samples."""
    first_valid, second_valid = np.isfinite(first.values), np.isfinite(second.values)
    if second_valid.sum() < FEWEST_COMMON_SAMPLES:
        return None
    second_stamps = second.time[second_valid]
    is_common = first_valid & (first.time >= second_stamps[0]) & (first.time <= second_stamps[-1])
    is_common &= near_stamps(
        first.time,
        second_stamps,
        INTERPOLATION_REACH * max(bridging_interval(second_stamps), median_interval(first.time)),
    )
    if is_common.sum() < FEWEST_COMMON_SAMPLES:
        return None
    time, first_values = first.time[is_common], first.values[is_common]
    second_values = np.interp(time, second_stamps, second.values[second_valid])
    difference = second_values - first_values
    correlation, lag = _likeness(time, first_values, second_values)
    return Distance(
        first.quantity,
        first.role,
        first.location,
        first.units,
        len(time),
        float(np.sqrt(np.mean(difference**2))),
        float(np.mean(difference)),
        correlation,
        lag,
    )


def _likeness(time: Array, first: Array, second: Array) -> tuple[float | None, float | None]:
    """Return the correlation of two channels, and the delay [s] of the second; None for both if either is constant."""
    first_centred, second_centred = first - first.mean(), second - second.mean()
    scale = float(np.sqrt(np.sum(first_centred**2) * np.sum(second_centred**2)))
    if scale <= 1e-12 * len(first_centred) * max(float(np.max(np.abs(first))), float(np.max(np.abs(second)))) ** 2:
        return None, None
    # the lag is found on an even clock; gaps are interpolated
    interval = float(np.median(np.diff(time)))
    even_times = np.arange(time[0], time[-1] + 0.5 * interval, interval)
    correlations = correlate(
        np.interp(even_times, time, second_centred), np.interp(even_times, time, first_centred), method="fft"
    )
    lags = correlation_lags(len(even_times), len(even_times))
    is_tried = np.abs(lags) <= LONGEST_LAG_SHARE * len(even_times)
    return float(np.sum(first_centred * second_centred)) / scale, float(
        lags[is_tried][np.argmax(correlations[is_tried])] * interval
    )


def _channels(run: Run) -> dict[tuple[str, str, str], Channel]:
    """Return the channels of a run by quantity, role and location."""
    channels = {}
    for specs in run.streams.values():
        for spec in specs:
            if spec.quantity:
                for channel in run.channels(spec.quantity, spec.role):
                    channels[channel.quantity, channel.role, channel.location] = channel
    return channels


def as_json(distances: list[Distance]) -> dict[str, Any]:
    """Return the distances as a document for other programs."""
    return {"channels": [asdict(channel) for channel in distances]}
