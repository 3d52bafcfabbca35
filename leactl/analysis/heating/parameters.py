"""Parameters of network and resistance with their joint covariance, and derived results with 95 % intervals.

The covariance has four sources: noise, drift of the residuals, calibration of camera and supply, and the resolution
of the supply. A gain error of the camera scales all thermal resistances, and the capacitances by its inverse; so does
an error of the heat. The record shows neither error, so both come from the stated uncertainties of the instruments.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import NAN, Estimate
from leactl.analysis.heating.network import NETWORK_UNKNOWNS, NetworkFit
from leactl.analysis.heating.record import Array, HeatingRecord, switched_on_masks
from leactl.analysis.heating.resistance import REFERENCE_TEMPERATURE, ResistanceLine
from leactl.analysis.heating.scatter import Scatter, binned_residuals, covariance_of_sums, scatter_of
from leactl.analysis.statistics.regression import t_quantile
from leactl.model.thermal_network import Conductances

NAMES = (
    "winding_ambient_resistance",
    "winding_housing_resistance",
    "housing_ambient_resistance",
    "winding_capacitance",
    "housing_capacitance",
    "line_resistance",
    "resistance_coefficient",
)
# indices in `FittedParameters.point`
LINE_RESISTANCE, RESISTANCE_COEFFICIENT = NAMES.index("line_resistance"), NAMES.index("resistance_coefficient")
UNITS = ("K/W", "K/W", "K/W", "J/K", "J/K", "ohm", "1/K")
NOT_IDENTIFIABLE_STD = 0.5  # relative standard uncertainty from which a result counts as not identifiable
RELATIVE_STEP = 1e-4  # of central differences, over the parameter
INFORMATION_FLOOR = 1e-15  # added to the scaled information matrix, so that it can be inverted


@dataclass(frozen=True)
class Instruments:
    """Standard uncertainties of the instruments' calibration."""

    camera_offset: float  # K
    camera_gain: float  # relative, of the rise above the air
    voltage_gain: float  # relative
    current_gain: float  # relative


@dataclass(frozen=True, eq=False)
class UncertaintySource:
    """Covariance of the parameters by one source of uncertainty, and the degrees of freedom of that covariance."""

    covariance: Array
    dof: float


@dataclass(frozen=True, eq=False)
class FittedParameters:
    """Fitted parameters and the sources of their uncertainty.

    `point` has the values of `NAMES`, shape (7,), but begins with the conductance from winding to ambient [W/K].
    """

    point: Array
    sources: tuple[UncertaintySource, ...]

    @property
    def covariance(self) -> Array:
        """Return the covariance of the point, shape (7, 7)."""
        return np.asarray(sum(source.covariance for source in self.sources), np.float64)

    @property
    def network(self) -> Conductances:
        """Return the thermal network; a negative conductance counts as zero."""
        wa, wh, ha, cw, ch = self.point[:NETWORK_UNKNOWNS].tolist()
        return Conductances(max(wa, 0.0), 1.0 / wh, 1.0 / ha, cw, ch)

    def shifted(self, step: Array) -> "FittedParameters":
        """Return the parameters at a point that is shifted by `step`, shape (7,), with the same uncertainty."""
        return FittedParameters(self.point + step, self.sources)

    def estimate(self, name: str, units: str, figure: Callable[["FittedParameters"], float]) -> Estimate:
        """Estimate a positive figure that follows from the parameters.

        NaN if the figure is not positive or its standard uncertainty is half of it or more. The interval is symmetric
        in the figure's logarithm.
        """
        value, slopes = figure(self), np.zeros(len(self.point))
        steps = RELATIVE_STEP * self.point
        steps[0] = RELATIVE_STEP / self.point[2]  # relative to housing to ambient: its own conductance may be zero
        for index, step in enumerate(steps):
            shift = np.zeros(len(self.point))
            shift[index] = step
            slopes[index] = (figure(self.shifted(shift)) - figure(self.shifted(-shift))) / (2.0 * step)
        variances = [float(slopes @ source.covariance @ slopes) for source in self.sources]
        std = math.sqrt(max(sum(variances), 0.0))
        if not (value > 0.0 and std < NOT_IDENTIFIABLE_STD * value):
            return Estimate(name, NAN, NAN, NAN, NAN, units)
        dof_sum = sum(variance**2 / source.dof for variance, source in zip(variances, self.sources, strict=True))
        log_half_width = t_quantile(sum(variances) ** 2 / dof_sum if dof_sum > 0.0 else math.inf) * std / value
        return Estimate(name, value, std, value * math.exp(-log_half_width), value * math.exp(log_half_width), units)


