"""Rise of a winding's temperature by its resistance: voltage over direct current through two leads, cold and hot.

IEC 60034-1, 8.6.2: rise = (R hot / R cold - 1) (1 / alpha + T cold - T ref). It needs no camera, and gives the mean of
the two phases that carry the current, which is warmer than the mean of the winding.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import NAN, Estimate, Noted, Plot, Result, Series, plot_slice
from leactl.analysis.heating.record import AMBIENT, refuse_clipped, refuse_not_celsius
from leactl.analysis.quality.calibration_uncertainty import calibration_notes, gain_std
from leactl.analysis.quality.wrong_units import unit_notes
from leactl.analysis.run_model import model_of, positive_number
from leactl.analysis.statistics.intervals import half_width, quantisation_step, rounding_limit, rounding_std
from leactl.analysis.statistics.linefit import paths_of, setup_notes
from leactl.analysis.statistics.regression import least_squares
from leactl.errors import InputError, NotIdentifiable
from leactl.runfile.read.reader import Run

RESULTS = {
    "cold_resistance": "ohm",
    "hot_resistance": "ohm",
    "winding_rise": "K",
    "change_in_last_30_min": "K",
}

Array = npt.NDArray[np.float64]
SWITCHED_ON_SHARE = 0.2  # of the largest current; a current above it counts as switched on
COLD_S = 3.0  # after switching on, over which a parabola is fitted; the winding takes 7 s to warm
SKIPPED_READINGS = 2  # after switching on: the supply may average over the time before
HOT_S = 30.0  # at the end of heating, over which the hot resistance is averaged
STEADY_S, STEADY_K = 1800.0, 1.0  # a steady temperature changes by at most this in this time
BLOCK_S = 60.0  # over which the temperature is averaged
FEWEST_READINGS = 10  # in the stretch with current, and in `COLD_S`
ASSUMED_AMBIENT = (25.0, 3.0)  # degC and its standard uncertainty, for a run without ambient temperature
MOST_POINTS = 300  # of the plot


@dataclass(frozen=True, eq=False)
class HeatedResistance:
    """The resistance between the leads over the longest stretch with the current on, and its resolution."""

    time: Array  # s since switching on
    resistance: Array  # ohm
    step: float  # ohm, by which one quantisation step of the voltage changes a resistance
    current_rounding: float  # relative standard uncertainty by the quantisation of the current
    switch_on_time: float  # s, on the clock of the run


@dataclass(frozen=True)
class CopperCoefficient:
    """The temperature coefficient of the resistance, by the model of a run."""

    coefficient: float  # 1/K
    half_range: float  # relative: the coefficient lies anywhere within this of its value
    reference: float  # degC, at which the coefficient is stated


@dataclass(frozen=True)
class MeasuredResistance:
    """A resistance [ohm] with its uncertainties."""

    value: float
    std: float  # ohm, by scatter
    dof: float
    limit: float  # ohm, of the rounding error by the voltage, which is evenly spread
    current_rounding: float  # relative standard uncertainty by the quantisation of the current, the same in both

    def estimate(self, name: str, gain: float) -> Estimate:
        """Return the estimate of the resistance; `gain` is the relative standard uncertainty of the calibration."""
        shared = math.hypot(self.current_rounding, gain) * self.value
        std = math.hypot(self.std, shared)
        dof = self.dof * (std / self.std) ** 4 if self.std > 1e-9 * std else math.inf
        half = half_width(std, dof, self.limit)
        std_with_rounding = math.hypot(std, self.limit / math.sqrt(3.0))
        return Estimate(name, self.value, std_with_rounding, self.value - half, self.value + half, "ohm")


def analyze(
    runs: Sequence[Run], *, voltage_gain_std: float | None = None, current_gain_std: float | None = None
) -> Result:
    """Estimate cold and hot resistance [ohm], the rise [K], and its change over the last 30 minutes of heating [K].

    Parameters
    ----------
    runs : one run of one actuator, heated.
    voltage_gain_std, current_gain_std : relative standard uncertainties of the supply's readings; by default those of
        the channels.

    Raises
    ------
    MissingChannel : a run lacks line current or line voltage of the test actuator.
    NotIdentifiable : more than one run, no current, too few readings, a clipped channel, or no resistance coefficient
        in the model.
    InputError : an uncertainty below zero, leads that are swapped, an ambient temperature in kelvin, or a model whose
        tolerance or reference temperature is out of range.
    """
    error_prefix = paths_of(runs)
    if len(runs) > 1:
        raise NotIdentifiable(f"{error_prefix}: one run at a time; each begins from a temperature of its own")
    run = runs[0]
    notes = setup_notes(runs, ("heated",), "friction and iron loss would heat besides")
    copper, heating = coefficient_of(run), heating_of(run)
    gains = {
        "the supply's voltage": gain_std(runs, "line_voltage", voltage_gain_std),
        "the supply's current": gain_std(runs, "line_current", current_gain_std),
    }
    gain = math.hypot(*gains.values())
    cold, hot = cold_resistance(heating, error_prefix), hot_resistance(heating)
    ambient = cold_temperature(run, heating.switch_on_time)
    ambient_temperature, ambient_std = ambient.value
    kelvin_per_ratio = (
        1.0 / copper.coefficient + ambient_temperature - copper.reference
    )  # K for a resistance twice the cold one
    late_change = late_change_of(heating, kelvin_per_ratio / cold.value)
    results = (
        cold.estimate("cold_resistance", gain),
        hot.estimate("hot_resistance", gain),
        winding_rise(cold, hot, kelvin_per_ratio, ambient_std, copper),
        late_change.value,
    )
    notes += [*ambient.notes, *late_change.notes, *calibration_notes(gains, "the resistances and not on the rise")]
    notes[:0] = unit_notes(runs, results[:1], ["line_voltage"], ["line_current"])
    plotted = plot_slice(len(heating.time), MOST_POINTS)
    plotted_rises = (heating.resistance[plotted] / cold.value - 1.0) * kelvin_per_ratio
    rise_series = Series(str(run.path), tuple(heating.time[plotted].tolist()), tuple(plotted_rises.tolist()))
    return Result(
        "winding-rise", (str(run.path),), results, tuple(notes), (Plot("time [s]", "rise [K]", (rise_series,), ()),)
    )


def heating_of(run: Run) -> HeatedResistance:
    """Return the resistance over the longest stretch with the current on.

    Raises
    ------
    NotIdentifiable : a clipped channel, too few readings, or no current.
    InputError : the resistance is not above zero.
    """
    current, voltage = run.channel("line_current", role="test"), run.channel("line_voltage", role="test")
    for channel in (current, voltage):
        refuse_clipped(run, channel)
    finite_voltage = np.isfinite(voltage.values)
    time, voltages = voltage.time[finite_voltage], voltage.values[finite_voltage]
    finite_current = np.isfinite(current.values)
    if finite_current.sum() < FEWEST_READINGS or len(time) < FEWEST_READINGS:
        raise NotIdentifiable(f"{run.path}: line_current or line_voltage of test has no readings")
    currents = np.interp(time, current.time[finite_current], current.values[finite_current])
    is_on = np.abs(currents) > max(SWITCHED_ON_SHARE * float(np.max(np.abs(currents))), 1e-3)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_on, [False]]).astype(int)))
    stretches = [
        slice(int(start) + SKIPPED_READINGS, int(stop))
        for start, stop in edges.reshape(-1, 2)
        if stop - start > FEWEST_READINGS + SKIPPED_READINGS
    ]
    if not stretches:
        raise NotIdentifiable(f"{run.path}: no current flows for {FEWEST_READINGS} readings: nothing was heated")
    longest = max(stretches, key=lambda stretch: time[stretch.stop - 1] - time[stretch.start])
    resistance = voltages[longest] / currents[longest]
    if float(np.median(resistance)) <= 0.0:
        raise InputError(
            f"{run.path}: line_voltage over line_current is {np.median(resistance):.3g} ohm; above zero was expected:"
            " one of the two has its leads swapped"
        )
    heating_start = float(time[longest.start - SKIPPED_READINGS])
    mean_current = abs(float(np.mean(currents[longest])))
    current_rounding = rounding_std(currents[longest], quantisation_step(currents[longest])) / mean_current
    return HeatedResistance(
        time[longest] - heating_start,
        resistance,
        quantisation_step(voltages[longest]) / mean_current,
        current_rounding,
        heating_start,
    )


def cold_resistance(heating: HeatedResistance, error_prefix: str) -> MeasuredResistance:
    """Return the resistance extrapolated to the moment of switching on.

    Raises
    ------
    NotIdentifiable : too few readings in the first `COLD_S` of heating.
    """
    is_early = heating.time < COLD_S
    if int(np.sum(is_early)) < FEWEST_READINGS:
        raise NotIdentifiable(
            f"{error_prefix}: {np.sum(is_early)} readings in the first {COLD_S:g} s of heating; at least"
            f" {FEWEST_READINGS} are needed to lead back to the cold winding"
        )
    design = np.vander(heating.time[is_early], 3, increasing=True)
    fit = least_squares(design, heating.resistance[is_early], design, error_prefix)
    value, std = fit.combination(np.array([1.0, 0.0, 0.0]))
    limit = remaining_rounding(
        heating, heating.resistance[is_early] - fit.residuals, np.linalg.pinv(design)[0], fit.residuals
    )
    if heating.step and limit:  # the residuals contain noise and rounding; rounding counts in the limit
        std *= math.sqrt(max(0.0, 1.0 - heating.step**2 / 12.0 / max(fit.variance, 1e-30)))
    return MeasuredResistance(value, std, fit.dof, limit, heating.current_rounding)


def hot_resistance(heating: HeatedResistance) -> MeasuredResistance:
    """Return the mean resistance over the last `HOT_S` of heating."""
    is_late = heating.time >= heating.time[-1] - HOT_S
    value, std, limit = mean_where(heating, is_late)
    return MeasuredResistance(value, std, float(np.sum(is_late)) - 1.0, limit, heating.current_rounding)


def mean_where(heating: HeatedResistance, mask: npt.NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return mean, standard error and limit of the rounding error of the resistances [ohm] in a mask."""
    time, values = heating.time[mask], heating.resistance[mask]
    design = np.column_stack([np.ones_like(time), time - time.mean()])
    residual = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    limit = remaining_rounding(heating, values - residual, np.full(len(values), 1.0 / len(values)), residual)
    return float(np.mean(values)), float(np.std(residual)) / math.sqrt(max(len(values) - 2, 1)), limit


