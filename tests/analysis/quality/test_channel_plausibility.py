"""A dead, hanging, turned or misread channel is refused by name or is the first note; a sound one passes."""

from dataclasses import replace

import numpy as np
import pytest

from leactl.analysis.analyze import analyze_each, analyze_runs
from leactl.analysis.anova.values import values_of_runs
from leactl.analysis.quality.channel_plausibility import channel_doubts, demand_of
from leactl.errors import InputError
from leactl.processes import Workers
from leactl.runfile.read.reader import Run
from tests.analysis.control_runs import step_run
from tests.analysis.corrupted import constant, frozen, rewritten, thousandfold, turned, zero
from tests.analysis.heated import HeatedBench
from tests.analysis.synthetic import Bench
from tests.analysis.test_coast_down import coasting
from tests.analysis.test_no_load_loss import turned as turned_rotor

NOISE = {"q_axis_current": 0.015, "velocity": 0.002}


def doubts(path):
    with Run.open(path) as run:
        return channel_doubts(run)


def spoiled(path, tmp_path, quantity, corruption):
    return rewritten(path, tmp_path / f"{quantity}-{corruption.__name__}", f"loop/{quantity}", corruption)


@pytest.mark.parametrize("corruption", [zero, constant, turned])
def test_a_current_that_is_not_its_demand_is_no_friction(tmp_path, corruption):
    path = Bench(tmp_path).friction(noise=NOISE)
    with pytest.raises(InputError, match=r"q_axis_current of test \(d\)"):
        analyze_runs([spoiled(path, tmp_path, "q_axis_current", corruption)])


@pytest.mark.parametrize("processes", [1, 2])
def test_a_run_that_is_looked_at_elsewhere_is_refused_alike(tmp_path, processes):
    bench = Bench(tmp_path)
    sound, other = bench.friction(noise=NOISE), bench.friction(noise=NOISE)
    path = spoiled(sound, tmp_path, "q_axis_current", turned)
    with pytest.raises(InputError, match=r"q_axis_current of test \(d\)") as here:
        analyze_runs([path, other])
    with Workers(processes) as workers:
        with pytest.raises(InputError) as there:
            analyze_each([path, other], workers=workers)
        (found,), faults = analyze_each([sound, other], workers=workers)
    assert there.value.faults == here.value.faults
    assert (found.as_json(), faults) == (analyze_runs([sound, other]).as_json(), [])


@pytest.mark.parametrize("corruption", [zero, constant])
def test_a_dead_current_is_no_drag_and_no_inertia(tmp_path, corruption):
    bench = Bench(tmp_path)
    for path in (turned_rotor(bench), coasting(bench, noise=0.002)):
        with pytest.raises(InputError, match=r"q_axis_current of test \(d\)"):
            analyze_runs([spoiled(path, tmp_path / path.stem, "q_axis_current", corruption)])


def test_a_comparison_refuses_what_an_analysis_refuses(tmp_path):
    path = spoiled(Bench(tmp_path).friction(noise=NOISE), tmp_path, "q_axis_current", zero)
    with pytest.raises(InputError, match=r"q_axis_current of test \(d\) does not follow its demand"):
        values_of_runs([path])


def test_a_channel_that_hangs_from_some_moment_is_the_first_note(tmp_path):
    path = spoiled(Bench(tmp_path).friction(noise=NOISE), tmp_path, "q_axis_current", frozen)
    first = analyze_runs([path]).notes[0]
    assert "q_axis_current of test (d) hangs: exactly" in first


def test_a_current_in_milliamperes_is_the_first_note(tmp_path):
    path = spoiled(step_run(tmp_path, trials=1, noise=1e-3), tmp_path, "q_axis_current", thousandfold)
    assert any("q_axis_current of test" in note and "times its demand" in note for note in doubts(path))


