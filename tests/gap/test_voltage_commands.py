"""A motor without a logged current whose voltage is the command itself: exact, in steps or smooth."""

import math

import numpy as np
import pytest

from leactl.gap.diagnose import Case, diagnose, hold_out_runs
from leactl.gap.signals.record import build_record
from leactl.model.nominal import Model
from leactl.runfile.read.reader import Channel

RATE, PARTS, SECONDS = 100.0, 10, 20.0
CONSTANT, RESISTANCE, INERTIA, DAMPING, FRICTION = 0.9, 0.8, 0.03, 0.01, 0.15
COUNT = 2.0 * math.pi / 65536
MODEL = Model(
    name="wheel",
    winding="wye",
    torque_constant=CONSTANT,
    back_emf_constant=CONSTANT,
    phase_resistance=RESISTANCE,
    rotor_inertia=INERTIA,
    viscous_damping=DAMPING,
    coulomb_friction=FRICTION,
)


def command(kind, random):
    """Voltages of a run: a slow ramp both ways, steps between eight levels, or a smooth random course."""
    time = np.arange(round(SECONDS * RATE)) / RATE
    if kind == "ramp":
        return 6.0 * np.sin(2.0 * np.pi * time / SECONDS)
    if kind == "steps":
        return np.repeat(random.choice([-7.5, -5.0, -2.5, 0.0, 2.5, 5.0, 7.5], len(time) // 50), 50)
    frequencies, phases = random.uniform(0.2, 3.0, 8), random.uniform(0.0, 2.0 * np.pi, 8)
    return 2.0 * np.sum([np.sin(2.0 * np.pi * f * time + p) for f, p in zip(frequencies, phases, strict=True)], axis=0)


def recorded(folder, name, kind, random, torque):
    """A run of the wheel; `torque` is what the model lacks [N*m], of time, angle and speed."""
    volts, step = command(kind, random), 1.0 / RATE / PARTS
    angle = speed = time = 0.0
    angles = []
    for value in volts.tolist():
        for _ in range(PARTS):
            drive = CONSTANT * (value - CONSTANT * speed) / RESISTANCE - DAMPING * speed + torque(time, angle, speed)
            ahead, held = speed + drive * step / INERTIA, FRICTION * step / INERTIA
            speed = ahead - min(max(ahead, -held), held)
            angle += speed * step
            time += step
        angles.append(angle)
    stamps = (1.0 + np.arange(len(volts))) / RATE
    channels = [
        Channel(stamps, volts, "q_axis_voltage", "test", "V", "", "", "", "mean", "loop"),
        Channel(
            stamps, np.round(np.array(angles) / COUNT) * COUNT, "angle", "test", "rad", "", "", "", "instant", "loop"
        ),
    ]
    return build_record(folder / f"{name}.h5", kind, "free", channels, {})


def case(folder, torque=lambda *_: 0.0):
    random = np.random.default_rng(5)
    records = [
        recorded(folder, f"{kind}-{k}", kind, random, torque) for kind in ("ramp", "steps", "random") for k in "ab"
    ]
    return Case(MODEL, *hold_out_runs(records))


def end_stop(_time, angle, _speed):
    return -2.0 * max(angle - 3.0, 0.0)


def tide(time, _angle, _speed):
    return FRICTION * math.sin(2.0 * math.pi * 0.9 * time)


def test_a_sound_wheel_is_called_so(tmp_path):
    diagnosis = diagnose(case(tmp_path))
    assert diagnosis.verdict in ("none", "calibration")
    assert not diagnosis.causes


@pytest.mark.parametrize("torque", [end_stop, tide])
def test_what_no_effect_explains_is_unknown(tmp_path, torque):
    diagnosis = diagnose(case(tmp_path, torque))
    assert (diagnosis.verdict, [cause.effect for cause in diagnosis.causes if cause.probability >= 0.5]) == (
        "unknown",
        [],
    )


def test_an_asymmetric_friction_is_named(tmp_path):
    diagnosis = diagnose(case(tmp_path, lambda _time, _angle, speed: -0.4 * FRICTION * (speed > 0.0)))
    assert [cause.effect for cause in diagnosis.causes if cause.probability >= 0.5] == ["asymmetric_friction"]
