"""Rise of a winding's temperature by its resistance: voltage over direct current through two leads, cold and hot.

IEC 60034-1, 8.6.2: rise = (R hot / R cold - 1) (1 / alpha + T cold - T ref). It needs no camera, and gives the mean of
the two phases that carry the current, which is warmer than the mean of the winding.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl import yamlfile
from leactl.analysis.estimate import NAN, Estimate, Plot, Result, Series
from leactl.analysis.heating.record import AMBIENT, refuse_clipped, refuse_not_celsius
from leactl.analysis.linefit import expect_setup, place_of
from leactl.analysis.regression import least_squares, t_quantile
from leactl.errors import InputError, NotIdentifiable
from leactl.runfile.reader import Run

Array = npt.NDArray[np.float64]
ON = 0.2  # of the largest current, above which it counts as switched on
COLD_S = 3.0  # after switching on, over which a parabola leads back to the cold winding; it takes 7 s to warm
SKIPPED = 2  # readings after switching on, which the supply may have begun before
HOT_S = 30.0
STEADY_S, STEADY_K = 1800.0, 1.0
BLOCK_S = 60.0  # whose mean counts once
FEWEST = 10
UNKNOWN_COLD = (25.0, 3.0)  # degC and its standard uncertainty, where no ambient was measured
SHOWN = 300  # points of the plot


@dataclass(frozen=True, eq=False)
class Heating:
    """The longest stretch with the current on: resistance between the leads, and what its readings resolve."""

    time: Array  # s since switching on
    resistance: Array  # ohm
    resolution: float  # standard uncertainty of a resistance by the steps of voltage and current, relative
    before: float  # s of the run, at which it was switched on


@dataclass(frozen=True)
class Copper:
    """How the resistance goes with the temperature, by the model of a run."""

    coefficient: float  # 1/K
    std: float  # relative
    reference: float  # degC


def analyze(runs: Sequence[Run]) -> Result:
    """Cold and hot resistance [ohm], rise [K], and its change over the last 30 minutes of heating [K].

    Raises
    ------
    MissingChannel : a run lacks line current or line voltage of the test actuator.
    NotIdentifiable : more than one run, no current, too few readings, or no resistance coefficient in the model.
    """
    place = place_of(runs)
    if len(runs) > 1:
        raise NotIdentifiable(f"{place}: one run at a time; each begins from a temperature of its own")
    run = runs[0]
    notes = expect_setup(runs, ("heated",), "friction and iron loss would heat besides")
    copper, heating = copper_of(run), heating_of(run)
    cold, cold_std = cold_resistance(heating, place)
    last = heating.time >= heating.time[-1] - HOT_S
    hot, hot_std = float(np.mean(heating.resistance[last])), heating.resolution * float(np.mean(heating.resistance))
    at_first, at_first_std = cold_temperature(run, heating.before, notes)
    per_ratio = 1.0 / copper.coefficient + at_first - copper.reference  # K for a resistance twice the cold one
    rise = (hot / cold - 1.0) * per_ratio
    scale_std = math.hypot(copper.std / copper.coefficient, at_first_std) / per_ratio
    own_std = per_ratio * hot / cold * math.hypot(hot_std / hot, cold_std / cold)
    results = (
        estimate("cold_resistance", cold, cold_std, "ohm"),
        estimate("hot_resistance", hot, hot_std, "ohm"),
        estimate("winding_rise", rise, math.hypot(own_std, rise * scale_std), "K"),
        change(heating, per_ratio / cold, notes),
    )
    notes.append(
        "resistances lack the calibration of the supply's readings; the rise is of their ratio, and free of it"
    )
    every = max(1, len(heating.time) // SHOWN)
    kelvin = (heating.resistance[::every] / cold - 1.0) * per_ratio
    shown = Series(str(run.path), tuple(heating.time[::every].tolist()), tuple(kelvin.tolist()))
    return Result(
        "winding-rise", (str(run.path),), results, tuple(notes), (Plot("time [s]", "rise [K]", (shown,), ()),)
    )


def heating_of(run: Run) -> Heating:
    """Readings of the longest stretch with the current on."""
    current, voltage = run.channel("line_current", role="test"), run.channel("line_voltage", role="test")
    for one in (current, voltage):
        refuse_clipped(run, one)
    seen = np.isfinite(voltage.values)
    time, volts = voltage.time[seen], voltage.values[seen]
    known = np.isfinite(current.values)
    if known.sum() < FEWEST or len(time) < FEWEST:
        raise NotIdentifiable(f"{run.path}: line_current or line_voltage of test has no readings")
    amperes = np.interp(time, current.time[known], current.values[known])
    on = np.abs(amperes) > max(ON * float(np.max(np.abs(amperes))), 1e-3)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    parts = [slice(int(a) + SKIPPED, int(b)) for a, b in edges.reshape(-1, 2) if b - a > FEWEST + SKIPPED]
    if not parts:
        raise NotIdentifiable(f"{run.path}: no current flows for {FEWEST} readings: nothing was heated")
    longest = max(parts, key=lambda part: time[part.stop - 1] - time[part.start])
    resistance = volts[longest] / amperes[longest]
    if float(np.median(resistance)) <= 0.0:
        raise InputError(
            f"{run.path}: line_voltage over line_current is {np.median(resistance):.3g} ohm; above zero was expected:"
            " one of the two has its leads swapped"
        )
    begun = float(time[longest.start - SKIPPED])
    resolution = math.hypot(*(step_of(one) / abs(float(np.mean(one))) for one in (volts[longest], amperes[longest])))
    return Heating(time[longest] - begun, resistance, resolution / math.sqrt(12.0), begun)


def step_of(values: Array) -> float:
    """The least difference of two readings; 0 where all are alike."""
    steps = np.diff(np.unique(np.round(values, 6)))
    return float(np.min(steps, initial=math.inf)) if len(steps) else 0.0


def cold_resistance(heating: Heating, place: str) -> tuple[float, float]:
    """Resistance at the moment of switching on, and its standard uncertainty [ohm]."""
    first = heating.time < COLD_S
    if int(np.sum(first)) < FEWEST:
        raise NotIdentifiable(
            f"{place}: {np.sum(first)} readings in the first {COLD_S:g} s of heating; at least {FEWEST} are needed to"
            " lead back to the cold winding"
        )
    design = np.vander(heating.time[first], 3, increasing=True)
    fit = least_squares(design, heating.resistance[first], design, place)
    value, own = fit.combined(np.array([1.0, 0.0, 0.0]))
    return value, math.hypot(own, heating.resolution * value)


def copper_of(run: Run) -> Copper:
    """The resistance coefficient in the model that a run carries."""
    text = run.source("model")
    data = yamlfile.parse(text, f"{run.path}:/model/source").data if text is not None else None
    model = data if isinstance(data, dict) else {}
    found = model.get("resistance_coefficient")
    if not (isinstance(found, int | float) and not isinstance(found, bool) and found > 0):
        raise NotIdentifiable(f"{run.path}: its model has no resistance_coefficient; a rise cannot be told without")
    tolerances = model.get("tolerances")
    width = tolerances.get("resistance_coefficient", 0.0) if isinstance(tolerances, dict) else 0.0
    return Copper(float(found), float(width) / math.sqrt(3.0), float(model.get("reference_temperature", 25.0)))


def cold_temperature(run: Run, before: float, notes: list[str]) -> tuple[float, float]:
    """Temperature of the winding before it was heated [degC]: that of the air."""
    for air in run.channels(AMBIENT, "bench") or run.channels(AMBIENT):
        refuse_not_celsius(run, air)
        rest = air.values[(air.time < before) & np.isfinite(air.values)]
        if len(rest):
            return float(np.mean(rest)), 1.0
    notes.append(f"no ambient temperature before heating; taken as {UNKNOWN_COLD[0]:g} degC, within 6 K")
    return UNKNOWN_COLD


def change(heating: Heating, kelvin_per_ohm: float, notes: list[str]) -> Estimate:
    """How far the rise still went in the last half hour of heating; steady is 1 K or less."""
    name = "change_in_last_30_min"
    if heating.time[-1] < STEADY_S:
        notes.append(f"heated for {heating.time[-1] / 60:.0f} min: whether it is steady shows after 30 min")
        return Estimate(name, NAN, NAN, NAN, NAN, "K")
    last = heating.time >= heating.time[-1] - STEADY_S
    block = ((heating.time[last] - heating.time[last][0]) / BLOCK_S).astype(int)
    counts = np.bincount(block)
    kept = counts > 0
    time = np.bincount(block, heating.time[last])[kept] / counts[kept]
    mean = np.bincount(block, heating.resistance[last])[kept] / counts[kept] * kelvin_per_ohm
    design = np.column_stack([time - time.mean(), np.ones_like(time)])
    slope, own = least_squares(design, mean, design, name).combined(np.array([1.0, 0.0]))
    step = math.sqrt(2.0) * heating.resolution * float(np.mean(mean))  # of a voltage that may stay within one step
    std = math.hypot(own * STEADY_S, step)
    half = t_quantile(len(time) - 2.0) * std
    found = Estimate(name, slope * STEADY_S, std, slope * STEADY_S - half, slope * STEADY_S + half, "K")
    if max(abs(found.low), abs(found.high)) <= STEADY_K:
        notes.append(f"steady: no more than {STEADY_K:g} K in the last 30 min of heating")
    elif found.low > STEADY_K or found.high < -STEADY_K:
        notes.append(f"no steady state: {found.value:+.1f} K in the last 30 min of heating")
    else:
        notes.append(f"whether it is steady ({STEADY_K:g} K in 30 min) cannot be told from these readings")
    return found


def estimate(name: str, value: float, std: float, units: str) -> Estimate:
    """A value with the interval of a normal distribution."""
    half = t_quantile(math.inf) * std
    return Estimate(name, value, std, value - half, value + half, units)