def test_sound_channels_pass_also_thinned_without_noise_and_quantised(tmp_path):
    bench = Bench(tmp_path)
    for number, path in enumerate(
        [
            bench.friction(noise=NOISE),
            bench.friction(noise=0.0),
            bench.friction(noise=NOISE, resolution={"q_axis_current": 0.02, "velocity": 0.01}),
            bench.torque(noise=NOISE),
            turned_rotor(bench),
            coasting(bench, noise=0.002),
            coasting(bench),
            step_run(tmp_path, trials=1, noise=1e-3),
        ]
    ):
        assert doubts(path) == []
        assert doubts(rewritten(path, tmp_path / f"thinned-{number}", thinned=2)) == []


def test_an_angle_that_hangs_while_the_velocity_turns_the_shaft_is_named_with_it(tmp_path):
    bench = Bench(tmp_path)
    time = np.arange(4000) / 100.0
    velocity = 5.0 + bench.rng.normal(0.0, 0.002, len(time))
    columns = {"velocity": velocity, "angle": np.round(5.0 * time / 1.6e-4) * 1.6e-4}
    path = bench.write("friction", time, columns, [("hold", 0.0, 40.0, 0.0, {"current_A": 1.0})])
    assert doubts(path) == []
    for quantity, corruption in (("angle", frozen), ("angle", zero), ("velocity", zero), ("velocity", turned)):
        (note,) = [note for note in doubts(spoiled(path, tmp_path, quantity, corruption)) if "contradict" in note]
        assert "angle of test (d) and velocity of test (d) contradict each other" in note


def test_a_shaft_at_rest_contradicts_nothing(tmp_path):
    bench = Bench(tmp_path)
    time = np.arange(4000) / 100.0
    for noise in (0.0, 0.02):
        columns = {"velocity": bench.rng.normal(0.0, noise, len(time)), "angle": np.full(len(time), 0.25)}
        columns["q_axis_current"] = np.repeat([0.0, 5.0, 10.0, 0.0], 1000) + bench.rng.normal(0.0, noise, len(time))
        columns["q_axis_current_reference"] = np.repeat([0.0, 5.0, 10.0, 0.0], 1000)
        path = bench.write("torque-constant", time, columns, [("rest", 0.0, 40.0, 0.0, {})], mechanical="locked")
        assert doubts(path) == []


@pytest.mark.parametrize("readings", [129, 150, 260, 500])
@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_a_short_rest_contradicts_nothing_whatever_its_noise(tmp_path, readings, size):
    bench = Bench(tmp_path)
    time = np.arange(readings) / 50.0
    for _ in range(12):
        columns = {"velocity": bench.rng.normal(0.0, 0.002 * size, readings), "angle": np.full(readings, 0.25)}
        path = bench.write("friction", time, columns, [("rest", 0.0, time[-1], 0.0, {})])
        assert not [note for note in doubts(path) if "contradict" in note]


def test_a_short_turn_whose_angle_hangs_is_named(tmp_path):
    bench = Bench(tmp_path)
    time = np.arange(150) / 50.0
    columns = {"velocity": bench.rng.normal(0.1, 0.002, len(time)), "angle": np.full(len(time), 0.25)}
    path = bench.write("friction", time, columns, [("hold", 0.0, time[-1], 0.0, {})])
    assert [note for note in doubts(path) if "contradict" in note]


@pytest.mark.parametrize("heat_s", [120.0, 240.0, 480.0])
def test_regions_that_warm_one_after_the_other_are_not_turned(tmp_path, heat_s):
    path = HeatedBench(tmp_path).run(rate_Hz=2.0, heat_s=heat_s, cool_s=heat_s)
    assert doubts(path) == []
    place = rewritten(path, tmp_path / "turned", "camera/active_1", turned)
    assert any("winding_temperature of test at active_1" in note and "sign is turned" in note for note in doubts(place))


def test_a_hold_that_states_no_role_is_no_demand_of_the_load(tmp_path):
    """Holds of imported runs state none; in a coupled rig the load's current may have the other sign."""
    time = np.arange(4000) / 100.0
    path = Bench(tmp_path).write(
        "friction", time, {"q_axis_current": np.ones(4000)}, [("hold", 0.0, 40.0, 0.0, {"current_A": 1.0})]
    )
    with Run.open(path) as run:
        channel = run.channel("q_axis_current", role="test")
        assert demand_of(run, channel) is not None
        assert demand_of(run, replace(channel, role="load")) is None
