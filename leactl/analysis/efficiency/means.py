"""Means over an efficiency map with their uncertainty: scatter, the sensor's zero in each run, calibrations.

Every result is a mean over points of a quantity computed from each point's readings. An error of one reading affects
one point; an error of a calibration or a zero affects all points together. Each input is therefore shifted by its
standard uncertainty and the result computed again (GUM, 5.1.3, note 2). If passes through the grid differ by more than
these uncertainties explain, the standard error of the mean of the passes replaces scatter and zero.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from leactl.analysis.efficiency.operating_points import OperatingPoints
from leactl.analysis.efficiency.power_balance import Balance, PowerCalibration, balance
from leactl.analysis.estimate import NAN, Estimate, listed
from leactl.analysis.statistics.regression import POOLING_P_VALUE, Array, t_quantile


class MapMeans:
    """Map of one actuator, driving or driven: its points, their powers, and means over the points that were held."""

    def __init__(
        self,
        points: OperatingPoints,
        role: str,
        driving: bool,
        calibration: PowerCalibration,
        stds: Mapping[str, float],
    ) -> None:
        self.points, self.role, self.driving = points, role, driving
        self._calibration, self._stds = calibration, stds
        self.balance = self._balance(points, calibration)
        self.held = np.isfinite(self.balance.efficiency)
        setpoints = np.array([(grid_hold.speed, grid_hold.current) for grid_hold in points.holds])
        self.speeds, self.currents = np.unique(setpoints[:, 0]), np.unique(setpoints[:, 1])
        self.cells = np.searchsorted(self.speeds, setpoints[:, 0]), np.searchsorted(self.currents, setpoints[:, 1])
        self.counts = np.zeros((len(self.speeds), len(self.currents)))
        np.add.at(self.counts, self.cells, self.held)

    @property
    def reached_points(self) -> int:
        """Return the number of points of the grid that were held at least once."""
        return int(np.sum(self.counts > 0))

    @cached_property
    def weights(self) -> Array:
        """Return the weight of each hold in a mean over the map, shape (holds,): every point has the same weight."""
        repeats = np.where(self.held, self.counts[self.cells], np.inf)
        return np.asarray(1.0 / repeats / self.reached_points)

    def over_map(self, quantity: str, column: Array | None = None) -> Array:
        """Return the mean of a quantity over the repeats of each point, shape (speeds, currents); NaN if never held.

        `column`, shape (holds,), replaces the values of the quantity.
        """
        values = getattr(self.balance, quantity) if column is None else column
        total = np.zeros_like(self.counts)
        np.add.at(total, self.cells, np.where(self.held, values, 0.0))
        with np.errstate(invalid="ignore"):
            return np.asarray(total / np.where(self.counts > 0, self.counts, np.nan))

    def std_over_map(self, quantity: str) -> Array:
        """Return the standard uncertainty of a quantity at each point, shape (speeds, currents)."""
        nominal = self.over_map(quantity)
        independent_square = sum(
            self.over_map(quantity, change**2) for change in self._changes_by_channel(quantity)
        ) / np.fmax(self.counts, 1.0)
        shifted_columns = [*self._with_shifted_zeros(quantity), *self._with_shifted_calibrations(quantity)]
        common_changes = [self.over_map(quantity, column) - nominal for column in shifted_columns]
        return np.sqrt(independent_square + sum(change**2 for change in common_changes))

    def mean(self, quantity: str, name: str, units: str) -> Estimate:
        """Estimate the mean over the map of a quantity, an attribute of `Balance`."""
        value = self._weighted_mean(getattr(self.balance, quantity))
        independent_variance = sum(
            float(np.sum((self.weights * np.where(self.held, change, 0.0)) ** 2))
            for change in self._changes_by_channel(quantity)
        )
        zero_variance = sum((self._weighted_mean(column) - value) ** 2 for column in self._with_shifted_zeros(quantity))
        variance, dof = self._variance_by_passes(quantity, independent_variance + zero_variance)
        calibration_variance = sum(
            (self._weighted_mean(column) - value) ** 2 for column in self._with_shifted_calibrations(quantity)
        )
        std = math.sqrt(variance + calibration_variance)
        effective_dof = dof * (std**2 / variance) ** 2 if variance > 0.0 else math.inf
        half_width = t_quantile(effective_dof) * std
        return Estimate(name, value, std, value - half_width, value + half_width, units)

    def spread(self, name: str) -> Estimate:
        """Return the standard deviation of the efficiency over the map; NaN for a single point.

        The paper prints three times this value.
        """
        return Estimate(
            name,
            float(np.nanstd(self.over_map("efficiency"), ddof=1)) if self.reached_points > 1 else NAN,
            NAN,
            NAN,
            NAN,
            "1",
        )

    def highest(self, name: str) -> Estimate:
        """Estimate the highest efficiency of the map."""
        efficiency = self.over_map("efficiency")
        best_point = np.unravel_index(int(np.nanargmax(efficiency)), efficiency.shape)
        value, std = float(efficiency[best_point]), float(self.std_over_map("efficiency")[best_point])
        half_width = t_quantile(math.inf) * std
        return Estimate(name, value, std, value - half_width, value + half_width, "1")

    def remarks(self, prefix: str) -> list[str]:
        """Return notes on points without a value, and on points with fewer repeats than others; `prefix` opens them."""
        notes = []
        point_count = self.counts.size
        if self.reached_points < point_count:
            absent_points = [
                f"{self.speeds[row]:g} rad/s {self.currents[column]:g} A"
                for row, column in np.argwhere(self.counts == 0)
            ]
            notes.append(
                f"{prefix}: {self.reached_points} of {point_count} points were held;"
                f" no value at {listed(absent_points, 6)}"
            )
        planned_repeats = np.zeros_like(self.counts)
        np.add.at(planned_repeats, self.cells, 1.0)
        fewer_repeats = int(np.sum((self.counts > 0) & (self.counts < planned_repeats.max())))
        if fewer_repeats:
            notes.append(
                f"{prefix}: {fewer_repeats} points have fewer than {planned_repeats.max():g} repeats; each point counts"
                " once all the same"
            )
        return notes

    def _weighted_mean(self, column: Array) -> float:
        """Return the mean over the map of the values of each hold, shape (holds,)."""
        return float(np.sum(self.weights * np.where(self.held, column, 0.0)))

    def _balance(self, points: OperatingPoints, calibration: PowerCalibration) -> Balance:
        """Return the powers of this map's actuator at points, computed with a calibration."""
        return balance(points, self.role, self.driving, calibration)

    def _changes_by_channel(self, quantity: str) -> list[Array]:
        """Return, for each channel, the change of a quantity in each hold if the mean moves by its standard error."""
        nominal = getattr(self.balance, quantity)
        balances = [self._balance(self.points.shifted(key), self._calibration) for key in self.points.std]
        return [np.nan_to_num(getattr(shifted, quantity) - nominal) for shifted in balances]

    def _with_shifted_zeros(self, quantity: str) -> list[Array]:
        """Return, for each run, a quantity in each hold if that run's zero moves by its standard uncertainty."""
        zeros = [{run: float(std)} for run, std in enumerate(self.points.zero_std)]
        return [getattr(self._balance(self.points, replace(self._calibration, zero=zero)), quantity) for zero in zeros]

    def _with_shifted_calibrations(self, quantity: str) -> list[Array]:
        """Return, for each constant, a quantity in each hold if that constant moves by its standard uncertainty."""
        nominal = self._calibration
        calibrations = [replace(nominal, **{name: getattr(nominal, name) + std}) for name, std in self._stds.items()]
        return [getattr(self._balance(self.points, calibration), quantity) for calibration in calibrations]

    def _variance_by_passes(self, quantity: str, explained_variance: float) -> tuple[float, float]:
        """Return variance and degrees of freedom of the mean over the map.

        They follow from complete passes through the grid if these scatter by more than `explained_variance`.
        """
        column = getattr(self.balance, quantity)
        pass_of_hold = np.array([(grid_hold.run, grid_hold.pass_number) for grid_hold in self.points.holds])
        pass_means = []
        for pass_label in np.unique(pass_of_hold, axis=0):
            in_pass = np.all(pass_of_hold == pass_label, axis=1)
            if self.held[in_pass].sum() == self.reached_points:
                pass_means.append(float(np.mean(column[in_pass & self.held])))
        if len(pass_means) < 2:
            return explained_variance, math.inf
        from scipy.special import chdtrc

        dof, variance = len(pass_means) - 1, float(np.var(pass_means, ddof=1)) / len(pass_means)
        if variance <= explained_variance or (
            explained_variance > 0.0 and chdtrc(dof, dof * variance / explained_variance) > POOLING_P_VALUE
        ):
            return explained_variance, math.inf
        return variance, dof