def remaining_rounding(heating: HeatedResistance, curve: Array, weights: Array, residual: Array) -> float:
    """Return the limit of the rounding error [ohm] of a weighted sum, without the part that noise averages out.

    `curve` are the resistances without noise and `residual` the noise [ohm], shape (readings,) each, as `weights`.
    """
    if heating.step <= 0.0:
        return 0.0
    noise = math.sqrt(max(0.0, float(np.var(residual)) - heating.step**2 / 12.0))
    return rounding_limit(curve, heating.step, weights) * math.exp(-2.0 * (math.pi * noise / heating.step) ** 2)


def winding_rise(
    cold: MeasuredResistance,
    hot: MeasuredResistance,
    kelvin_per_ratio: float,
    ambient_std: float,
    copper: CopperCoefficient,
) -> Estimate:
    """Estimate the rise [K] from both resistances.

    `kelvin_per_ratio` is the rise for a hot resistance of twice the cold resistance, `ambient_std` [K] the standard
    uncertainty of the temperature at which the winding was cold.

    The interval is wider on the side away from zero, since the rise is inversely proportional to the coefficient.
    """
    ratio = hot.value / cold.value
    rise = (ratio - 1.0) * kelvin_per_ratio
    resistance_std = kelvin_per_ratio * ratio * math.hypot(hot.std / hot.value, cold.std / cold.value)
    scatter_std = math.hypot(resistance_std, rise * ambient_std / kelvin_per_ratio)
    rounding_limits = [kelvin_per_ratio * ratio * resistance.limit / resistance.value for resistance in (hot, cold)]
    copper_limit = rise / kelvin_per_ratio * copper.half_range / copper.coefficient
    signed_range = math.copysign(copper.half_range, rise)
    below, above = (
        half_width(scatter_std, math.inf, copper_limit / (1.0 + signed_half_range), *rounding_limits)
        for signed_half_range in (signed_range, -signed_range)
    )
    std = math.hypot(scatter_std, *(limit / math.sqrt(3.0) for limit in (copper_limit, *rounding_limits)))
    return Estimate("winding_rise", rise, std, rise - below, rise + above, "K")


