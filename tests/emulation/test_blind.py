"""Blind cases: drawn alike for a seed, off nominal everywhere, complete and in the run format, their key apart."""

import hashlib
import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from leactl.cli.main import app
from leactl.emulation.blind import draws, programs
from leactl.emulation.blind.draws import RUN_KINDS, STRENGTHS, draw_case, draw_effect
from leactl.emulation.blind.key import read_key
from leactl.emulation.blind.make import make
from leactl.emulation.plant.effects.contract import own_hooks
from leactl.emulation.plant.effects_outside_library import unlisted_effects
from leactl.errors import InputError
from leactl.vocabulary.effect import effect_definition, effect_names, effects_on


@pytest.fixture
def short(monkeypatch):
    """Programs of 0.2 s and heated runs of 20 s: the same drawing, a hundredth of the work."""

    def cut(made):
        def program(draw):
            whole = made(draw)
            velocity = None if whole.velocity is None else whole.velocity[:200]
            return replace(whole, current=whole.current[:200], velocity=velocity)

        return program

    monkeypatch.setattr(draws, "PROGRAM_DRAWS", {name: cut(made) for name, made in programs.PROGRAM_DRAWS.items()})
    monkeypatch.setattr(draws, "heating", lambda draw, strong: programs.heating(draw, strong)[:20])


def values_of(folder):
    results = {}
    for path in sorted(folder.rglob("*.h5")):
        with h5py.File(path) as file:
            for stream in file["streams"]:
                for name, channel in file["streams"][stream].items():
                    results[str(path.relative_to(folder)), stream, name] = channel[()]
    return results


@pytest.mark.long
def test_a_seed_gives_the_same_cases_and_another_does_not(tmp_path, short):
    for name, seed in (("one", 3), ("two", 3), ("three", 4)):
        make(2, tmp_path / name, tmp_path / f"{name}-key", seed=seed, kinds=("pair", "unknown"))
    first, again, other = (values_of(tmp_path / name) for name in ("one", "two", "three"))
    assert first.keys() == again.keys()
    assert len({path for path, _, _ in first}) == 20
    for place, values in first.items():
        np.testing.assert_array_equal(values, again[place])
    assert any(not np.array_equal(values, other[place]) for place, values in first.items() if place in other)
    keys = [(tmp_path / f"{name}-key" / "key.json").read_text() for name in ("one", "two")]
    assert keys[0] == keys[1]


def test_key_is_the_one_whose_hash_lies_beside_the_runs(tmp_path, short):
    digest = make(2, tmp_path / "runs", tmp_path / "key")
    content = (tmp_path / "key" / "key.json").read_bytes()
    assert hashlib.sha256(content).hexdigest() == digest
    assert (tmp_path / "runs" / "key.sha256").read_text().split()[0] == digest
    key = read_key(tmp_path / "key", tmp_path / "runs")
    assert len(key["salt"]) == 32
    assert set(key["cases"]) == {path.name for path in (tmp_path / "runs").iterdir() if path.is_dir()}
    changed = content.replace(b'"kind"', b'"Kind"')
    (tmp_path / "key" / "key.json").write_bytes(changed)
    with pytest.raises(InputError, match="not the key of these runs"):
        read_key(tmp_path / "key", tmp_path / "runs")


def test_nothing_beside_the_runs_tells_the_cause(tmp_path, short):
    make(3, tmp_path / "runs", tmp_path / "key", kinds=("single",), seed=1)
    names = [
        name for entry in read_key(tmp_path / "key", tmp_path / "runs")["cases"].values() for name in entry["effects"]
    ]
    assert len(set(names)) == 3
    for path in (tmp_path / "runs").rglob("*"):
        content = path.read_bytes() if path.is_file() else b""
        assert not any(name.encode() in content for name in names), path


def test_runs_are_complete_and_carry_what_the_format_asks_for(tmp_path, short):
    make(1, tmp_path / "runs", tmp_path / "key", kinds=("none",), seed=2)
    (case,) = (path for path in (tmp_path / "runs").iterdir() if path.is_dir())
    assert {path.name for path in case.iterdir()} == {
        "nominal.yaml",
        *(f"{kind}-{repeat}.h5" for kind in RUN_KINDS for repeat in "ab"),
    }
    for path in case.glob("*.h5"):
        with h5py.File(path) as file:
            assert (file.attrs["status"], file.attrs["simulated"]) == ("complete", 1)
            quantities = {
                (channel.attrs["quantity"], channel.attrs["role"])
                for stream in file["streams"].values()
                for name, channel in stream.items()
                if name != "time"
            }
            assert {("winding_temperature", "test"), ("ambient_temperature", "bench")} <= quantities
            setup = file["setup"].attrs["mechanical"]
            assert (("torque", "test") in quantities) == (setup in ("locked", "coupled"))
            assert (("q_axis_current", "load") in quantities) == (setup == "coupled")
            assert (("line_voltage", "test") in quantities) == (setup == "heated")
            assert file["model/source"][()].decode() == (case / "nominal.yaml").read_text()


def test_every_base_parameter_is_off_nominal():
    nominal = {"phase_resistance": 0.264, "phase_inductance": 128e-6, "torque_constant": 0.49, "rotor_inertia": 0.0024}
    for seed in range(12):
        base = draw_case(np.random.default_rng(seed), "c", "none", (), "plain").base
        for name, value in nominal.items():
            off = abs(getattr(base.test, name) / value - 1.0)
            assert 0.0 < off < 0.1, name
        assert base.test.back_emf_constant == base.test.torque_constant
        assert 0.0 < abs(base.bench.shaft_stiffness / 6000.0 - 1.0) <= 0.15
        assert base.load.coulomb_friction != base.test.coulomb_friction
        assert base.nominal_coefficient in (0.0, 0.004)
        assert (base.test.resistance_coefficient == 0.0) == (base.nominal_coefficient == 0.0)


@pytest.mark.parametrize("name", effects_on("bench"))
def test_drawn_parameters_lie_in_the_vocabulary_and_grow_with_strength(name):
    definition = effect_definition(name)
    rule = draws._rules()[name]
    draw, sizes = np.random.default_rng(0), []
    for strength in STRENGTHS:
        drawn = [draw_effect(draw, name, strength).parameters for _ in range(40)]
        for parameters in drawn:
            for parameter, value in parameters.items():
                assert definition.parameters[parameter].low <= value <= definition.parameters[parameter].high
        sizes.append(np.mean([abs(parameters[rule["size"]] - rule.get("about", 0.0)) for parameters in drawn]))
    falls = rule["strong"] < rule["faint"] and rule["faint"] > 0
    assert sizes == sorted(sizes, reverse=falls)


def test_unlisted_effects_are_none_of_the_vocabulary_and_each_does_something():
    result = unlisted_effects()
    assert len(result) >= 6
    assert not set(result) & set(effect_names())
    for kind in result.values():
        assert own_hooks(kind.drawn(np.random.default_rng(0), 0.5))


def test_wrong_arguments_are_named_all_at_once(tmp_path):
    with pytest.raises(InputError) as caught:
        make(0, tmp_path / "a", tmp_path / "a" / "key", kinds=("nothing",), effects=("coging",))
    assert len(caught.value.faults) == 4


def test_command_makes_cases_and_prints_json(tmp_path, short):
    out = tmp_path / "cases"
    arguments = ["gap", "blind", "make", "--cases", "2", "--out", str(out), "--seed", "9", "--kinds", "none", "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert printed["cases"] == 2
    assert (tmp_path / "cases-key" / "key.json").is_file()
    assert "0 of 2 cases made" in result.stderr
