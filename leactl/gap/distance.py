"""How far two runs are apart, channel by channel, without a model: simulated and measured ones, or repeats."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.signal import correlate, correlation_lags

from leactl.errors import InputError
from leactl.gap.signals.record import REACH, bridging_interval, near, pace
from leactl.runfile.read.reader import Channel, Run
from leactl.runfile.verify.integrity import refuse_altered

Array = npt.NDArray[np.float64]
FEWEST = 10  # samples in common
LONGEST_LAG = 0.25  # of the common span


@dataclass(frozen=True)
class Distance:
    """One channel of two runs."""

    quantity: str
    role: str
    location: str
    units: str
    samples: int
    rms: float  # of the second minus the first
    mean: float
    correlation: float | None  # null where a channel stands still
    lag_s: float | None  # by which the second follows the first, to a sample; the same


def compare_runs(first: Path, second: Path) -> list[Distance]:
    """Every channel that both runs have, at the stamps of the first, where both were recording.

    Raises
    ------
    InputError : a file that cannot be used, no channel in common, or one in different units.
    """
    refuse_altered([first, second])
    with Run.open(first) as one, Run.open(second) as other:
        ours, theirs = _channels(one), _channels(other)
    common = [key for key in ours if key in theirs]
    faults = [
        f"{second}: {key[0]} of {key[1]} is in {theirs[key].units}, {first} has {ours[key].units}"
        for key in common
        if theirs[key].units != ours[key].units
    ]
    if faults:
        raise InputError(faults)
    distances = [distances for key in common if (distances := distance(ours[key], theirs[key])) is not None]
    if not distances:
        raise InputError(f"{second}: no channel in common with {first} for {FEWEST} samples or more")
    return distances


def distance(first: Channel, second: Channel) -> Distance | None:
    """The plain distance of two channels; None where they have too little in common."""
    measured, there = np.isfinite(first.values), np.isfinite(second.values)
    if there.sum() < FEWEST:
        return None
    stamps = second.time[there]
    inside = measured & (first.time >= stamps[0]) & (first.time <= stamps[-1])
    inside &= near(first.time, stamps, REACH * max(bridging_interval(stamps), pace(first.time)))
    if inside.sum() < FEWEST:
        return None
    time, ours = first.time[inside], first.values[inside]
    theirs = np.interp(time, stamps, second.values[there])
    apart = theirs - ours
    correlation, lag = _likeness(time, ours, theirs)
    return Distance(
        first.quantity,
        first.role,
        first.location,
        first.units,
        len(time),
        float(np.sqrt(np.mean(apart**2))),
        float(np.mean(apart)),
        correlation,
        lag,
    )


def _likeness(time: Array, ours: Array, theirs: Array) -> tuple[float | None, float | None]:
    a, b = ours - ours.mean(), theirs - theirs.mean()
    size = float(np.sqrt(np.sum(a**2) * np.sum(b**2)))
    if size <= 1e-12 * len(a) * max(float(np.max(np.abs(ours))), float(np.max(np.abs(theirs)))) ** 2:
        return None, None
    # the lag is found on an even clock; what is missing in between is bridged
    interval = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * interval, interval)
    alike = correlate(np.interp(even, time, b), np.interp(even, time, a), method="fft")
    lags = correlation_lags(len(even), len(even))
    near = np.abs(lags) <= LONGEST_LAG * len(even)
    return float(np.sum(a * b)) / size, float(lags[near][np.argmax(alike[near])] * interval)


def _channels(run: Run) -> dict[tuple[str, str, str], Channel]:
    channels = {}
    for specs in run.streams.values():
        for spec in specs:
            if spec.quantity:
                for channel in run.channels(spec.quantity, spec.role):
                    channels[channel.quantity, channel.role, channel.location] = channel
    return channels


def as_json(distances: list[Distance]) -> dict[str, Any]:
    """The same for other programs."""
    return {"channels": [asdict(one) for one in distances]}
