"""Units that are off by a thousand are asked for by name in the first note, and a sound record has no such note."""

import h5py
import numpy as np
import pytest

from leactl.analysis.analyze import analyze_runs
from leactl.analysis.experiments import (
    back_drive,
    back_emf,
    coast_down,
    friction,
    no_load_loss,
    torque_constant,
    torque_pulses,
)
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Run

from .back_driven import driven
from .control_runs import step_run
from .free_rotors import turned
from .open_leads import OpenLeads
from .pulses import pulsed
from .run_outs import coasting
from .synthetic import analyzed

ROTOR = "rotor_inertia: 0.0024\ncoulomb_friction: 0.208\nviscous_damping: 0.0238\n"
ASKED = ("check the units", "check its units")


def carrying(path, **sources):
    """The run with these texts as its model or bench."""
    with h5py.File(path, "r+") as file:
        for name, text in sources.items():
            group = file.require_group(name)
            if "source" in group:
                del group["source"]
            group["source"] = text
    return path


def scaled(times, name):
    """An edit that multiplies a column, with or without its time."""

    def edit(*given):
        given[-1][name] *= times

    return edit


def doubts(result):
    return [note for note in result.notes if any(words in note for words in ASKED)]


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (1000.0, " times the model's 0.49 N*m/A: torque in mN*m or q_axis_current in kA?"),
        (0.001, " times the model's 0.49 N*m/A: torque in kN*m or q_axis_current in mA?"),
        (30.0, "times the model's 0.49 N*m/A: check the units of torque and q_axis_current"),
    ],
)
def test_a_torque_constant_that_no_machine_has_beside_its_model(bench, times, said):
    result = analyzed(torque_constant.analyze, bench.torque(noise=0.01, edit=scaled(times, "torque")))
    assert result.notes[0].startswith("torque_constant is ")
    assert said in result.notes[0]


@pytest.mark.parametrize("times", [0.4, 1.0, 2.5])
def test_a_machine_that_is_not_its_model_s_equal_is_no_wrong_unit(bench, tmp_path, times):
    results = [
        analyzed(torque_constant.analyze, bench.torque(noise=0.001, edit=scaled(times, "torque"))),
        analyzed(torque_pulses.analyze, pulsed(bench, edit=scaled(times, "torque"))),
        analyzed(back_emf.analyze, OpenLeads(tmp_path).run(gains=(times,) * 3)),
        analyzed(no_load_loss.analyze, turned(bench, f=times * 0.208, model=ROTOR)),
        analyzed(friction.analyze, bench.friction(model=ROTOR)),
        analyzed(coast_down.analyze, coasting(bench, j=max(times, 1.0) * 0.0024, noise=0.01, model=ROTOR)),
    ]
    assert [note for result in results for note in doubts(result)] == []


def test_every_experiment_with_a_figure_of_the_model_asks_for_the_unit(bench, tmp_path):
    quiet = OpenLeads(tmp_path).run(gains=(0.001,) * 3, noise=0.0, step=0.0)
    in_mA = scaled(1000.0, "q_axis_current")  # noqa: N806 (a unit keeps its letter)
    asked = {
        "torque_constant is 1000 times": analyzed(torque_pulses.analyze, pulsed(bench, gains=(1000.0, 1.0))),
        "phase_voltage in kV?": analyzed(back_emf.analyze, quiet),
        "coulomb_friction is": analyzed(no_load_loss.analyze, turned(bench, gain=1000.0, model=ROTOR)),
        "rotor_inertia is": analyzed(coast_down.analyze, coasting(bench, gain=1000.0, noise=0.01, model=ROTOR)),
        "viscous_damping is": analyzed(friction.analyze, bench.friction(edit=in_mA, model=ROTOR)),
    }
    for said, result in asked.items():
        assert said in result.notes[0]
        assert "check the units of" in result.notes[0]

    path = carrying(driven(bench, gain=1000.0), model=ROTOR)
    note = analyzed(back_drive.analyze, path).notes[0]
    assert note.startswith("breakaway_torque is 1")
    assert "torque in mN*m?" in note


def test_a_given_torque_constant_is_held_against_the_model_s(bench):
    path = coasting(bench, noise=0.01, model=ROTOR)
    first, second, *_ = analyzed(coast_down.analyze, path, torque_constant=490.0).notes
    assert first.startswith("the torque constant 490 N*m/A, as given, is 1000 times the model's 0.49 N*m/A")
    assert "rotor_inertia is" in second
    assert "q_axis_current in mA or the torque constant given in mN*m/A?" in second
    assert doubts(analyzed(coast_down.analyze, path, torque_constant=0.6)) == []


def test_readings_beyond_the_limits_of_the_bench_are_named(bench):
    path = carrying(coasting(bench, gain=1000.0, noise=0.01), bench="name: x\nlimits: {current_A: 30}\n")
    result = doubts(analyzed(coast_down.analyze, path))
    assert any(note.startswith("q_axis_current reads up to") and "limit of 30 A" in note for note in result)
    sound = carrying(coasting(bench, noise=0.01), bench="name: x\nlimits: {current_A: 30}\n")
    assert doubts(analyzed(coast_down.analyze, sound)) == []


def test_pulses_that_cannot_be_fitted_name_the_current_that_is_beyond_the_limit(bench):
    path = carrying(pulsed(bench, gains=(1.0, 1000.0)), bench="limits: {current_A: 30}\n")
    with pytest.raises(NotIdentifiable, match=r"q_axis_current reads up to .* check its units"):
        analyzed(torque_pulses.analyze, path)


@pytest.mark.parametrize("text", ["limits: 3\n", "limits: {current_A: many}\n", "- 1\n", "{"])
def test_a_bench_file_that_cannot_be_read_costs_no_answer(bench, text):
    path = carrying(coasting(bench, noise=0.01), bench=text)
    assert doubts(analyzed(coast_down.analyze, path)) == []


def test_a_step_response_in_another_unit_blames_no_clipping(tmp_path):
    result = analyze_runs([step_run(tmp_path, noise=0.001, edit=scaled(1000.0, "q_axis_current"))])
    assert "is 1e+03 times its demand: check its units" in result.notes[0]
    assert result.notes[1].startswith("at 2.5, 5, 7.5 the response makes 1000 times the step of its reference")
    assert "q_axis_current in mA?" in result.notes[1]
    assert not any("clipped" in note for note in result.notes)
    assert doubts(analyze_runs([step_run(tmp_path, noise=0.01)])) == []


def test_a_response_that_stays_a_third_short_is_still_a_loop_s(tmp_path):
    result = analyze_runs([step_run(tmp_path, noise=0.01, edit=scaled(0.67, "q_axis_current"))])
    assert any("or a loop that lets it" in note for note in result.notes)
    assert doubts(result) == []


def test_readings_of_a_run_without_a_model_are_not_compared(bench):
    path = bench.torque(noise=0.001, edit=scaled(1000.0, "torque"), torque_constant=None)
    with Run.open(path) as run:
        assert run.source("model") is None
    assert doubts(analyzed(torque_constant.analyze, path)) == []
    assert np.isfinite(analyzed(torque_constant.analyze, path).results[0].value)
