"""Which orders of the angle stand out: a periodogram of what torque equations leave over, over whole turns.

Every order is tried against the same residual, so that the strongest must beat what the strongest of as many orders of
noise would reach; the caller accounts for that by the number tried.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.gap.equations.contract import FEWEST_ROWS
from leactl.gap.search.regression import Candidate, Fit, Rows, Stack, residuals
from leactl.gap.signals.smoothing import BASE

Array = npt.NDArray[np.float64]
TORQUE = ("free_torque", "axis_torque", "both_torque", "coupled_torque")
CREEP_WIDTH = 1.0  # samples, smoothing of an axis that creeps
FINEST = 0.35  # cycles a sample, beyond which a column has been smoothed away
PERIODS = 2.0  # that a run must travel through before a wave is more than a bend
APART = 1  # orders this close to a stronger one are its leakage


def strongest(stacked: Stack, fit: Fit, weights: Sequence[float], count: int) -> list[Candidate]:
    """The strongest orders of every periodic effect against the residual of a fit."""
    candidates: list[Candidate] = []
    for effect in library().values():
        if not effect.periodic:
            continue
        low, high = effect.orders
        power, creeps = np.zeros(high + 1), []
        open_orders = np.arange(high + 1) >= low
        for index, rows in enumerate(stacked.rows):
            if rows.equation in TORQUE and turns(rows, effect.periodic):
                left = residuals(stacked, fit, index)
                power += weights[index] * periodogram(rows, left, effect.periodic, high)
                if "creep" in rows.signals.extra:
                    creeps.append((rows, left, weights[index]))
        for _ in range(count):
            order = int(np.argmax(power * open_orders))
            if not open_orders[order] or power[order] <= 0.0:
                break
            candidates.append((effect.name, (float(order),)))
            for place, (rows, left, weight) in enumerate(creeps):
                # an axis dwells where it holds best: unevenly over the angle, so that strong orders show in others
                rest = without(rows, left, order)
                change = periodogram(rows, rest, effect.periodic, high) - periodogram(rows, left, effect.periodic, high)
                power += weight * change
                creeps[place] = (rows, rest, weight)
            open_orders[max(order - APART, 0) : order + APART + 1] = False
    return candidates


def turns(rows: Rows, place: str) -> bool:
    """Whether rows have an angle to be periodic in, and the current that a ripple goes with."""
    signals = rows.signals
    return signals.angle is not None and (place != "torque_factor" or signals.current is not None)


def without(rows: Rows, left: Array, order: int) -> Array:
    """A residual without what one order of the angle explains of it."""
    assert rows.signals.angle is not None
    turned = order * rows.signals.angle[rows.index]
    waves = np.stack([np.cos(turned), np.sin(turned)], axis=1)
    return np.asarray(left - waves @ np.linalg.lstsq(waves, left, rcond=None)[0], np.float64)


def periodogram(rows: Rows, left: Array, place: str, highest: int) -> Array:
    """Squares that sine and cosine of each order take from a residual, orders 0 to the highest."""
    signals = rows.signals
    assert signals.angle is not None and signals.velocity is not None
    angle, speed = signals.angle[rows.index], np.abs(signals.velocity[rows.index])
    size = np.ones_like(angle)
    if place == "torque_factor":
        assert signals.current is not None
        size = (signals.model.torque_constant or 0.0) * signals.current[rows.index]
    cycles = speed * signals.interval / (2 * np.pi)  # of order one, a sample
    width = math.hypot(BASE, rows.width)
    if "creep" in signals.extra:
        # it steps and rests: the pace of the whole run says more than that of a moment
        cycles, width = np.full_like(cycles, np.mean(cycles)), CREEP_WIDTH
    turn = np.exp(1j * angle)
    wave = np.ones_like(turn)
    out = np.zeros(highest + 1)
    lowest = PERIODS * 2 * np.pi / max(float(np.ptp(angle)), 1e-9)
    for order in range(1, highest + 1):
        wave = wave * turn
        if order < lowest:
            continue
        rate = order * cycles
        seen = np.exp(-0.5 * (2 * np.pi * rate) ** 2 * width**2) * (rate < FINEST)
        power = seen**2
        if float(power.sum()) ** 2 < FEWEST_ROWS * float(power @ power):
            continue  # too few rows are slow enough to show it
        gain = size * seen
        energy = float(np.sum(gain**2)) / 2.0
        if energy > 1e-12:
            out[order] = abs(np.sum(left * gain * wave)) ** 2 / (2.0 * energy)
    return out
