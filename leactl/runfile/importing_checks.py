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
TAKEN_FOR: Final = {  # the ratio of a velocity to the change of its angle, where one unit was taken for another
    30.0 / np.pi: "rpm taken for rad/s",
    2.0 * np.pi: "turns/s taken for rad/s, or turns for rad",
}
AS_NEAR, ERRORS = 0.002, 4.0  # of such a ratio, and in standard errors, whichever is more: gears are no units


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
        by_angle, by_velocity = np.diff(angle[marks]), np.diff(travelled[marks])
        if min(np.abs(by_angle).sum(), np.abs(by_velocity).sum()) < 1e-6:
            continue
        ratio = float(np.abs(by_velocity).sum() / np.abs(by_angle).sum())
        told = f"stream {stream}, channel {other}: {ratio:.3g} times the change of {name}"
        if not 1 / FACTOR < ratio < FACTOR:
            yield f"{told}; are the units of both right?"
        elif taken := unit_taken_for_another(by_angle, by_velocity):
            yield f"{told}: {taken}; are the units of both right?"


def unit_taken_for_another(by_angle: Array, by_velocity: Array) -> str:
    """Which unit was taken for which, where travel by one channel is that factor of travel by the other; else empty."""
    power = float(by_angle @ by_angle)
    ratio = abs(float(by_velocity @ by_angle)) / power
    left = np.abs(by_velocity) - ratio * np.abs(by_angle)
    error = float(np.sqrt(left @ left / (len(left) - 1) / power))
    for factor, taken in TAKEN_FOR.items():
        for expected in (factor, 1.0 / factor):
            if abs(ratio - expected) < max(AS_NEAR * expected, ERRORS * error) and ERRORS * error < 0.1 * expected:
                return taken if expected == factor else f"the other way round of {taken}"
    return ""
