"""What a channel of a machine cannot be: signs that units, columns or clocks were taken for others."""

from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from leactl.runfile.importing_streams import Stream

Array = npt.NDArray[np.float64]

# the widest range that electric machines are met in, from watchmaking to traction
PLAUSIBLE: Final[dict[str, tuple[float, float]]] = {
    "A": (-5e4, 5e4),
    "V": (-1e5, 1e5),
    "rad/s": (-1e5, 1e5),
    "m/s": (-500.0, 500.0),
    "N*m": (-1e7, 1e7),
    "N": (-1e7, 1e7),
    "degC": (-100.0, 600.0),
    "1": (-0.001, 1.001),
}
SHORTEST_S, LONGEST_S = 1e-7, 3600.0  # between samples
FEWEST = 50  # samples, to compare a velocity with its angle
FACTOR = 20.0  # by which a velocity may miss the change of its angle: filters and unlike sensors stay well below


def implausible(stream: str, found: Stream) -> Iterator[str]:
    """What is wrong with a stream's numbers, one line each."""
    if len(found.time) < 2:
        yield f"stream {stream}: {len(found.time)} row; at least 2 were expected"
        return
    interval = float(np.median(np.diff(found.time)))
    if not SHORTEST_S <= interval <= LONGEST_S:
        yield f"stream {stream}: {interval:.3g} s between samples; are time.units right?"
    for spec, values in zip(found.specs, found.values, strict=True):
        low, high = PLAUSIBLE.get(spec.unit, (-np.inf, np.inf))
        wrong = np.flatnonzero((values < low) | (values > high))
        if len(wrong):
            worst = values[wrong[0]]
            told = f"{worst:.6g} {spec.unit} at {found.time[wrong[0]]:.6g} s is outside {low:g} .. {high:g}"
            yield f"stream {stream}, channel {spec.name}: {told}; are units and scale right?"
    yield from unlike_velocities(stream, found)


def unlike_velocities(stream: str, found: Stream) -> Iterator[str]:
    """Velocities that are another size than the change of the angle beside them."""
    by_key = {(s.quantity, s.role): (s.name, v) for s, v in zip(found.specs, found.values, strict=True)}
    for (quantity, role), (name, angle) in by_key.items():
        if quantity != "angle" or ("velocity", role) not in by_key:
            continue
        other, velocity = by_key["velocity", role]
        good = np.isfinite(angle) & np.isfinite(velocity)
        if good.sum() < FEWEST:
            continue
        time, angle, velocity = found.time[good], angle[good], velocity[good]
        # both as travel over a twentieth of the run: quantised angles and noisy velocities average out
        marks = np.linspace(0, len(time) - 1, 21).astype(int)
        travelled = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time))])
        by_angle, by_velocity = np.sum(np.abs(np.diff(angle[marks]))), np.sum(np.abs(np.diff(travelled[marks])))
        if min(by_angle, by_velocity) < 1e-6:
            continue
        ratio = float(by_velocity / by_angle)
        if not 1 / FACTOR < ratio < FACTOR:
            told = f"{ratio:.3g} times the change of {name}"
            yield f"stream {stream}, channel {other}: {told}; are the units of both right?"
