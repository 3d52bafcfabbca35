"""Rows of a free rotor that touch a reversal are an equation of their own, which shows how friction builds up."""

import numpy as np
import pytest

from leactl.gap.equations import equations
from leactl.gap.equations.contract import usable_rows
from leactl.gap.signals.smoothing import KERNEL_REACH, thinned_rows
from tests.gap.synthetic import INTERVAL_S, model, record

COUNT = 2.0 * np.pi / 16384


def rows_over(angle):
    """Samples that the rows of both equations are centred on, of a rotor that turns so."""
    run = record("free", reference=1.0, seconds=len(angle) * INTERVAL_S)
    run.fast.values["angle", "test"][:] = np.round(angle / COUNT) * COUNT
    run.fast.values["velocity", "test"][:] = np.gradient(angle, INTERVAL_S)
    built = {equation.name: equation for equation in equations(run, model())}
    balance, reversal = built["free_torque"], built["reversal_torque"]
    assert (balance.width, balance.step) == (reversal.width, reversal.step)
    index = thinned_rows(len(balance.left_over), balance.width, balance.step)
    return index[usable_rows(balance)], index[usable_rows(reversal)], int(KERNEL_REACH * balance.width)


def going(*speeds):
    """Angle of a rotor that goes at these speeds for 0.4 s each, and changes over 0.1 s."""
    times = np.concatenate([[0.5 * k, 0.5 * k + 0.4] for k in range(len(speeds))])
    time = np.arange(0.0, times[-1], INTERVAL_S)
    return np.cumsum(np.interp(time, times, np.repeat(speeds, 2))) * INTERVAL_S


def test_no_row_counts_twice_and_each_touches_what_it_is_of():
    turning, reversing, reach = rows_over(going(3.0, -3.0, 3.0, -3.0))
    assert not set(turning) & set(reversing)
    turns = [450, 950, 1450]  # samples at which the speed goes through zero
    assert all(min(abs(row - turn) for turn in turns) < 2 * reach for row in reversing)
    assert all(min(abs(row - turn) for row in reversing) <= 8 for turn in turns)
    assert all(min(abs(row - turn) for turn in turns) > reach for row in turning)


@pytest.mark.parametrize(
    "speeds", [(3.0, 0.0, -3.0), (3.0, 0.0, 3.0)], ids=["a rest before it turns back", "a rest on the way"]
)
def test_a_rotor_that_rests_tells_nothing_of_friction(speeds):
    turning, reversing, _reach = rows_over(going(*speeds))
    resting = range(510, 890)
    assert not (set(turning) | set(reversing)) & set(resting)


def test_a_rotor_that_nearly_stops_and_goes_on_does_not_turn_back():
    time = np.arange(0.0, 2.0, INTERVAL_S)
    _turning, reversing, _reach = rows_over(np.cumsum(3.0 * np.abs(np.cos(np.pi * time))) * INTERVAL_S)
    assert len(reversing) == 0
