"""A shaft with play between actuator and sensor, locked: where the rotor rests, and what tells the width."""

from itertools import pairwise

import numpy as np
import pytest

from leactl.effects import library
from leactl.gap.replay import replay
from leactl.gap.search.effect_regression import Evidence
from tests.gap.synthetic import FRICTION, INTERVAL_S, model, record

WIDTH, STIFFNESS = 0.004, 3000.0
BENCH = {"bench": {"shaft_stiffness": STIFFNESS}}


def staircase(*levels, seconds=2.0):
    """Currents held one after the other, with ramps between them that set nothing swinging."""
    held, ramp = round(seconds / INTERVAL_S), round(1.0 / INTERVAL_S)
    parts = [np.concatenate([np.linspace(a, b, ramp), np.full(held, b)]) for a, b in pairwise((0.0, *levels))]
    return np.concatenate(parts)


def locked(current, **channels):
    fast = {("q_axis_current", "test"): current} | {(name, "test"): values for name, values in channels.items()}
    return record("locked", current, len(current) * INTERVAL_S, fast=fast)


def test_a_locked_rotor_rests_on_the_flank_that_its_torque_presses_in_every_stretch():
    current = staircase(12.0, 6.0, -12.0, -6.0)
    effect = {"effects": [{"effect": "backlash", "parameters": {"width": WIDTH}}]}
    job = replay(locked(current), model(**BENCH, **effect))
    at = job.angle[:: job.parts][: len(current)]
    carried = job.torque[:: job.parts][: len(current)]
    engaged = np.abs(carried) > FRICTION
    wanted = carried / STIFFNESS + 0.5 * WIDTH * np.sign(carried)
    off = (at - wanted)[engaged]
    np.testing.assert_allclose(off, np.mean(off), atol=0.02 * WIDTH)


@pytest.mark.parametrize("width", [0.001, WIDTH, 0.02])
def test_a_locked_run_tells_the_width_by_its_flanks_alone(width):
    current = staircase(12.0, 6.0, -12.0, -6.0, 9.0)
    sound = replay(locked(current), model(**BENCH))
    torque = np.nan_to_num(sound.torque[:: sound.parts][: len(current)])
    flank = np.where(np.abs(torque) > 0.5 * FRICTION, np.sign(torque), 0.3)  # anywhere where nothing presses
    noise = 2e-5 * np.random.default_rng(1).standard_normal(len(torque))
    run = locked(current, angle=torque / STIFFNESS + 0.5 * width * flank + noise, torque=torque)
    [rows] = [rows for rows in Evidence([run], model(**BENCH)).stack.rows if rows.equation == "lock"]
    columns = {name: column for name, column in rows.columns.items() if name[0] != "effect"}
    played = {name: column for name, column in rows.columns.items() if name[:2] == ("effect", "backlash")}
    for name, column in played.items():
        assert name[-1] == "width"
        table = np.column_stack([*columns.values(), column])
        *_, found = np.linalg.lstsq(table, rows.left_over, rcond=None)[0]
        assert found == pytest.approx(width, rel=0.03)
    assert played


def test_of_a_locked_run_and_a_turning_one_the_locked_one_has_the_width():
    effect = library()["backlash"]
    told = {"width": 0.004, "crossed": 0.0025}
    assert effect.parameters((0.05,), told, model()) == {"width": 0.004}
    assert effect.parameters((0.05,), {"crossed": 0.0025}, model()) == {"width": 0.0025}
