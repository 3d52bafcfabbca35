"""What is left over of a bench's own runs, described: bursts that a servo answers are no function of its current."""

import numpy as np
import pytest

from leactl.gap.diagnosis import Near
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.signals.record import read_record
from leactl.gap.verdict.unknown import describe
from leactl.model.nominal import read_model

FREE = ("free_torque", "velocity", "free")
HUM_HZ = 6.37
NEAR = (Near("stribeck", "it was tried"), Near("emissivity_bias", "it touches no torque"))


def burst(record, seed):
    """The current that a servo adds where friction rises now and then, its motion as it was."""
    values = record.fast.values["q_axis_current", "test"]
    speed = np.gradient(record.fast.values["angle", "test"])
    there = np.random.default_rng(seed).random(len(values) // 400 + 1) < 0.1
    values += 1.5 * np.repeat(there, 400)[: len(values)] * np.sign(speed)


def drag(record, seed):
    """The current that a servo adds against a drag over speed that no effect has the form of."""
    speed = np.gradient(record.fast.values["angle", "test"], record.fast.interval)
    record.fast.values["q_axis_current", "test"] += 0.15 * np.sin(speed / 4.0)


def hum(record, seed):
    """The current that a servo adds against a pump that shakes the bench, in each run from another moment on."""
    time = record.fast.time
    record.fast.values["q_axis_current", "test"] += 0.3 * np.sin(2.0 * np.pi * HUM_HZ * time + seed)


@pytest.mark.parametrize(
    ("rest", "depends_on", "shapes"), [(burst, (), 0), (drag, ("velocity",), 1), (hum, ("time",), 0)]
)
def test_a_free_rotor_s_current_explains_nothing_by_being_what_is_missing(sound_bench, rest, depends_on, shapes):
    records = [read_record(sound_bench / f"free_velocity-{side}.h5") for side in "ab"]
    for seed, record in enumerate(records):
        rest(record, seed)
    evidence = Evidence(records[:1], read_model(sound_bench / "nominal.yaml")[0])
    result = describe(evidence, [], FREE, records[1:], NEAR)
    assert result.depends_on == depends_on
    assert len(result.shapes) == shapes
    assert (result.closable > 0.8) is bool(shapes)
    assert result.repeats_Hz == (pytest.approx(HUM_HZ, rel=1e-3) if rest is hum else None)
    assert [near.effect for near in result.nearest] == ["stribeck"]
    assert result.experiment is not None


def test_a_channel_that_no_run_has_is_not_described(sound_bench):
    record = read_record(sound_bench / "free_velocity-a.h5")
    evidence = Evidence([record], read_model(sound_bench / "nominal.yaml")[0], only=[])
    assert describe(evidence, [], ("free run", "angle", "free"), [record], ()) is None