def parallel_resistance(parameters: FittedParameters) -> float:
    """Return Rwa in parallel with Rwh + Rha [K/W]: the steady rise of the winding for each watt."""
    network = parameters.network
    return 1.0 / (network.winding_ambient + 1.0 / (1.0 / network.winding_housing + 1.0 / network.housing_ambient))


def natural_parameters(parameters: FittedParameters) -> Array:
    """Return the parameters in the order and units of `NAMES`: the first as a resistance, not as a conductance."""
    return np.concatenate([[1.0 / parameters.point[0]], parameters.point[1:]])


def natural_covariance(parameters: FittedParameters) -> Array:
    """Return the covariance of the parameters in the order and units of `NAMES`, shape (7, 7)."""
    factors = np.ones(len(parameters.point))
    factors[0] = -1.0 / parameters.point[0] ** 2
    return np.asarray(parameters.covariance * np.outer(factors, factors))


def correlation_matrix(covariance: Array) -> Array:
    """Return the correlation matrix that belongs to a covariance, of the same shape."""
    stds = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(stds, stds))


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariances of all unknowns of a network's fit, by noise and by drift, shape (unknowns, unknowns) each."""

    noise: Array
    drift: Array
    scatter: Scatter


def uncertainty(fit: NetworkFit) -> Uncertainty:
    """Return the covariance of the fit's unknowns by the noise and the drift of the residuals, and by the priors."""
    valid_frames = [np.isfinite(residual) for residual in fit.residuals]
    information = np.diag(fit.prior_weights)
    for columns, valid in zip(fit.derivatives, valid_frames, strict=True):
        for node in (0, 1):
            valid_rows = columns[node][valid[node]]
            information = information + valid_rows.T @ valid_rows
    scale = 1.0 / np.sqrt(np.diag(information))
    scaled_information = information * np.outer(scale, scale)
    inverse = np.linalg.inv(scaled_information + INFORMATION_FLOOR * np.eye(len(scaled_information))) * np.outer(
        scale, scale
    )
    times = [record.time for record in fit.records]
    bins = binned_residuals(times, fit.residuals, fit.derivatives)
    scatter = scatter_of(bins)
    noise, drift = (
        sum(column) for column in zip(*(covariance_of_sums(record_bins, scatter) for record_bins in bins), strict=True)
    )
    noise = noise + np.diag((fit.prior_weights * fit.prior_stds) ** 2)
    return Uncertainty(inverse @ noise @ inverse, inverse @ drift @ inverse, scatter)


