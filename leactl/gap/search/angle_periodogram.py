"""Search orders of the angle: a periodogram over whole turns of the residuals of torque equations.

Every order is tried against the same residual, so that the strongest has to exceed the maximum of as many orders of
noise; the caller accounts for that by the number tried.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.gap.equations.contract import FEWEST_ROWS
from leactl.gap.search.regression import Candidate, Fit, Rows, Stack, residuals
from leactl.gap.signals.smoothing import BASE_WIDTH

Array = npt.NDArray[np.float64]
TORQUE_EQUATIONS = ("free_torque", "axis_torque", "both_torque", "coupled_torque")
CREEP_WIDTH = 1.0  # samples, smoothing of a creeping axis
MOST_CYCLES_PER_SAMPLE = 0.35  # cycles of an order in a sample, above which smoothing removes its column
FEWEST_PERIODS = 2.0  # periods in a run with which a wave differs from a bend
LEAKAGE_ORDERS = 1  # difference of orders up to which the weaker one is leakage of the stronger one


def strongest_orders(stacked: Stack, fit: Fit, weights: Sequence[float], count: int) -> list[Candidate]:
    """Return the `count` strongest orders of every periodic effect in the residual of a fit, as forms to try."""
    candidates: list[Candidate] = []
    for effect in library().values():
        if not effect.periodic:
            continue
        low, high = effect.orders
        power, creeping_rows = np.zeros(high + 1), []
        untried_orders = np.arange(high + 1) >= low
        for index, rows in enumerate(stacked.rows):
            if rows.equation in TORQUE_EQUATIONS and can_show_waves(rows, effect.periodic):
                residual = residuals(stacked, fit, index)
                power += weights[index] * periodogram(rows, residual, effect.periodic, high)
                if "creep" in rows.signals.extra:
                    creeping_rows.append((rows, residual, weights[index]))
        for _ in range(count):
            order = int(np.argmax(power * untried_orders))
            if not untried_orders[order] or power[order] <= 0.0:
                break
            candidates.append((effect.name, (float(order),)))
            for position, (rows, residual, weight) in enumerate(creeping_rows):
                # a creeping axis dwells longer at some angles, so that a strong order leaks into others
                remaining = without_order(rows, residual, order)
                power_change = periodogram(rows, remaining, effect.periodic, high) - periodogram(
                    rows, residual, effect.periodic, high
                )
                power += weight * power_change
                creeping_rows[position] = (rows, remaining, weight)
            untried_orders[max(order - LEAKAGE_ORDERS, 0) : order + LEAKAGE_ORDERS + 1] = False
    return candidates


def can_show_waves(rows: Rows, place: str) -> bool:
    """Return whether rows have an angle, and the current if the effect is a ripple of the torque.

    place : place of the equations that the effect acts in.
    """
    signals = rows.signals
    return signals.angle is not None and (place != "torque_factor" or signals.current is not None)


def without_order(rows: Rows, residual: Array, order: int) -> Array:
    """Return a residual without its part at one order of the angle."""
    assert rows.signals.angle is not None
    phase = order * rows.signals.angle[rows.index]
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    return np.asarray(residual - waves @ np.linalg.lstsq(waves, residual, rcond=None)[0], np.float64)


def periodogram(rows: Rows, residual: Array, place: str, highest_order: int) -> Array:
    """Return the squares of a residual that a wave of each order explains, from order 0 to the highest.

    place : place of the equations that the wave acts in; a ripple of the torque scales with the current.
    """
    signals = rows.signals
    assert signals.angle is not None and signals.velocity is not None
    angle, speed = signals.angle[rows.index], np.abs(signals.velocity[rows.index])
    torque_scale = np.ones_like(angle)
    if place == "torque_factor":
        assert signals.current is not None
        torque_scale = (signals.model.torque_constant or 0.0) * signals.current[rows.index]
    cycles = speed * signals.interval / (2 * np.pi)  # of order one, a sample
    width = math.hypot(BASE_WIDTH, rows.width)
    if "creep" in signals.extra:
        # a creeping axis steps and rests: the mean speed of the run counts
        cycles, width = np.full_like(cycles, np.mean(cycles)), CREEP_WIDTH
    unit_phasor = np.exp(1j * angle)
    phasor = np.ones_like(unit_phasor)
    powers = np.zeros(highest_order + 1)
    lowest_order = FEWEST_PERIODS * 2 * np.pi / max(float(np.ptp(angle)), 1e-9)
    for order in range(1, highest_order + 1):
        phasor = phasor * unit_phasor
        if order < lowest_order:
            continue
        cycles_of_order = order * cycles
        visibility = np.exp(-0.5 * (2 * np.pi * cycles_of_order) ** 2 * width**2) * (
            cycles_of_order < MOST_CYCLES_PER_SAMPLE
        )
        power = visibility**2
        if float(power.sum()) ** 2 < FEWEST_ROWS * float(power @ power):
            continue  # too few rows are slow enough to show this order
        visible_scale = torque_scale * visibility
        wave_energy = float(np.sum(visible_scale**2)) / 2.0
        if wave_energy > 1e-12:
            powers[order] = abs(np.sum(residual * visible_scale * phasor)) ** 2 / (2.0 * wave_energy)
    return powers
