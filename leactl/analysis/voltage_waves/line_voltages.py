"""Recorded line-to-line voltages of a motor: which pairs of leads are usable, and how the three are connected.

The three voltages of any winding add up to zero at every moment (Kirchhoff) and follow one another by a third of a wave
in the sense of rotation. A deviation from this is caused by the leads, the channels or their scales.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import Noted
from leactl.analysis.voltage_waves.waves import Array, Complex, VoltageRecord
from leactl.runfile.read.reader import Channel, Run

PAIRS = ("ab", "bc", "ca")
DEAD_PAIR_SHARE = 0.05  # of the largest rms of all pairs; a pair with less is dead
LEAST_PILED_SHARE = 0.02  # of the samples; a clipped record has more at one extreme
LEAST_PILE_OVER_SINE = 4.0  # that share over the share of an unclipped sine of the same resolution
CREST_SHARE = 0.8  # of the largest reading; if samples are missing only above it, they were out of range
MOST_PHASE_ERROR_RAD = math.radians(20.0)  # of a pair's phase from the third of a wave that is expected
THIRD_OF_WAVE = 2.0 * math.pi / 3.0  # rad


@dataclass(frozen=True, eq=False)
class LineVoltage:
    """Voltage of one pair of leads over a part of a run."""

    record: VoltageRecord
    resolution: float  # V
    scale_std: float  # relative standard uncertainty of the channel's scale


def line_voltages(run: Run, start: float, stop: float) -> Noted[dict[str, LineVoltage]]:
    """Return the usable pairs of leads from `start` to before `stop` [s] by name; notes say why others are unusable."""
    pairs: dict[str, LineVoltage] = {}
    notes = []
    for name in PAIRS:
        channels = run.channels(f"phase_voltage_{name}", role="test")
        if len(channels) != 1:
            notes.append(f"{run.path}: {len(channels) or 'no'} channels of pair {name}; one was expected")
            continue
        record = regular_record(channels[0], start, stop)
        if np.isfinite(record.values).sum() < 2:
            notes.append(f"{run.path}: pair {name} has no samples from {start:.2f} to {stop:.2f} s")
            continue
        pairs[name] = LineVoltage(record, resolution_of(record.values), channels[0].scale_std)
    rms_by_pair = {name: float(np.nanstd(pair.record.values)) for name, pair in pairs.items()}
    largest_rms = max(rms_by_pair.values(), default=0.0)
    for name, rms in rms_by_pair.items():
        reason = reason_unusable(pairs[name], rms, largest_rms)
        if reason:
            notes.append(f"{run.path}: pair {name} from {start:.2f} s {reason}; it does not count")
            del pairs[name]
    return Noted(pairs, tuple(notes))


def regular_record(channel: Channel, start: float, stop: float) -> VoltageRecord:
    """Return the samples from `start` to before `stop` [s] on an even grid of stamps; NaN for missing samples."""
    first_index, stop_index = (int(index) for index in np.searchsorted(channel.time, (start, stop), side="left"))
    time, values = channel.time[first_index:stop_index], channel.values[first_index:stop_index]
    if len(time) < 3:
        return VoltageRecord(time, values)
    steps = np.diff(time)
    grid_indices = np.concatenate([[0], np.cumsum(np.maximum(np.rint(steps / np.median(steps)), 1.0).astype(np.int64))])
    if grid_indices[-1] == len(time) - 1:
        return VoltageRecord(time, values)
    grid = np.arange(grid_indices[-1] + 1)
    all_values = np.full(len(grid), np.nan)
    all_values[grid_indices] = values
    return VoltageRecord(np.interp(grid, grid_indices, time), all_values)


def resolution_of(values: Array) -> float:
    """Return the smallest step between two readings [V]; 0 if all readings are equal."""
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    return float(steps.min()) if len(steps) else 0.0


def reason_unusable(pair: LineVoltage, rms: float, largest_rms: float) -> str:
    """Return the reason why a pair cannot be used; empty if it can be used.

    `rms` is its standard deviation [V], and `largest_rms` the largest of all pairs.
    """
    values = pair.record.values
    finite = np.isfinite(values)
    if rms < DEAD_PAIR_SHARE * largest_rms or rms == 0.0:
        return f"is dead: {rms:.3g} V rms, {largest_rms:.3g} V on another pair"
    highest = float(np.abs(values[finite]).max())
    edges = np.diff(finite.astype(np.int8))
    beside_gaps = np.abs(np.concatenate([values[:-1][edges < 0], values[1:][edges > 0]]))
    if len(beside_gaps) and float(np.median(beside_gaps)) > CREST_SHARE * highest:
        return f"lacks the crests of its waves, beyond {highest:.4g} V: give its input a wider range"
    # share of a sine's period within one resolution of its top
    sine_share = 2.0 * math.sqrt(2.0 * pair.resolution / highest) / (2.0 * math.pi)
    for extreme in (float(values[finite].max()), float(values[finite].min())):
        piled_share = float(np.mean(values[finite] == extreme))
        if piled_share > max(LEAST_PILED_SHARE, LEAST_PILE_OVER_SINE * sine_share):
            return f"is clipped at {extreme:.4g} V: give its input a wider range"
    return ""


@dataclass(frozen=True)
class LeadConnection:
    """Signs of three pairs of leads, and whether their waves follow one another in the order ab, bc, ca."""

    signs: Mapping[str, int]
    forward: bool


def connection_of(phasors: Mapping[str, complex]) -> LeadConnection | None:
    """Return the connection that explains the phases of three pairs; None if no connection does."""
    angle = {name: math.atan2(value.imag, value.real) for name, value in phasors.items()}
    for forward, swapped_pair in itertools.product((True, False), (None, *PAIRS)):
        signs = {name: -1 if name == swapped_pair else 1 for name in PAIRS}
        expected_lags = {
            "bc": -THIRD_OF_WAVE if forward else THIRD_OF_WAVE,
            "ca": THIRD_OF_WAVE if forward else -THIRD_OF_WAVE,
        }
        phase_errors = [
            angle[name] - angle["ab"] - lag - math.pi * (signs[name] != signs["ab"])
            for name, lag in expected_lags.items()
        ]
        if all(abs(math.remainder(error, 2.0 * math.pi)) < MOST_PHASE_ERROR_RAD for error in phase_errors):
            return LeadConnection(signs, forward)
    return None


def third_voltage(voltages: Sequence[Complex]) -> Complex:
    """Return the voltage of the third pair by Kirchhoff from two others, with the sign that their phases imply."""
    first, second = voltages
    phase_difference = float(np.angle(np.nanmean(second * np.conj(first))))
    return -(first + second) if abs(phase_difference) > math.pi / 2.0 else first - second
