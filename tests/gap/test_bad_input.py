"""Runs and models that tell next to nothing: a diagnosis says what it can and what it cannot, and names no effect."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from leactl.cli.main import app
from leactl.errors import InputError
from leactl.model.nominal import as_mapping
from leactl.vocabulary.effect import effect_names
from tests.gap import joints, rigs

KINDS = ("multisine", "levels", "ramp")
CLOCK_LEAPS_S = 3600.0
SLOW_HZ = 10.0


def drawn(seed):
    random = np.random.default_rng(seed)
    return joints.drawn_joint(random), random


JOINT, RANDOM = drawn(3)
MODEL = as_mapping(JOINT.model(RANDOM))
RUNS = {
    (kind, again): joints.channels(JOINT, joints.Log(), kind, RANDOM, seconds=6.0) for again in "ab" for kind in KINDS
}


def every(change):
    """All runs, their channels changed alike."""
    return {key: [change(channel) for channel in channels] for key, channels in RUNS.items()}


def with_values(make, *quantities):
    def change(channel):
        return (
            replace(channel, values=make(channel)) if channel.quantity in (quantities or rigs.QUANTITIES) else channel
        )

    return change


def half_missing(channel):
    values = channel.values.copy()
    values[np.random.default_rng(len(channel.quantity)).random(len(values)) < 0.5] = np.nan
    return values


def in_steps(channel):
    step = 2.0 * np.max(np.abs(channel.values)) / 2**12
    return np.round(channel.values / step) * step


def slowly(channel):
    thin = round(JOINT.rate / SLOW_HZ)
    return replace(channel, time=channel.time[::thin], values=channel.values[::thin], sampling="")


def leaping(channel):
    time = channel.time.copy()
    time[len(time) // 2 :] += CLOCK_LEAPS_S
    return replace(channel, time=time)


def backwards(channel):
    time = channel.time.copy()
    time[len(time) // 2 :] -= 1.0
    return replace(channel, time=time)


def mixed_with_another(*again_or_kind):
    """Runs of which some are of another machine, of other size."""
    other, random = drawn(4)
    assert not 0.5 < other.constant / JOINT.constant < 2.0
    return {
        key: joints.channels(other, joints.Log(), key[0], random, seconds=6.0)
        if all(word in key for word in again_or_kind)
        else channels
        for key, channels in RUNS.items()
    }


# of each: runs, model, the verdict that is right, if it is answered, and what the answer or the refusal says
CASES = {
    "one run": (
        {("levels", "a"): RUNS["levels", "a"]},
        MODEL,
        "calibration",
        "held out are two sixteenths of each run",
    ),
    "three samples": (
        every(lambda one: replace(one, time=one.time[:3], values=one.values[:3])),
        MODEL,
        "",
        "no channel with 50 samples or more",
    ),
    "constant channels": (
        every(with_values(lambda one: np.full_like(one.values, one.values[0]))),
        MODEL,
        "effect",
        "never changes; is the channel alive?",
    ),
    "a model without a parameter": (RUNS, {"name": "joint"}, "calibration", "the model has no rotor_inertia"),
    "a fitted run of another machine": (
        mixed_with_another("levels", "a"),
        MODEL,
        "unknown",
        "the middle one of 3 runs",
    ),
    "held-out runs of another machine": (
        mixed_with_another("b"),
        MODEL,
        "unknown",
        "times as far off the fit as in the fitted runs of its kind; are they of one machine in one state?",
    ),
    "a reference without a response": (
        every(with_values(lambda one: np.zeros_like(one.values), "q_axis_current", "velocity", "angle")),
        MODEL,
        "effect",
        "frozen_channel: q_axis_current of test stands still",
    ),
    "half of it not measured": (
        every(with_values(half_missing)),
        MODEL,
        "none",
        "a fifth or more of velocity of test was not measured",
    ),
    "12 bits": (every(with_values(in_steps)), MODEL, "calibration", "the replay of levels-b"),
    "10 Hz": (every(slowly), MODEL, "calibration", "10 samples a second are too few to replay a motion"),
    "a clock that leaps ahead": (
        every(leaping),
        MODEL,
        "calibration",
        "its clock jumps or it pauses: 3600 s of it have no rows",
    ),
    "a clock that is set back": (every(backwards), MODEL, "", "time must be finite and increase strictly"),
    "an angle that wraps": (
        every(with_values(lambda one: np.mod(one.values + np.pi, 2.0 * np.pi) - np.pi, "angle")),
        MODEL,
        "effect",
        "wrapped_channel: angle of test leaps",
    ),
}


SELDOM = {  # long: they end as another does
    "a clock that leaps ahead",
    "held-out runs of another machine",
    "12 bits",
    "10 Hz",
    "a fitted run of another machine",
}


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.long] if case in SELDOM else []) for case in CASES]
)
def test_poor_runs_are_answered_or_refused_and_no_effect_is_named(case, tmp_path):
    runs, model, verdict, told = CASES[case]
    (tmp_path / "nominal.yaml").write_text(yaml.safe_dump(model))
    for (kind, again), channels in runs.items():
        rigs.write(tmp_path / f"{kind}-{again}.h5", kind, "free", channels)
    held_out = [argument for file in sorted(tmp_path.glob("*-b.h5")) for argument in ("--held-out", str(file))]
    fitted = [str(file) for file in sorted(tmp_path.glob("*-a.h5"))]
    arguments = ["gap", "diagnose", *fitted, *held_out, "--model", str(tmp_path / "nominal.yaml"), "--json"]
    ended = CliRunner().invoke(app, arguments)
    if not verdict:
        assert isinstance(ended.exception, InputError)
        assert len(ended.exception.faults) == len(runs)
        assert all(told in fault and "\n" not in fault for fault in ended.exception.faults)
        return
    assert ended.exit_code == 0, ended.exception
    document = json.loads(ended.stdout)
    assert document["verdict"] == verdict
    assert any(told in note for note in document["notes"])
    named = [cause["effect"] for cause in document["causes"] if cause["probability"] >= 0.5]
    assert not set(named) & set(effect_names())
