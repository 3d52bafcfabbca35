"""Imports tell where a unit was probably taken for another, and say nothing where units are right or nobody knows."""

import json
import math

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from leactl.quantities import UNITS, ChannelSpec
from leactl.runfile.importing.checks import notes_on_units
from leactl.runfile.importing.mapping import Mapping
from leactl.runfile.importing.streams import Stream
from leactl.runfile.read.reader import Run
from tests.cli.terminal import leactl

TURN = 2.0 * math.pi
RPM = 60.0 / TURN
ROWS = 600


def notes(time, **channels):
    """What an import says of channels `quantity=values`, or `quantity=(values, units)`."""
    given_units = {name: value[1] for name, value in channels.items() if isinstance(value, tuple)}
    columns = {name: value[0] if isinstance(value, tuple) else value for name, value in channels.items()}
    mapped = {
        name: {"column": name, "quantity": name, **({"units": given_units[name]} if name in given_units else {})}
        for name in columns
    }
    streams = {"loop": {"time": {"column": "t"}, "channels": mapped}}
    mapping = Mapping.model_validate({"mechanical": "free", "streams": streams})
    specs = [ChannelSpec(name, name, "test", "d") for name in columns]
    assert all(name in UNITS for name in columns)
    stream = Stream(time, specs, [np.asarray(values, float) for values in columns.values()])
    return list(notes_on_units({"loop": stream}, mapping))


def wrapped(angle, turn, low):
    return angle if turn is None else (angle - low) % turn + low


sizes = st.floats(-4.0, 4.0).map(lambda power: 10.0**power)
signs = st.sampled_from([-1.0, 1.0])
wraps = st.sampled_from([(None, 0.0), (TURN, 0.0), (TURN, -math.pi), (32.0 * TURN, 0.0), (1.0, 0.0)])
calibrations = st.floats(0.96, 1.04)
noises = st.sampled_from([0.0, 1e-3, 0.05])


def turning(speed, rate, seed, noise, shape):
    """Stamps, true speed and true angle of a machine that turns evenly, swings, or runs up."""
    random = np.random.default_rng(seed)
    time = np.arange(ROWS) / rate
    if shape == "even":
        omega = np.full(ROWS, speed)
        angle = speed * time
    elif shape == "swings":
        phase = 5.0 * np.arange(ROWS) / ROWS * TURN
        omega = speed * np.cos(phase)
        angle = speed * time[-1] / (5.0 * TURN) * np.sin(phase)
    else:
        omega = speed * time / time[-1]
        angle = 0.5 * speed * time**2 / time[-1]
    return time, omega + noise * abs(speed) * random.standard_normal(ROWS), angle + random.uniform(0.0, TURN)


@given(
    sizes, signs, sizes, wraps, calibrations, noises, st.sampled_from(["even", "swings", "up"]), st.integers(0, 10**6)
)
@example(628.5, 1.0, 100.0, (TURN, 0.0), 1.0, 0.0, "even", 1)  # a little more than that: it seems to turn slowly
@example(628.3185307179587, 1.0, 100.0, (TURN, 0.0), 1.0, 0.0, "even", 1)  # whole turns from row to row
def test_velocities_in_their_units_are_never_doubted(speed, sign, rate, wrap, calibration, noise, shape, seed):
    time, omega, angle = turning(sign * speed, rate, seed, noise, shape)
    seen = wrapped(angle, *wrap)
    # what an angle wraps at is only known where it is seen to wrap, or is one turn
    assume(wrap[0] in (None, TURN) or np.ptp(seen) > 0.5 * wrap[0] or speed < 0.4 * wrap[0] * rate)
    assert notes(time, velocity=calibration * omega, angle=seen) == []


@given(
    sizes, signs, sizes, wraps, calibrations, st.sampled_from(["even", "up"]), st.sampled_from([0.0, 1e-3]),
    st.sampled_from(["rpm", "turn/s", "deg/s"]), st.integers(0, 10**6),
)  # fmt: skip
def test_a_velocity_in_another_unit_is_told_where_the_angle_can_be_unwrapped(
    speed, sign, rate, wrap, calibration, shape, noise, unit, seed
):
    factor = {"rpm": RPM, "turn/s": 1.0 / TURN, "deg/s": 360.0 / TURN}[unit]
    if wrap[0] is not None:
        speed = min(speed, 0.4 * wrap[0] * rate / max(factor, 1.0))
        assume(speed * ROWS / rate > 2.0 * wrap[0])
    time, omega, angle = turning(sign * speed, rate, seed, noise, shape)
    [note] = notes(time, velocity=calibration * factor * omega, angle=wrapped(angle, *wrap))
    assert f"loop/velocity in {unit} taken for rad/s" in note


@pytest.mark.parametrize("gear", [2.0, 3.5, 8.0, 15.0])
def test_a_gear_that_no_unit_makes_is_not_told(gear):
    time, omega, angle = turning(3.0, 100.0, 1, 1e-3, "swings")
    assert notes(time, velocity=gear * omega, angle=angle) == []


