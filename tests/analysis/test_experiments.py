"""Which analysis a run asks for, which runs go together, and what is said of files that cannot be used."""

import json

import h5py
import numpy as np
import pytest

from leactl.analysis.analyze import analyze_runs, names
from leactl.errors import InputError, MissingChannel
from leactl.runfile.verify.integrity import recover

from .synthetic import FRICTION_LEVELS


def test_the_experiments_of_the_paper_that_are_there():
    assert {"torque-constant", "friction", "current-step", "position-step", "current-noise", "position-noise"} <= set(
        names()
    )
    assert not {"estimate", "levels", "regression"} & set(names())


def test_the_run_says_what_it_is_for_by_its_protocol_and_else_by_its_name(bench):
    with pytest.raises(MissingChannel, match="no velocity of test"):
        analyze_runs([bench.torque(protocol="name: torque-constant\nanalysis: friction\n")])
    assert analyze_runs([bench.torque(protocol="name: mine\n")]).experiment == "torque-constant"
    assert analyze_runs([bench.torque(protocol="{unreadable")]).experiment == "torque-constant"
    path = bench.torque(protocol="name: mine\nanalysis: juggling\n")
    with pytest.raises(InputError, match=r"analysis 'juggling' is not known; known: .*friction.*torque-constant"):
        analyze_runs([path])


def test_actuators_and_conditions_are_answered_apart(bench):
    runs = [
        bench.friction(actuator="a1", condition="design", f=0.20),
        bench.friction(actuator="a1", condition="loaded", f=0.25),
        bench.friction(actuator="a2", condition="design", f=0.22),
        bench.friction(actuator="a1", condition="design", f=0.20),
    ]
    result = analyze_runs(runs)
    assert result.groups == [("a1", "design"), ("a1", "loaded"), ("a2", "design")]
    results = {
        (item.actuator, item.condition): item.value for item in result.results if item.name == "coulomb_friction"
    }
    assert results == pytest.approx({("a1", "design"): 0.20, ("a1", "loaded"): 0.25, ("a2", "design"): 0.22})
    assert result.find("coulomb_friction", "a2").value == pytest.approx(0.22)
    with pytest.raises(InputError, match="'coulomb_friction' 3 times: a1/design, a1/loaded, a2/design; ask for one"):
        result.find("coulomb_friction")
    with pytest.raises(InputError, match="no result 'coulomb'; it has viscous_damping"):
        result.find("coulomb")
    rows = result.as_json()["results"]
    assert {(row["actuator"], row["condition"]) for row in rows} == set(result.groups)


def test_a_note_of_one_group_says_whose_it_is(bench):
    result = analyze_runs([bench.friction(), bench.friction(condition="loaded", signs=(1,))])
    assert any(note.startswith("a1 loaded: the rotor turned forward only") for note in result.notes)
    assert sum("from the model in the run" in note for note in result.notes) == 1


def test_json_has_exactly_the_documented_form(bench):
    path = bench.torque()
    answer = json.loads(json.dumps(analyze_runs([path]).as_json(), allow_nan=False))
    assert list(answer) == ["format", "format_version", "experiment", "runs", "results", "notes"]
    assert answer["experiment"] == "torque-constant"
    assert answer["runs"] == [str(path)]
    assert all(list(row) == ["name", "value", "std", "low", "high", "units"] for row in answer["results"])
    by_name = {row["name"]: row for row in answer["results"]}
    assert by_name["torque_constant"]["units"] == "N*m/A"
    assert by_name["r_squared"]["std"] is None


def test_runs_of_different_experiments_are_refused(bench):
    paths = [bench.torque(), bench.friction()]
    with pytest.raises(InputError, match=r"its analysis is 'friction', that of .* is 'torque-constant'; give runs of"):
        analyze_runs(paths)


def test_a_run_given_twice_is_refused(bench, tmp_path):
    path = bench.torque()
    copy = tmp_path / "copy.h5"
    copy.write_bytes(path.read_bytes())
    for again in (path, copy):
        with pytest.raises(InputError, match=r"the same run as .*; give each run once"):
            analyze_runs([path, again])


def test_a_run_whose_values_are_not_those_of_its_close_gives_no_figures(bench):
    whole, path = bench.friction(), bench.friction(condition="loaded")
    with h5py.File(path, "r+") as file:
        file["streams/loop/" + next(name for name in file["streams/loop"] if name != "time")][3] += 0.5
    with pytest.raises(InputError, match=r"checksum mismatch.*; nothing is worked out from it") as caught:
        analyze_runs([whole, path])
    assert [fault.startswith(f"{path}: /streams/loop/") for fault in caught.value.faults] == [True]


