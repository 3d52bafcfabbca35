"""Drawn machines: two simulators that agree, cases that are whole, a key apart from them."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from leactl.cli.main import app
from leactl.errors import InputError
from leactl.joints import by_mujoco, machine, stepped
from leactl.joints.effects import (
    SIZE_SPREAD,
    STRENGTHS,
    DrawnEffect,
    draw_effect,
    indistinguishable_effects,
    listed_rules,
    showable_effects,
    unlisted_rules,
)
from leactl.joints.machine import draw_machine, kinds
from leactl.joints.make import draw_runs, make
from leactl.joints.programs import JointProgram
from leactl.model.nominal import read_model
from leactl.vocabulary.effect import effect_definition

EFFECTS = ("", *listed_rules(), *unlisted_rules())
ALIKE = 0.03  # of the largest value, that the two may differ by: near rest they stick a step apart


def runs_of(name, seconds=0.8):
    """A level and its servo, and two others, of a machine with one strong effect."""
    draw = np.random.default_rng([3, EFFECTS.index(name)])
    drawn = replace(draw_machine(draw, list(kinds())[EFFECTS.index(name) % len(kinds())]), rate=250.0, seconds=seconds)
    return draw_runs(draw, drawn, [name] if name else [], "strong")[::2]


def distance(first, second, drawn):
    """Largest of the runs' distances, over what the machine has of each at most."""
    most = {"reference": drawn.current, "current": drawn.current, "velocity": drawn.speed, "angle": drawn.speed}
    pairs = [
        (getattr(a, name), getattr(b, name), top)
        for a, b in zip(first, second, strict=True)
        for name, top in most.items()
    ]
    return max(float(np.sqrt(np.mean((a - b) ** 2))) / top for a, b, top in pairs)


def test_a_constant_current_ends_at_the_speed_that_friction_leaves():
    run = runs_of("")[0]
    specimen = run.specimen
    asked = 0.8 * specimen.machine.current
    program = JointProgram(np.full(1000, asked), None)
    result = stepped.simulate([replace(run, program=program)])[0]
    steady = (specimen.torque_constant * asked - specimen.coulomb_friction) / specimen.viscous_damping
    assert result.velocity[-1] == pytest.approx(steady, rel=1e-3)
    assert result.current[-1] == pytest.approx(asked, rel=1e-9)


def test_every_effect_changes_the_runs():
    cases = {name: runs_of(name) for name in EFFECTS if name}
    lanes = [lane for runs in cases.values() for lane in (*runs, *(replace(run, effects=()) for run in runs))]
    signals = iter(stepped.simulate(lanes))
    for name, runs in cases.items():
        with_effect, plain = ([next(signals) for _ in runs] for _ in range(2))
        assert distance(with_effect, plain, runs[0].specimen.machine) > 1e-3, name


def test_both_simulators_agree_on_every_effect():
    pytest.importorskip("mujoco", reason="the second simulator needs leactl[mujoco]")
    cases = {name: runs_of(name, seconds=0.4) for name in EFFECTS}
    signals = iter(stepped.simulate([run for runs in cases.values() for run in runs]))
    for name, runs in cases.items():
        first = [next(signals) for _ in runs]
        assert distance(by_mujoco.simulate(runs), first, runs[0].specimen.machine) < ALIKE, name


@pytest.mark.parametrize("simulator", [pytest.param("stepped", marks=pytest.mark.long), "mujoco"])
def test_a_motor_with_play_is_ahead_of_the_rigid_one_by_the_load_s_share_of_it(simulator):
    """Without friction no torque passes but between the two: their common centre moves as the rigid joint does."""
    if simulator == "mujoco":
        pytest.importorskip("mujoco", reason="the second simulator needs leactl[mujoco]")
    simulate = {"stepped": stepped.simulate, "mujoco": by_mujoco.simulate}[simulator]
    run, share, play = runs_of("")[0], 0.4, 0.02
    time = np.arange(2000) / run.specimen.machine.rate
    program = JointProgram(run.specimen.machine.current * np.sign(np.sin(2.0 * np.pi * 3.0 * time + 0.3)), None)
    free = replace(run.specimen, coulomb_friction=0.0, viscous_damping=0.0)
    geared = DrawnEffect("gear_backlash", "strong", {"play": play, "share": share, "friction": 0.0})
    rigid, loose = (
        simulate([replace(run, specimen=free, program=program, effects=effects)])[0] for effects in ((), (geared,))
    )
    ahead = loose.angle - rigid.angle
    # medians: a blow bends MuJoCo's teeth for a moment
    assert np.median(ahead[ahead > 0.0]) == pytest.approx(0.5 * share * play, rel=0.05)
    assert np.median(ahead[ahead < 0.0]) == pytest.approx(-0.5 * share * play, rel=0.05)


