"""Pictures of mended channels: one channel of one role each, over the time of its own run."""

from dataclasses import replace

import numpy as np

from leactl.gap.setup.mended_picture import mended_picture
from tests.gap.spoilt_setups import with_values
from tests.gap.synthetic import clocked, model, record

VELOCITY, LOAD_VELOCITY = ("velocity", "test"), ("velocity", "load")
SPEED, SECONDS = 8.0, 10.0  # rad/s, s


def swinging(interval=1e-3, mechanical="coupled"):
    """A run whose shaft swings, with the velocity of both actuators."""
    time = interval * np.arange(round(SECONDS / interval))
    velocity = SPEED * np.sin(2.0 * time)
    channels = {VELOCITY: velocity, ("angle", "test"): -0.5 * SPEED * np.cos(2.0 * time)}
    if mechanical == "coupled":
        channels[LOAD_VELOCITY] = velocity
    return replace(record(mechanical), fast=clocked(len(time), interval, channels))


def test_a_reversed_load_velocity_is_drawn_as_the_loads_beside_a_bad_velocity_of_the_test_actuator():
    mended = with_values(swinging(), {VELOCITY: 0.0 * swinging().fast.values[VELOCITY]})
    logged = with_values(mended, {LOAD_VELOCITY: -mended.fast.values[LOAD_VELOCITY]})
    picture, share = mended_picture("channel_sign", [logged], [mended], model())
    assert (picture.quantity, picture.role) == LOAD_VELOCITY
    assert share > 0.99


def test_runs_of_different_rates_are_drawn_over_their_own_time():
    mended = [swinging(interval, "free") for interval in (1e-3, 0.02)]
    late = [np.roll(run.fast.values[VELOCITY], round(0.1 / run.fast.interval)) for run in mended]
    logged = [with_values(run, {VELOCITY: values}) for run, values in zip(mended, late, strict=True)]
    picture, _ = mended_picture("clock_drift", logged, mended, model())
    assert picture.variable == "time"
    assert picture.along == "rate of change of the value expected from the angle"
    assert 0.9 * SECONDS < picture.bins[-1].high <= SECONDS