def test_no_run_and_options_that_an_experiment_lacks_are_refused(bench):
    with pytest.raises(InputError, match="no run to analyse"):
        analyze_runs([])
    path = bench.torque()
    with pytest.raises(InputError, match="torque-constant has no option torque_constant; it has torque_gain_std, c"):
        analyze_runs([path], torque_constant=0.5)
    assert analyze_runs([path], torque_constant=None).results


@pytest.mark.parametrize("status", ["stopped", "tripped", "failed"])
def test_a_run_that_did_not_come_to_its_end_is_analysed_with_a_note(bench, status):
    path = bench.torque(status=status)
    result = analyze_runs([path])
    assert result.find("torque_constant").value == pytest.approx(0.49)
    assert result.notes[0] == f"{path}: status is '{status}' (as the test says); analysed as far as its steps go"


def test_a_recovered_run_is_analysed_with_a_note(bench, tmp_path):
    path = bench.torque()
    with h5py.File(path, "r+") as file:
        file.attrs["status"] = "recording"
    clean = recover(path)
    result = analyze_runs([clean])
    assert result.find("torque_constant").value == pytest.approx(0.49)
    assert "status is 'recovered'" in result.notes[0]


def foreign(path, **columns):
    """A file as another program may write it: two streams, no sources, no checksums, attributes as bytes."""
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": np.bytes_("leactl-run"), "format_version": 1, "protocol": "friction"})
        for name, (quantity, units, time, values) in columns.items():
            group = file.create_group(f"streams/{name}")
            stamps = group.create_dataset("time", data=time)
            stamps.make_scale("time")
            data = group.create_dataset(name, data=values)
            data.dims[0].attach_scale(stamps)
            data.attrs.update({"quantity": quantity, "units": units, "role": "test", "device": "x", "long_name": ""})
        steps = file.create_group("steps")
        setpoints = [sign * level for _ in range(2) for sign in (1, -1) for level in FRICTION_LEVELS]
        start = np.arange(len(setpoints), dtype=float)
        steps["name"] = ["hold"] * len(start)
        steps["start"], steps["stop"], steps["settle"] = start, start + 1.0, np.full(len(start), 0.25)
        steps["parameters"] = [json.dumps({"current_A": setpoint}) for setpoint in setpoints]
    return path


def test_a_foreign_file_with_a_clock_for_each_channel_is_analysed(tmp_path):
    setpoints = np.array([sign * level for _ in range(2) for sign in (1, -1) for level in FRICTION_LEVELS])
    slow, fast = np.arange(0.005, 20, 0.02), np.arange(0.0, 20, 0.004)
    current = setpoints[slow.astype(int)]
    turning = setpoints[fast.astype(int)]
    velocity = (0.49 * turning - 0.2 * np.sign(turning)) / 0.02
    path = foreign(
        tmp_path / "theirs.hdf5",
        i=("q_axis_current", "A", slow, current),
        w=("velocity", "rad/s", fast, velocity),
    )
    result = analyze_runs([path], torque_constant=0.49)
    assert result.find("viscous_damping").value == pytest.approx(0.02)
    assert result.find("coulomb_friction").value == pytest.approx(0.2)
    with pytest.raises(InputError, match="found no model; a torque constant is needed, give --torque-constant"):
        analyze_runs([path])


def test_a_foreign_file_without_the_channel_is_refused(tmp_path):
    stamps = np.arange(0.0, 20, 0.02)
    path = foreign(tmp_path / "theirs.h5", i=("q_axis_current", "A", stamps, 1.0 + 0.01 * np.sin(stamps)))
    with pytest.raises(MissingChannel, match="no velocity of test; the run has q_axis_current of test"):
        analyze_runs([path], torque_constant=0.49)


@pytest.mark.parametrize("kind", ["absent", "text", "other"])
def test_what_is_no_run_is_refused_in_one_line(tmp_path, kind):
    path = tmp_path / "run.h5"
    if kind == "text":
        path.write_text("speed,torque\n1,2\n")
    elif kind == "other":
        with h5py.File(path, "w") as file:
            file["x"] = [1, 2]
    with pytest.raises(InputError) as caught:
        analyze_runs([path])
    assert str(caught.value).startswith(f"{path}: ")
    assert len(caught.value.faults) == 1