def test_only_machines_with_a_gear_have_play():
    draw = np.random.default_rng(2)
    loose = {kind for kind in kinds() if "gear_backlash" in showable_effects(draw_machine(draw, kind))}
    assert loose == {"geared_joint", "heavy_axis", "hobby_servo", "exoskeleton"}


BOUNDS = ("command_slew_limit", "torque_limit", "power_foldback", "voltage_limit")  # the lower, the more they take


def most(name):
    """The largest size that the vocabulary declares; infinite where it has a unit."""
    return effect_definition(name).largest


def test_sizes_grow_and_names_are_the_vocabularys():
    drawn = draw_machine(np.random.default_rng(1), "wheel_motor")
    for name in listed_rules():
        sizes = []
        for strength in STRENGTHS:
            effect = draw_effect(np.random.default_rng(5), drawn, name, strength)
            sizes.append(abs(effect.parameters[listed_rules()[name]["size"]]))
            assert set(effect.parameters) <= set(effect_definition(name).parameters)
        assert (1.0 + SIZE_SPREAD) * listed_rules()[name]["strong"] * (listed_rules()[name]["in"] == "1") <= most(name)
        assert sizes == sorted(sizes, reverse=name in BOUNDS), name
        assert all(name in indistinguishable_effects(other) for other in indistinguishable_effects(name))


def test_a_machine_without_a_reference_is_given_no_late_drive():
    drawn = replace(draw_machine(np.random.default_rng(1), "spindle"), channels=("current", "angle"))
    assert not {"transport_delay", "command_slew_limit", "velocity_filter_lag"} & set(showable_effects(drawn))


@pytest.fixture
def short(monkeypatch):
    """Runs of a quarter of a second: the same drawing, a fiftieth of the work."""
    monkeypatch.setattr(machine, "DURATIONS_S", (0.2, 0.3))


def test_cases_are_whole_and_a_seed_gives_them_again(tmp_path, short):
    for out in ("one", "two"):
        make(4, tmp_path / out, tmp_path / f"{out}-key", 2, "stepped", seed=8)
    keys = [(tmp_path / f"{out}-key" / "key.json").read_text() for out in ("one", "two")]
    assert keys[0] == keys[1]
    for name, told in json.loads(keys[0])["cases"].items():
        model, _ = read_model(tmp_path / "one" / name / "nominal.yaml")
        assert set(told["true_base"]) <= set(model.model_dump())
        paths = sorted((tmp_path / "one" / name).glob("*.h5"))
        assert len(paths) == 6
        with h5py.File(paths[0]) as first, h5py.File(tmp_path / "two" / name / paths[0].name) as again:
            loop = first["streams/loop"]
            assert {"time", "current", "angle"} <= set(loop)
            for channel in loop:
                np.testing.assert_array_equal(loop[channel][()], again["streams/loop"][channel][()])


def test_the_command_draws_machines(tmp_path, short):
    arguments = ["gap", "blind", "make", "--cases", "2", "--machines", "2", "--seed", "1", "--out", str(tmp_path / "c")]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    entries = json.loads((tmp_path / "c-key" / "key.json").read_text())["cases"]
    assert {told["simulator"] for told in entries.values()} == {"stepped"}
    assert len({told["machine"] for told in entries.values()}) == 2


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--simulator", "mujoco"], "add --machines"),
        (["--machines", "2", "--simulator", "another"], "known: stepped, mujoco"),
    ],
)
def test_what_cannot_be_made_is_refused_in_a_line(tmp_path, words, told):
    arguments = ["gap", "blind", "make", "--cases", "2", "--out", str(tmp_path / "c"), *words]
    error = CliRunner().invoke(app, arguments).exception
    assert isinstance(error, InputError)
    assert error.exit_status == 2
    assert told in str(error)


def test_a_simulator_that_is_not_installed_is_told_with_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr("leactl.joints.make.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'leactl\[mujoco\]'"):
        make(1, tmp_path / "c", tmp_path / "k", 1, "mujoco")
    assert not (tmp_path / "c").exists()
