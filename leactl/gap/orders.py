"""Which orders of the angle stand out: a periodogram of what torque equations leave over, over whole turns.

Every order is tried against the same residual, so that the strongest must beat what the strongest of as many orders of
noise would reach; the caller accounts for that by the number tried.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.gap.regression import Candidate, Fit, Rows, Stack, residuals

Array = npt.NDArray[np.float64]
TORQUE = ("free_torque", "axis_torque", "both_torque", "coupled_torque")
WIDTH = 4.5  # samples, the smoothing of a torque equation's rows
FINEST = 0.35  # cycles a sample, beyond which a column has been smoothed away
APART = 1  # orders this close to a stronger one are its leakage


def strongest(stacked: Stack, fit: Fit, weights: Sequence[float], count: int) -> list[Candidate]:
    """The strongest orders of every periodic effect against the residual of a fit."""
    found: list[Candidate] = []
    for effect in library().values():
        if not effect.periodic:
            continue
        low, high = effect.orders
        power = np.zeros(high + 1)
        for index, rows in enumerate(stacked.rows):
            if rows.equation in TORQUE:
                left = residuals(stacked, fit, index)
                power += weights[index] * periodogram(rows, left, effect.periodic, high)
        power[:low] = 0.0
        for _ in range(count):
            order = int(np.argmax(power))
            if power[order] <= 0.0:
                break
            found.append((effect.name, (float(order),)))
            power[max(order - APART, 0) : order + APART + 1] = 0.0
    return found


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
    turn = np.exp(1j * angle)
    wave = np.ones_like(turn)
    out = np.zeros(highest + 1)
    for order in range(1, highest + 1):
        wave = wave * turn
        rate = order * cycles
        gain = size * np.exp(-0.5 * (2 * np.pi * rate) ** 2 * WIDTH**2) * (rate < FINEST)
        energy = float(np.sum(gain**2)) / 2.0
        if energy > 1e-12:
            out[order] = abs(np.sum(left * gain * wave)) ** 2 / (2.0 * energy)
    return out