def coefficient_of(run: Run) -> CopperCoefficient:
    """Return the resistance coefficient in the model that a run carries.

    Raises
    ------
    NotIdentifiable : the model has no resistance coefficient.
    InputError : a tolerance or a reference temperature is out of range or no number.
    """
    model = model_of(run)
    coefficient = positive_number(model.get("resistance_coefficient"))
    if math.isnan(coefficient):
        raise NotIdentifiable(f"{run.path}: its model has no resistance_coefficient; a rise is not known without one")
    tolerances = model.get("tolerances")
    half_range = tolerances.get("resistance_coefficient", 0.0) if isinstance(tolerances, dict) else 0.0
    reference = model.get("reference_temperature", 25.0)
    for name, value, (low, high), unit in (
        ("tolerances.resistance_coefficient", half_range, (0.0, 0.99), ""),
        ("reference_temperature", reference, (-100.0, 1000.0), " degC"),
    ):
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise InputError(
                f"{run.path}: {name} of its model is {value}; a number from {low:g} to {high:g}{unit} was expected"
            )
    return CopperCoefficient(coefficient, float(half_range), float(reference))


def cold_temperature(run: Run, switch_on_time: float) -> Noted[tuple[float, float]]:
    """Return the temperature of the air before the time `switch_on_time` [s] and its standard uncertainty [degC]."""
    for air in run.channels(AMBIENT, "bench") or run.channels(AMBIENT):
        refuse_not_celsius(run, air)
        cold_readings = air.values[(air.time < switch_on_time) & np.isfinite(air.values)]
        if len(cold_readings):
            return Noted((float(np.mean(cold_readings)), 1.0))
    note = f"no ambient temperature before heating; taken as {ASSUMED_AMBIENT[0]:g} degC, within 6 K"
    return Noted(ASSUMED_AMBIENT, (note,))


