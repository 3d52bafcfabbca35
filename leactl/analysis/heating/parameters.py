"""Network and resistance with their joint covariance, and what follows from them with 95 % intervals.

Four things make the covariance: noise, drift of the residuals, calibration of camera and supply, and the resolution
of the supply. A gain of the camera scales all thermal resistances, and the capacitances by its inverse; so does an
error of the heat. Nothing in the record shows either, so they come from what is told of the instruments.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import NAN, Estimate
from leactl.analysis.heating.network import NETWORK, NetworkFit
from leactl.analysis.heating.record import Array, HeatingRecord
from leactl.analysis.heating.resistance import REFERENCE, ResistanceLine
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
UNITS = ("K/W", "K/W", "K/W", "J/K", "J/K", "ohm", "1/K")
UNKNOWN = 0.5  # relative standard uncertainty, from which on a figure is none
STEP = 1e-4  # of central differences, relative
FLOOR = 1e-15  # of the largest information, below which a direction has none


@dataclass(frozen=True)
class Instruments:
    """Standard uncertainties of the instruments' calibration."""

    camera_offset: float  # K
    camera_gain: float  # relative, of the rise above the air
    voltage_gain: float  # relative
    current_gain: float  # relative


@dataclass(frozen=True, eq=False)
class UncertaintySource:
    """One source of uncertainty: its covariance, and the degrees of freedom that is known by."""

    covariance: Array
    dof: float


@dataclass(frozen=True, eq=False)
class ThermalParameters:
    """Conductance past the housing [W/K], the other six of `NAMES`, and where their uncertainty comes from."""

    point: Array
    sources: tuple[UncertaintySource, ...]

    @property
    def covariance(self) -> Array:
        """Of the point."""
        return np.asarray(sum(one.covariance for one in self.sources), np.float64)

    @property
    def network(self) -> Conductances:
        """The thermal network; a conductance that came out below zero counts as none."""
        wa, wh, ha, cw, ch = self.point[:NETWORK].tolist()
        return Conductances(max(wa, 0.0), 1.0 / wh, 1.0 / ha, cw, ch)

    def moved(self, by: Array) -> "ThermalParameters":
        """The same somewhere else."""
        return ThermalParameters(self.point + by, self.sources)

    def estimate(self, name: str, units: str, figure: Callable[["ThermalParameters"], float]) -> Estimate:
        """A figure above zero that follows, with an interval even in its logarithm; NaN where it is not known."""
        value, slopes = figure(self), np.zeros(len(self.point))
        steps = STEP * self.point
        steps[0] = STEP / self.point[2]
        for k, step in enumerate(steps):
            by = np.zeros(len(self.point))
            by[k] = step
            slopes[k] = (figure(self.moved(by)) - figure(self.moved(-by))) / (2.0 * step)
        variances = [float(slopes @ one.covariance @ slopes) for one in self.sources]
        std = math.sqrt(max(sum(variances), 0.0))
        if not (value > 0.0 and std < UNKNOWN * value):
            return Estimate(name, NAN, NAN, NAN, NAN, units)
        shares = sum(one**2 / source.dof for one, source in zip(variances, self.sources, strict=True))
        half = t_quantile(sum(variances) ** 2 / shares if shares > 0.0 else math.inf) * std / value
        return Estimate(name, value, std, value * math.exp(-half), value * math.exp(half), units)


def parallel(known: ThermalParameters) -> float:
    """Rwa in parallel with Rwh and Rha in series [K/W]: the rise of the winding for each watt in the end."""
    n = known.network
    return 1.0 / (n.winding_ambient + 1.0 / (1.0 / n.winding_housing + 1.0 / n.housing_ambient))


def natural(known: ThermalParameters) -> Array:
    """The point with the resistance past the housing in place of its conductance."""
    return np.concatenate([[1.0 / known.point[0]], known.point[1:]])


def natural_covariance(known: ThermalParameters) -> Array:
    """Of `NAMES`, in their order and units."""
    turn = np.ones(len(known.point))
    turn[0] = -1.0 / known.point[0] ** 2
    return np.asarray(known.covariance * np.outer(turn, turn))


def correlation(covariance: Array) -> Array:
    """Covariance over both standard uncertainties."""
    spread = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(spread, spread))


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariance of all unknowns of a network's fit."""

    noise: Array
    drift: Array
    scatter: Scatter


