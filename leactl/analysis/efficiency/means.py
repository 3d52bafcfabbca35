"""Means over the map with their uncertainty: scatter of the readings, the sensor's zero in each run, calibrations.

Every figure is a mean over points of something that follows from a point's readings. What moves one reading moves one
point; what moves a calibration or a zero moves all of them together, so each is moved by its standard uncertainty and
the figure is looked at again (GUM, 5.1.3, note 2). Passes through the grid that lie further apart than that explains
have the uncertainty of their mean instead.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from leactl.analysis.efficiency.balance import Balance, PowerCalibration, balance
from leactl.analysis.efficiency.operating_points import OperatingPoints
from leactl.analysis.estimate import NAN, Estimate, listed
from leactl.analysis.statistics.regression import POOLED_ABOVE, Array, t_quantile


class MapMeans:
    """One actuator's map, driving or driven: its points, their powers, and means over those that were held."""

    def __init__(
        self, points: OperatingPoints, role: str, driving: bool, told: PowerCalibration, stds: Mapping[str, float]
    ) -> None:
        self.points, self.role, self.driving = points, role, driving
        self._told, self._stds = told, stds
        self.balance = self._balance(points, told)
        self.held = np.isfinite(self.balance.efficiency)
        setpoints = np.array([(one.speed, one.current) for one in points.holds])
        self.speeds, self.currents = np.unique(setpoints[:, 0]), np.unique(setpoints[:, 1])
        self.places = np.searchsorted(self.speeds, setpoints[:, 0]), np.searchsorted(self.currents, setpoints[:, 1])
        self.counts = np.zeros((len(self.speeds), len(self.currents)))
        np.add.at(self.counts, self.places, self.held)

    @property
    def reached(self) -> int:
        """Number of points of the grid that were held at least once."""
        return int(np.sum(self.counts > 0))

    @cached_property
    def weights(self) -> Array:
        """Of each hold in a mean over the map: every point counts once, whatever its repeats."""
        own = np.where(self.held, self.counts[self.places], np.inf)
        return np.asarray(1.0 / own / self.reached)

    def over_map(self, what: str, column: Array | None = None) -> Array:
        """A quantity at each point, shape (speeds, currents), the mean of its repeats; NaN where none was held."""
        found = getattr(self.balance, what) if column is None else column
        total = np.zeros_like(self.counts)
        np.add.at(total, self.places, np.where(self.held, found, 0.0))
        with np.errstate(invalid="ignore"):
            return np.asarray(total / np.where(self.counts > 0, self.counts, np.nan))

    def std_over_map(self, what: str) -> Array:
        """Standard uncertainty at each point."""
        nominal = self.over_map(what)
        square = sum(self.over_map(what, change**2) for change in self._changes_of_one(what)) / np.fmax(
            self.counts, 1.0
        )
        together = [self.over_map(what, column) - nominal for column in self._moved_together(what)]
        return np.sqrt(square + sum(change**2 for change in together))

    def mean(self, what: str, name: str, units: str) -> Estimate:
        """Mean over the map of a quantity of `Balance`."""
        value = self._weighed(getattr(self.balance, what))
        apart = sum(
            float(np.sum((self.weights * np.where(self.held, change, 0.0)) ** 2))
            for change in self._changes_of_one(what)
        )
        zeros = sum((self._weighed(column) - value) ** 2 for column in self._moved_zeros(what))
        variance, dof = self._by_passes(what, apart + zeros)
        shared = sum((self._weighed(column) - value) ** 2 for column in self._moved_calibrations(what))
        std = math.sqrt(variance + shared)
        effective = dof * (std**2 / variance) ** 2 if variance > 0.0 else math.inf
        half = t_quantile(effective) * std
        return Estimate(name, value, std, value - half, value + half, units)

    def spread(self, name: str) -> Estimate:
        """Standard deviation of the efficiency over the map, what the paper prints three of."""
        return Estimate(
            name, float(np.nanstd(self.over_map("efficiency"), ddof=1)) if self.reached > 1 else NAN, NAN, NAN, NAN, "1"
        )

    def highest(self, name: str) -> Estimate:
        """The best point of the map with the uncertainty of that point."""
        found = self.over_map("efficiency")
        best = np.unravel_index(int(np.nanargmax(found)), found.shape)
        value, std = float(found[best]), float(self.std_over_map("efficiency")[best])
        half = t_quantile(math.inf) * std
        return Estimate(name, value, std, value - half, value + half, "1")

    def remarks(self, whose: str) -> list[str]:
        """Which points have no value, and which were held less often than others."""
        notes = []
        whole = self.counts.size
        if self.reached < whole:
            absent = [
                f"{self.speeds[row]:g} rad/s {self.currents[column]:g} A"
                for row, column in np.argwhere(self.counts == 0)
            ]
            notes.append(f"{whose}: {self.reached} of {whole} points were held; no value at {listed(absent, 6)}")
        asked = np.zeros_like(self.counts)
        np.add.at(asked, self.places, 1.0)
        fewer = int(np.sum((self.counts > 0) & (self.counts < asked.max())))
        if fewer:
            notes.append(
                f"{whose}: {fewer} points have fewer than {asked.max():g} repeats; each point counts once all the same"
            )
        return notes

    def _weighed(self, column: Array) -> float:
        return float(np.sum(self.weights * np.where(self.held, column, 0.0)))

    def _balance(self, points: OperatingPoints, told: PowerCalibration) -> Balance:
        return balance(points, self.role, self.driving, told)

    def _changes_of_one(self, what: str) -> list[Array]:
        """What each hold's readings being off by their standard error does to a quantity there."""
        nominal = getattr(self.balance, what)
        moved = [self._balance(self.points.shifted(place), self._told) for place in self.points.std]
        return [np.nan_to_num(getattr(one, what) - nominal) for one in moved]

    def _moved_together(self, what: str) -> list[Array]:
        return [*self._moved_zeros(what), *self._moved_calibrations(what)]

    def _moved_zeros(self, what: str) -> list[Array]:
        zeros = [{run: float(std)} for run, std in enumerate(self.points.zero_std)]
        return [getattr(self._balance(self.points, replace(self._told, zero=zero)), what) for zero in zeros]

    def _moved_calibrations(self, what: str) -> list[Array]:
        moved = [replace(self._told, **{name: getattr(self._told, name) + std}) for name, std in self._stds.items()]
        return [getattr(self._balance(self.points, told), what) for told in moved]

    def _by_passes(self, what: str, explained: float) -> tuple[float, float]:
        """Variance and degrees of freedom of the mean, from the passes where they scatter more than is explained."""
        column = getattr(self.balance, what)
        labels = np.array([(one.run, one.pass_number) for one in self.points.holds])
        means = []
        for label in np.unique(labels, axis=0):
            own = np.all(labels == label, axis=1)
            if self.held[own].sum() == self.reached:
                means.append(float(np.mean(column[own & self.held])))
        if len(means) < 2:
            return explained, math.inf
        from scipy.special import chdtrc

        dof, found = len(means) - 1, float(np.var(means, ddof=1)) / len(means)
        if found <= explained or (explained > 0.0 and chdtrc(dof, dof * found / explained) > POOLED_ABOVE):
            return explained, math.inf
        return found, dof