def thermal_parameters(
    fit: NetworkFit, uncertainty: Uncertainty, line: ResistanceLine, instruments: Instruments, ambient: float
) -> FittedParameters:
    """Combine network and resistance with their sources of uncertainty; `ambient` is in degC."""
    network = np.concatenate([fit.point[:1], np.exp(fit.point[1:NETWORK_UNKNOWNS])])
    jacobian = np.diag([1.0, *network[1:]])
    point = np.concatenate([network, [line.level, line.coefficient]])

    def embedded(covariance: Array, start: int) -> Array:
        all_covariance = np.zeros((len(point), len(point)))
        all_covariance[start : start + len(covariance), start : start + len(covariance)] = covariance
        return all_covariance

    sources = [
        UncertaintySource(
            embedded(jacobian @ uncertainty.noise[:NETWORK_UNKNOWNS, :NETWORK_UNKNOWNS] @ jacobian, 0), math.inf
        ),
        UncertaintySource(
            embedded(jacobian @ uncertainty.drift[:NETWORK_UNKNOWNS, :NETWORK_UNKNOWNS] @ jacobian, 0),
            uncertainty.scatter.dof,
        ),
        UncertaintySource(embedded(line.noise, NETWORK_UNKNOWNS), math.inf),
        UncertaintySource(embedded(line.drift, NETWORK_UNKNOWNS), line.dof),
        UncertaintySource(embedded(line.timing, NETWORK_UNKNOWNS), math.inf),
    ]
    wa, wh, ha, cw, ch, level, coefficient = point
    coefficient_times_distance = coefficient * (REFERENCE_TEMPERATURE - ambient)
    rise_slopes = np.array([-wa, wh, ha, -cw, -ch, 0.0, 0.0])
    camera_slopes = rise_slopes + np.array(
        [0.0] * 5 + [-level * coefficient_times_distance, coefficient * (coefficient_times_distance - 1.0)]
    )
    offset_slopes = np.array([0.0] * 5 + [-level * coefficient, coefficient**2])
    voltage_slopes = -rise_slopes + np.array([0.0] * 5 + [level, 0.0])
    current_slopes = -rise_slopes + np.array([0.0] * 5 + [-level, 0.0])
    voltage_std = math.hypot(instruments.voltage_gain, resolution_of(fit.records, "voltage"))
    current_std = math.hypot(instruments.current_gain, resolution_of(fit.records, "current"))
    stds = instruments.camera_gain, instruments.camera_offset, voltage_std, current_std, noise_of_heat(fit.records)
    for std, slopes in zip(
        stds, (camera_slopes, offset_slopes, voltage_slopes, current_slopes, rise_slopes), strict=True
    ):
        sources.append(UncertaintySource(std**2 * np.outer(slopes, slopes), math.inf))
    return FittedParameters(point, tuple(sources))


def noise_of_heat(records: Sequence[HeatingRecord]) -> float:
    """Return the relative standard uncertainty that the noise of the supply's readings gives the mean heat."""
    heats = [record.supply.heat[is_on] for record, is_on in zip(records, switched_on_masks(records), strict=True)]
    # differences within each record only, since the heat jumps from one record to the next
    second_differences = np.concatenate([np.diff(heat, 2) for heat in heats])
    heat = np.concatenate(heats)
    noise = math.sqrt(float(np.mean(second_differences**2)) / 6.0)
    return noise / math.sqrt(len(heat)) / float(np.mean(heat))


def resolution_of(records: Sequence[HeatingRecord], name: str) -> float:
    """Return the relative standard uncertainty of the supply's readings by their resolution.

    The resolution is the smallest step between readings of any record whose noise is below that step; if no record has
    such steps, readings count as exact. It counts in records whose noise does not average the rounding out. The
    largest of these records' uncertainties is returned, since roundings at different levels need not cancel. `name`
    is `current` or `voltage`.
    """
    readings = readings_on(records, name)
    steps = [float(np.min(np.diff(np.unique(values)), initial=np.inf)) for values in readings]
    rounding_steps = [step for values, step in zip(readings, steps, strict=True) if np.std(values) < step < np.inf]
    resolution = min(rounding_steps, default=0.0)
    unaveraged_levels = [float(np.mean(values)) for values in readings if np.std(values) < resolution]
    return resolution / math.sqrt(12.0) / min(unaveraged_levels, default=np.inf)


def readings_on(records: Sequence[HeatingRecord], name: str) -> list[Array]:
    """Return the magnitudes of `current` [A] or `voltage` [V] while the current is on, for each record that heats."""
    masks = zip(records, switched_on_masks(records), strict=True)
    return [np.abs(getattr(record.supply, name)[is_on]) for record, is_on in masks if is_on.any()]
