"""Breakaway, drag and cogging from runs in which they are known."""

import math

import numpy as np
import pytest

from leactl.analysis.back_drive import analyze
from leactl.errors import NotIdentifiable

from .synthetic import analyzed, covered

F, B, C, COG, ORDER, J = 0.208, 0.0238, 1e-4, 0.03, 82, 0.0024
RATE, TURN_S, HOLD_S, BREAK_S, W = 200, 13.5, 1.5, 3.0, 0.5
SPEEDS = (2.0, 5.0, 10.0, 20.0, 30.0)


class Record:
    """Columns that grow part by part; the test actuator's angle goes on from part to part."""

    def __init__(self):
        self.parts, self.steps, self.now, self.angle = [], [], 0.0, 0.3

    def add(self, name, speed, torque, settle=0.0, **told):
        """One step: speed [rad/s] at every sample, and torque onto the shaft by angle and speed."""
        angle = self.angle + np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) / RATE
        self.parts.append((speed, angle, torque(angle)))
        self.steps.append((name, self.now, self.now + len(speed) / RATE, settle, {"role": "load"} | told))
        self.now += len(speed) / RATE
        self.angle = angle[-1] + speed[-1] / RATE


def driven(bench, *, f=F, b=B, c=C, cogging=COG, breakaway=0.25, zero=0.02, noise=0.004, signs=(1, -1), trials=2,
           ripple=0.05, enabled=0.0, turn_s=TURN_S, lets_go=True, speeds=SPEEDS, edit=None, inertia=J):  # fmt: skip
    """A run: for each trial and sign a breakaway, a slow turn whose speed ripples with the cogging, and levels."""
    record = Record()
    for sign in [sign for _ in range(trials) for sign in signs]:
        time = np.arange(round(BREAK_S * RATE)) / RATE
        moved = 2.5 if lets_go else BREAK_S
        speed = np.where(time > moved, 12.5 * sign * (time - moved) ** 2, 0.0)
        wound = np.minimum(0.1 * np.maximum(time - moved + breakaway / 0.1, 0.0), breakaway)
        record.add("breakaway", speed, lambda _angle, wound=wound, sign=sign: -sign * wound)

        time = np.arange(round(turn_s * RATE)) / RATE
        angle = record.angle + sign * W * time
        swing = -sign * ripple * np.cos(ORDER * angle)  # the cogging speeds the rotor up, whichever way it turns
        growth = ripple * ORDER * W * np.sin(ORDER * angle)

        def slow(angle, sign=sign, swing=swing, growth=growth):
            return cogging * np.sin(ORDER * angle) - f * sign - b * (sign * W + swing) - J * growth

        record.add("turn", sign * W + swing, slow, 0.0, velocity_rad_s=sign * W)
        for level in speeds:
            drag = -sign * (f + b * level + c * level**2)
            speed = np.full(round(HOLD_S * RATE), sign * level)
            record.add(
                "hold", speed, lambda angle, drag=drag: np.full_like(angle, drag), 0.5, velocity_rad_s=sign * level
            )
    speed, angle, torque = (np.concatenate(column) for column in zip(*record.parts, strict=True))
    count = 2 * math.pi / 40000
    columns = {
        "velocity": speed + bench.rng.normal(0.0, 0.002, len(speed)),
        "angle": np.round(angle / count) * count,
        "torque": torque + zero + bench.rng.normal(0.0, noise, len(speed)),
        "drive_enabled": np.full(len(speed), enabled),
    }
    if edit is not None:
        edit(columns)
    return bench.write(
        "back-drive", np.arange(len(speed)) / RATE, columns, record.steps, model=f"rotor_inertia: {inertia}\n"
    )


def test_every_part_comes_back_and_the_sensor_s_zero_in_none(bench):
    result = analyzed(analyze, driven(bench, trials=3))
    assert result.find("breakaway_torque").value == pytest.approx(0.25, rel=0.02)
    assert result.find("coulomb_friction").value == pytest.approx(F, rel=0.01)
    assert result.find("viscous_damping").value == pytest.approx(B, rel=0.01)
    assert result.find("quadratic_drag").value == pytest.approx(C, rel=0.05)
    assert result.find("breakaway_torque").std < 0.002
    assert result.find("cogging_order").value == ORDER
    assert result.find("cogging_amplitude").value == pytest.approx(COG, rel=0.02)
    assert covered(result.find("cogging_amplitude"), COG)
    assert result.find("cogging_peak_to_peak").value == pytest.approx(2 * COG, rel=0.03)


def test_what_the_rotor_takes_of_the_cogging_is_not_put_back_without_its_inertia(bench):
    result = analyzed(analyze, driven(bench, inertia=0.0))
    assert any("no rotor_inertia in its model" in note for note in result.notes)
    taken = J * 0.05 * ORDER * W
    assert result.find("cogging_amplitude").value == pytest.approx(COG - taken, rel=0.03)


def test_a_rotor_without_cogging_gets_a_bound_and_no_number(bench):
    result = analyzed(analyze, driven(bench, cogging=0.0, ripple=0.0))
    found = result.find("cogging_amplitude")
    assert math.isnan(found.value)
    assert 0.0 < found.high < 0.002
    assert any("cogging is below" in note for note in result.notes)


def test_intervals_hold_the_truth_in_95_of_100_times(bench):
    true = {"breakaway_torque": 0.25, "coulomb_friction": F, "viscous_damping": B, "cogging_amplitude": COG}
    held = dict.fromkeys(true, 0)
    for _ in range(16):
        result = analyzed(analyze, driven(bench, noise=0.02))
        for name, value in true.items():
            held[name] += covered(result.find(name), value)
    assert min(held.values()) >= 12, held  # three and a half standard deviations below 15 of 16


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"enabled": 1.0}, "the test drive was on at .* back-drive is unpowered"),
        ({"speeds": (2.0, 5.0)}, "found 2 speeds at which the shaft turned steadily; 4 or more are needed"),
    ],
)
def test_a_run_that_cannot_answer_says_why_in_one_line(bench, how, words):
    with pytest.raises(NotIdentifiable, match=words) as caught:
        analyzed(analyze, driven(bench, **how))
    assert len(caught.value.faults) == 1


def test_what_is_missing_of_turns_and_breakaways_is_said_and_the_drag_is_there(bench):
    result = analyzed(analyze, driven(bench, turn_s=6.0, lets_go=False))
    notes = "\n".join(result.notes)
    assert "are no whole turn; it tells no cogging" in notes
    assert "left out 4: the shaft did not let go: give a higher current" in notes
    assert covered(result.find("coulomb_friction"), F)
    assert {"cogging_amplitude", "breakaway_torque"}.isdisjoint(item.name for item in result.results)


def test_one_direction_has_the_sensor_s_zero_in_it_and_says_so(bench):
    result = analyzed(analyze, driven(bench, signs=(1,)))
    assert result.find("coulomb_friction").value == pytest.approx(F - 0.02, abs=0.002)
    assert any("the zero of the torque sensor is part of coulomb_friction" in note for note in result.notes)
    assert any("tell no cogging: one in each and a repeat are needed" in note for note in result.notes)


def test_a_clipped_sensor_is_named(bench):
    def clip(columns):
        columns["torque"] = np.clip(columns["torque"], -0.7, 0.7)

    result = analyzed(analyze, driven(bench, edit=clip, speeds=(2.0, 5.0, 8.0, 12.0, 30.0)))
    assert any("torque of test is saturated at" in note for note in result.notes)
    assert covered(result.find("viscous_damping"), B)