def late_change_of(heating: HeatedResistance, kelvin_per_ohm: float) -> Noted[Estimate]:
    """Estimate the change of the rise over the last half hour of heating [K]; a note says whether it is steady.

    The mean of the last minute is compared with that of the minute half an hour before. `kelvin_per_ohm` is the rise
    for a change of the resistance.
    """
    name = "change_in_last_30_min"
    if heating.time[-1] < STEADY_S + BLOCK_S:
        note = f"heated for {heating.time[-1] / 60:.0f} min: whether it is steady shows after 31 min"
        return Noted(Estimate(name, NAN, NAN, NAN, NAN, "K"), (note,))
    heating_stop = heating.time[-1]
    (earlier, earlier_std, earlier_limit), (latest, latest_std, latest_limit) = (
        mean_where(heating, (heating.time > stop - BLOCK_S) & (heating.time <= stop))
        for stop in (heating_stop - STEADY_S, heating_stop)
    )
    value = (latest - earlier) * kelvin_per_ohm
    scatter_std = math.hypot(latest_std, earlier_std) * kelvin_per_ohm
    limits = [limit * kelvin_per_ohm for limit in (earlier_limit, latest_limit)]
    interval_half_width = half_width(scatter_std, math.inf, *limits)
    std = math.hypot(scatter_std, *(limit / math.sqrt(3.0) for limit in limits))
    estimate = Estimate(name, value, std, value - interval_half_width, value + interval_half_width, "K")
    if max(abs(estimate.low), abs(estimate.high)) <= STEADY_K:
        note = f"steady: no more than {STEADY_K:g} K in the last 30 min of heating"
    elif estimate.low > STEADY_K or estimate.high < -STEADY_K:
        note = f"no steady state: {estimate.value:+.1f} K in the last 30 min of heating"
    else:
        note = f"whether it is steady ({STEADY_K:g} K in 30 min) cannot be told from these readings"
    return Noted(estimate, (note,))
