"""Estimates of a thermal fit, and what a reader must know of them."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leactl.analysis.estimate import NAN, Estimate
from leactl.analysis.heating.network import NetworkFit, measured
from leactl.analysis.heating.parameters import (
    NAMES,
    UNITS,
    Instruments,
    Known,
    Uncertainty,
    correlation,
    natural,
    natural_covariance,
    parallel,
)
from leactl.analysis.heating.record import Array, Stretch
from leactl.analysis.heating.resistance import ResistanceLine
from leactl.analysis.statistics.regression import t_quantile

STEADY_K, STEADY_S, ENDS_S = 1.0, 1800.0, 60.0  # so much change in so long, between means over so long
TELLING = 0.7  # correlations worth a note
PLAIN = 1.05  # times the noise, up to which residuals are noise
LATE = 3.0  # standard deviations from which on a lag or an offset is told
LEAST_SEEN = 1.0  # slow time constants
STEADY = (
    "winding_ambient_resistance",
    "housing_ambient_resistance",
    "parallel_thermal_resistance",
    "continuous_current",
    "continuous_current_standing",
)


def network_results(known: Known, seen: float, notes: list[str]) -> list[Estimate]:
    """The five parameters and the combination that is known best.

    `seen` is how many slow time constants the record shows at a stretch; by less than one, what hangs on the steady
    state is told by none: its figure would be the model's, not the record's.
    """
    found = [
        known.estimate(name, units, lambda one, k=k: float(natural(one)[k]))  # type: ignore[misc]
        for k, (name, units) in enumerate(zip(NAMES[:5], UNITS[:5], strict=True))
    ]
    found.append(known.estimate("parallel_thermal_resistance", "K/W", parallel))
    if seen < LEAST_SEEN:
        found = [untold(one) if one.name in STEADY else one for one in found]
        notes.append(
            f"heating and cooling were followed for {seen:.2g} time constants of the housing at the longest,"
            f" {LEAST_SEEN:g} is the least that tells a steady state"
        )
    notes += [f"{one.name} is not identifiable from this record" for one in found if not math.isfinite(one.value)]
    if not math.isfinite(found[0].value):
        wa, spread = known.point[0], math.sqrt(known.covariance[0, 0])
        if (most := wa + t_quantile(math.inf) * spread) > 0.0:
            notes.append(f"winding_ambient_resistance is above {1.0 / most:.3g} K/W (97.5 %)")
    return found


def untold(estimate: Estimate) -> Estimate:
    """The same without a figure."""
    return replace(estimate, value=NAN, std=NAN, low=NAN, high=NAN)


def slow_constants_seen(fit: NetworkFit) -> float:
    """Longest heating or cooling at a stretch, in slow time constants of the network.

    What comes before the first heating is no cooling, unless the winding was still warm.
    """
    longest = 0.0
    for one in fit.stretches:
        on, time = one.supply.on, one.supply.time
        edges = [0, *(np.flatnonzero(np.diff(on)) + 1).tolist(), len(on) - 1]
        warm = np.nanmax(one.winding) - np.nanmin(one.winding)
        begun_warm = one.winding[np.isfinite(one.winding)][0] - np.nanmin(one.winding) > 0.5 * warm
        for first, last in itertools.pairwise(edges):
            if first or on[0] or begun_warm:
                longest = max(longest, float(time[last] - time[first]))
    return longest * -float(np.max(fit.network.modes()[0]))


def resistance_results(known: Known, line: ResistanceLine, phase_of_line: float, notes: list[str]) -> list[Estimate]:
    """Resistance of two leads and of a phase at 25 degC, and how it goes with the temperature."""
    found = [
        known.estimate("line_resistance", "ohm", lambda one: float(one.point[5])),
        known.estimate("phase_resistance", "ohm", lambda one: phase_of_line * float(one.point[5])),
        known.estimate("resistance_coefficient", "1/K", lambda one: float(one.point[6])),
    ]
    notes += [f"{one.name} is not identifiable from this record" for one in found if not math.isfinite(one.value)]
    return [*found, Estimate("resistance_r_squared", line.r_squared, NAN, NAN, NAN, "1")]


def residual_results(fit: NetworkFit, found: Uncertainty, notes: list[str]) -> list[Estimate]:
    """Root mean squares of the residuals [K], and that of both nodes over the noise from frame to frame."""
    each = [np.concatenate([left[node] for left in fit.residuals]) for node in (0, 1)]
    rms = [math.sqrt(float(np.nanmean(left**2))) for left in each]
    whole = math.sqrt(float(np.nanmean(np.concatenate(each) ** 2)))
    noise = [noise_of([measured(one)[node] for one in fit.stretches]) for node in (0, 1)]
    counts = [int(np.isfinite(left).sum()) for left in each]
    expected = math.sqrt(sum(n * s**2 for n, s in zip(counts, noise, strict=True)) / sum(counts))
    over = whole / expected if expected > 0.0 else NAN
    if over > PLAIN:
        drift = np.sqrt(np.diag(found.scatter.drift))
        notes.append(
            f"residuals are {over:.2f} times the noise from frame to frame: a drift of {drift[0]:.2g} K at the winding"
            f" and {drift[1]:.2g} K at the housing that lasts {found.scatter.lasts:.0f} s, of the camera, the air or of"
            " what two bodies do not show; the intervals count it in"
        )
    plain = {"rmse": whole, "rmse_winding": rms[0], "rmse_housing": rms[1]}
    return [
        *(Estimate(name, value, NAN, NAN, NAN, "K") for name, value in plain.items()),
        Estimate("rmse_over_noise", over, NAN, NAN, NAN, "1"),
    ]


def noise_of(columns: Sequence[Array]) -> float:
    """Noise from frame to frame [K], by second differences, in which a smooth curve does not show."""
    bends = np.concatenate([column[2:] - 2.0 * column[1:-1] + column[:-2] for column in columns])
    bends = bends[np.isfinite(bends)]
    return math.sqrt(float(np.mean(bends**2)) / 6.0) if len(bends) else NAN


def steadiness(stretches: Sequence[Stretch], notes: list[str]) -> list[Estimate]:
    """How far the warmer of both nodes still went in the last half hour of heating [K]: steady below 1 K."""
    changes = []
    for one in stretches:
        on = one.supply.time[one.supply.on]
        if not len(on):
            continue
        end = float(on[-1])
        start = max(end - STEADY_S, float(one.time[0]))
        if end - start < 0.99 * STEADY_S or not one.supply.on[one.supply.time > start + ENDS_S].any():
            changes.append(NAN)
            continue
        early, late = ((one.time >= at) & (one.time < at + ENDS_S) for at in (start, end - ENDS_S))
        with np.errstate(invalid="ignore"):
            moved = [float(np.nanmean(row[late]) - np.nanmean(row[early])) for row in measured(one)]
        changes.append(max(moved, key=abs))
    told = [one for one in changes if math.isfinite(one)]
    worst = max(told, key=abs, default=NAN)
    if not told:
        notes.append("heated for less than 30 min: no steady state, and what hangs on it has a wide interval")
    elif abs(worst) > STEADY_K:
        notes.append(
            f"no steady state: {worst:+.1f} K in the last 30 min of heating, at most {STEADY_K:g} K was expected;"
            " what hangs on it has a wider interval"
        )
    return [Estimate("change_in_30_min", worst, NAN, NAN, NAN, "K")]


def camera_results(fit: NetworkFit, found: Uncertainty, offset_std: float, notes: list[str]) -> list[Estimate]:
    """What the camera's clock and zero were found to be off by, for each run where there are several."""
    units = {"lag": "s", "offset_winding": "K", "offset_housing": "K"}
    rows = []
    for index, stretch in enumerate(fit.stretches):
        for name, unit in units.items():
            at = fit.own(index, name)
            if at is None:
                continue
            value, std = float(fit.point[at]), math.sqrt(found.noise[at, at] + found.drift[at, at])
            half = t_quantile(math.inf) * std
            rows.append(Estimate(f"camera_{name}", value, std, value - half, value + half, unit))
            if name == "lag" and abs(value) > max(LATE * std, 2.0 * float(np.median(np.diff(stretch.time)))):
                notes.append(
                    f"{stretch.place}: the camera's clock is {value:.2f} s behind the supply's; taken into account"
                )
            if name != "lag" and abs(value) > LATE * math.hypot(offset_std, std):
                notes.append(
                    f"{stretch.place}: {name.removeprefix('offset_')} reads {value:+.1f} K off the sensor of the air,"
                    f" more than the camera's {offset_std:g} K explain: units, emissivity, or air of another place"
                )
    return rows if len(fit.stretches) == 1 else []