def uncertainty(fit: NetworkFit, offset_std: float) -> Uncertainty:
    """What noise and drift leave of the unknowns of least squares, priors included."""
    seen = [np.isfinite(left) for left in fit.residuals]
    information = np.diag(fit.prior)
    for columns, there in zip(fit.columns, seen, strict=True):
        for node in (0, 1):
            kept = columns[node][there[node]]
            information = information + kept.T @ kept
    scale = 1.0 / np.sqrt(np.diag(information))
    scaled = information * np.outer(scale, scale)
    inverse = np.linalg.inv(scaled + FLOOR * np.eye(len(scaled))) * np.outer(scale, scale)
    times = [one.time for one in fit.stretches]
    parts = binned_residuals(times, fit.residuals, fit.columns)
    scatter = scatter_of(parts)
    noise, drift = (sum(column) for column in zip(*(covariance_of_sums(part, scatter) for part in parts), strict=True))
    noise = noise + np.diag((fit.prior * offset_std) ** 2)
    return Uncertainty(inverse @ noise @ inverse, inverse @ drift @ inverse, scatter)


def thermal_parameters(
    fit: NetworkFit, found: Uncertainty, line: ResistanceLine, instruments: Instruments, air: float
) -> ThermalParameters:
    """Network and resistance together; `air` is that around the actuator [degC]."""
    network = np.concatenate([fit.point[:1], np.exp(fit.point[1:NETWORK])])
    turn = np.diag([1.0, *network[1:]])
    point = np.concatenate([network, [line.level, line.coefficient]])

    def whole(covariance: Array, at: int) -> Array:
        out = np.zeros((len(point), len(point)))
        out[at : at + len(covariance), at : at + len(covariance)] = covariance
        return out

    sources = [
        UncertaintySource(whole(turn @ found.noise[:NETWORK, :NETWORK] @ turn, 0), math.inf),
        UncertaintySource(whole(turn @ found.drift[:NETWORK, :NETWORK] @ turn, 0), found.scatter.dof),
        UncertaintySource(whole(line.noise, NETWORK), math.inf),
        UncertaintySource(whole(line.drift, NETWORK), line.dof),
        UncertaintySource(whole(line.timing, NETWORK), math.inf),
    ]
    wa, wh, ha, cw, ch, level, coefficient = point
    apart = coefficient * (REFERENCE - air)
    scaled = np.array([-wa, wh, ha, -cw, -ch, 0.0, 0.0])
    camera = scaled + np.array([0.0] * 5 + [-level * apart, coefficient * (apart - 1.0)])
    offset = np.array([0.0] * 5 + [-level * coefficient, coefficient**2])
    volts = -scaled + np.array([0.0] * 5 + [level, 0.0])
    amperes = -scaled + np.array([0.0] * 5 + [-level, 0.0])
    volts_std = math.hypot(instruments.voltage_gain, resolution_of(fit.stretches, "voltage"))
    amperes_std = math.hypot(instruments.current_gain, resolution_of(fit.stretches, "current"))
    stds = instruments.camera_gain, instruments.camera_offset, volts_std, amperes_std, noise_of_heat(fit.stretches)
    for std, slopes in zip(stds, (camera, offset, volts, amperes, scaled), strict=True):
        sources.append(UncertaintySource(std**2 * np.outer(slopes, slopes), math.inf))
    return ThermalParameters(point, tuple(sources))


def noise_of_heat(stretches: Sequence[HeatingRecord]) -> float:
    """What the noise of the supply's readings leaves open of the mean heat, relative."""
    heat = np.concatenate([one.supply.heat[one.supply.on] for one in stretches])
    noise = math.sqrt(float(np.mean((heat[2:] - 2.0 * heat[1:-1] + heat[:-2]) ** 2)) / 6.0)
    return noise / math.sqrt(len(heat)) / float(np.mean(heat))


def resolution_of(stretches: Sequence[HeatingRecord], name: str) -> float:
    """What resolution leaves open of readings while on that neither noise nor drift moves over a step, relative.

    Readings that are the same throughout do not show their step, and count as exact.
    """
    values = np.concatenate([np.abs(getattr(one.supply, name)[one.supply.on]) for one in stretches])
    step = float(np.min(np.diff(np.unique(values)), initial=np.inf))
    return float(step / math.sqrt(12.0) / np.mean(values)) if np.std(values) < step < np.inf else 0.0