@pytest.mark.parametrize(
    ("velocity", "angle", "told"),
    [
        ((9.5493, "rad/s"), (1.0, "rad"), "loop/angle: loop/velocity in rpm taken for rad/s?"),
        ((1.0, "rad/s"), (180.0 / math.pi, "rad"), "loop/angle in deg taken for rad?"),
        (
            (9.5493, "rad/s"),
            (180.0 / math.pi, "rad"),
            "loop/velocity in rpm and loop/angle in deg, both taken for",
        ),
        ((TURN / 60.0, "rpm"), (1.0, "rad"), "loop/velocity in rad/s taken for rpm?"),
        ((1000.0, "rad/s"), (1.0, "rad"), "times the change of loop/angle: are scale and units"),
        ((50.0, "rad/s"), (1.0, "rad"), "a gear of that ratio"),
        ((0.01, "rad/s"), (1.0, "rad"), "reads 0.01001 times the change of loop/angle: are scale and units"),
        ((-1.0, "rad/s"), (1.0, "rad"), "is the sign of both right?"),
    ],
)
def test_what_is_told_of_a_velocity_and_its_angle(velocity, angle, told):
    time, omega, theta = turning(3.0, 100.0, 1, 1e-3, "swings")
    theta = np.round(theta * 1000.0) / 1000.0
    [note] = notes(time, velocity=(velocity[0] * omega, velocity[1]), angle=(angle[0] * theta, angle[1]))
    assert told in note


PAIRS = {"q_axis_current": ("A", "mA", 1e3), "velocity": ("rad/s", "rpm", RPM), "torque": ("N*m", "mN*m", 1e3)}
PAIRS["angle"] = ("rad", "deg", 360.0 / TURN)


@given(st.sampled_from(sorted(PAIRS)), st.booleans(), sizes, calibrations, st.integers(0, 10**6))
def test_a_measured_channel_in_another_unit_than_its_setpoint_is_told(quantity, turned_round, size, calibration, seed):
    units, other, factor = PAIRS[quantity]
    random = np.random.default_rng(seed)
    wanted = size * np.repeat(random.uniform(-1.0, 1.0, 12), 50)
    measured = calibration * wanted + 0.01 * size * random.standard_normal(ROWS)
    time = np.arange(ROWS) * 0.01
    assert notes(time, **{quantity: measured, f"{quantity}_reference": wanted}) == []
    which = f"{quantity}_reference" if turned_round else quantity
    columns = {quantity: measured, f"{quantity}_reference": wanted}
    columns[which] = factor * columns[which]
    [note] = notes(time, **columns)
    assert f"loop/{which} in {other} taken for {units}" in note


@pytest.mark.parametrize(
    "measured",
    [
        lambda wanted, random: 0.75 * wanted,  # lost to friction; lbf*ft for N*m would be 0.74
        lambda wanted, random: np.zeros(ROWS),
        lambda wanted, random: random.standard_normal(ROWS),
        lambda wanted, random: np.clip(wanted, -0.1, 0.1),  # at its limit
        lambda wanted, random: np.convolve(wanted, np.exp(-np.arange(ROWS) / 200.0) / 200.0)[:ROWS],  # far behind
    ],
    ids=["lossy", "dead", "noise", "limited", "lags"],
)
def test_a_loop_that_does_not_follow_is_no_unit(measured):
    random = np.random.default_rng(3)
    wanted = np.sin(np.arange(ROWS) * 0.2) * 4.0
    time = np.arange(ROWS) * 0.01
    assert notes(time, torque=measured(wanted, random), torque_reference=wanted) == []


def test_places_tell_two_shafts_apart(tmp_path):
    time, omega, angle = turning(3.0, 100.0, 1, 1e-3, "swings")
    rows = "\n".join(f"{t:.6g},{q:.8g},{w:.8g}" for t, q, w in zip(time, angle, 50.0 * omega, strict=True))
    (tmp_path / "log.csv").write_text(f"t,q,w\n{rows}\n")
    text = (
        "mechanical: free\nstreams: {loop: {time: {column: t}, channels: {"
        "q: {column: q, quantity: angle}, w: {column: w, quantity: velocity}}}}\n"
    )
    (tmp_path / "map.yaml").write_text(text)
    (tmp_path / "gear.yaml").write_text(text.replace("velocity}", "velocity, location: motor}"))
    arguments = ("runs", "import", tmp_path / "log.csv", "--map")
    done = leactl(*arguments, tmp_path / "map.yaml", "--out", tmp_path / "a")
    assert done.returncode == 0
    assert done.stdout == f"{tmp_path / 'a' / 'log.h5'}\n"
    assert done.stderr.startswith(f"note: {tmp_path / 'log.csv'}: loop/w reads 50")
    answer = json.loads(leactl(*arguments, tmp_path / "map.yaml", "--out", tmp_path / "b", "--json").stdout)
    assert [f"note: {note}\n" for note in answer["notes"]] == [done.stderr]
    with Run.open(tmp_path / "a" / "log.h5") as run:
        assert [event.message for event in run.events if event.level == "warning"] == answer["notes"]
    silent = leactl(*arguments, tmp_path / "gear.yaml", "--out", tmp_path / "c")
    assert (silent.returncode, silent.stderr) == (0, "")