def remarks(known: Known, stretches: Sequence[Stretch], instruments: Instruments) -> list[str]:
    """Correlations, what the instruments were taken to be, and how far the air went."""
    table, notes = correlation(natural_covariance(known)), []
    pairs = [(abs(table[i, k]), i, k) for i in range(5) for k in range(i) if abs(table[i, k]) > TELLING]
    told = [f"{table[i, k]:+.2f} of {NAMES[k]} and {NAMES[i]}" for _, i, k in sorted(pairs, reverse=True)[:4]]
    if told:
        notes.append(f"correlations: {'; '.join(told)}")
    notes.append(
        f"standard uncertainties taken: camera {instruments.camera_offset:g} K and {instruments.camera_gain:.2%} of the"
        f" rise, voltage {instruments.voltage_gain:.2%}, current {instruments.current_gain:.2%}"
    )
    for name in ("current", "voltage"):
        values = np.concatenate([getattr(one.supply, name)[one.supply.on] for one in stretches])
        if np.ptp(values) == 0.0:
            notes.append(
                f"line_{name} reads {values[0]:g} throughout: its resolution does not show; tell {name}_gain_std"
            )
    moved = [float(np.ptp(_smooth(one.ambient))) for one in stretches if one.ambient is not None]
    if max(moved, default=0.0) > STEADY_K:
        notes.append(f"the air went {max(moved):.1f} K up and down; the network is driven by what was read of it")
    return notes


def _smooth(ambient: Array) -> Array:
    size = max(len(ambient) // 50, 1)
    return np.array([float(np.mean(part)) for part in np.array_split(ambient, max(len(ambient) // size, 1))])
