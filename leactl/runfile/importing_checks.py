"""What a channel of no machine can be: signs that units, columns or clocks were taken for others."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from leactl.runfile.importing_streams import Stream

# the widest range that electric machines are met in, from watchmaking to traction
PLAUSIBLE: Final[dict[str, tuple[float, float]]] = {
    "A": (-5e4, 5e4),
    "V": (-1e5, 1e5),
    "rad": (-1e10, 1e10),
    "m": (-1e6, 1e6),
    "rad/s": (-1e5, 1e5),
    "m/s": (-500.0, 500.0),
    "N*m": (-1e7, 1e7),
    "N": (-1e7, 1e7),
    "degC": (-100.0, 600.0),
    "1": (-0.001, 1.001),
}
GAP = 10.0  # usual intervals
SHORTEST_GAP_S = 0.1  # which no scheduler of a log makes by itself
MOST_GAPS = 0.1  # share of the intervals: more of them are how the log was made
SHORTEST_S, LONGEST_S = 1e-7, 3600.0  # between samples


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


def notes_on_gaps(streams: dict[str, Stream]) -> Iterator[str]:
    """A note for each stream whose stamps leave far more than its usual interval out."""
    for name, stream in streams.items():
        intervals = np.diff(stream.time)
        usual = float(np.median(intervals))
        gaps = np.flatnonzero(intervals > max(GAP * usual, SHORTEST_GAP_S))
        if 0 < len(gaps) <= MOST_GAPS * len(intervals):
            longest = int(gaps[np.argmax(intervals[gaps])])
            where = f"{intervals[longest]:.4g} s without a sample from {stream.time[longest]:.6g} s"
            others = f" and {len(gaps) - 1} shorter" if len(gaps) > 1 else ""
            yield f"stream {name}: {where}{others}; samples come every {usual:.4g} s otherwise"
