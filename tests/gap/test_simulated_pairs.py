"""Which simulated run belongs to which real one, and what is refused: other inputs, other set-ups, two that fit."""

import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.errors import InputError
from leactl.gap.simulated.inputs import RunCommand, distance_outside, tolerance_of
from leactl.gap.simulated.pairing import pair_runs
from tests.cli.terminal import leactl
from tests.gap.test_simulated import MODEL, RATE, reference, write

COMMAND = "q_axis_current_reference"


def run(folder, name, kind="ramp", again=0, change=lambda asked: asked, **names):
    """A run with a command and an angle."""
    asked = change(reference(kind, again))
    write(folder, name, kind, {COMMAND: asked, "angle": np.cumsum(asked) / RATE}, **names)
    return folder / f"{name}.h5"


def pairs(real, simulated):
    return [(pair.simulated, pair.paired_by) for pair in pair_runs(real, simulated)]


def refused(real, simulated):
    with pytest.raises(InputError) as error:
        pair_runs(real, simulated)
    return error.value.faults


def test_a_name_comes_first(tmp_path):
    real = [run(tmp_path / "real", name) for name in ("one", "two")]
    simulated = [run(tmp_path / "sim", name) for name in ("two", "one")]
    assert pairs(real, simulated) == [(str(simulated[1]), "name"), (str(simulated[0]), "name")]


def test_runs_without_a_common_name_are_paired_by_experiment(tmp_path):
    real = [run(tmp_path / "real", f"2026-{kind}", kind) for kind in ("ramp", "levels")]
    simulated = [run(tmp_path / "sim", f"sim-{kind}", kind) for kind in ("levels", "ramp")]
    assert pairs(real, simulated) == [(str(simulated[1]), "experiment"), (str(simulated[0]), "experiment")]


def test_of_several_of_one_experiment_the_inputs_tell(tmp_path):
    real = [run(tmp_path / "real", f"2026-{again}", "levels", again) for again in (0, 1)]
    simulated = [run(tmp_path / "sim", f"sim-{again}", "levels", again) for again in (1, 0)]
    assert pairs(real, simulated) == [(str(simulated[1]), "inputs"), (str(simulated[0]), "inputs")]


def test_repeats_go_by_order_and_one_simulated_run_serves_them_all(tmp_path):
    real = [run(tmp_path / "real", f"2026-{trial}") for trial in (1, 2)]
    simulated = [run(tmp_path / "sim", f"sim-{trial}") for trial in (1, 2, 3)]
    assert pairs(real, simulated[:2]) == [(str(simulated[0]), "order"), (str(simulated[1]), "order")]
    assert pairs(real, simulated[:1]) == [(str(simulated[0]), "experiment")] * 2
    faults = refused(real, simulated)
    assert len(faults) == 2
    assert "3 simulated runs have its inputs" in faults[0]
    assert "2 real runs do" in faults[0]


def test_a_run_on_both_sides_and_one_without_a_partner_are_refused(tmp_path):
    real, simulated = run(tmp_path / "real", "one"), run(tmp_path / "sim", "two", "levels")
    assert refused([real], [real]) == [f"{real}: is both real and simulated; a run can be on one side only"]
    assert refused([real], [simulated]) == [f"{real}: no simulated run of its name, nor of its experiment (ramp, free)"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"change": lambda asked: 1.1 * asked}, "A there, and the same within"),
        ({"change": lambda asked: np.where(np.arange(len(asked)) < 960, asked, 0.0)}, "at 2.4"),
        ({"change": lambda asked: asked[:1600]}, "ends after 3.9975 s"),
        ({"change": lambda asked: np.roll(asked, 50)}, "A there, and the same within"),
        ({"mechanical": "locked"}, "its set-up is locked, that of"),
    ],
)
def test_other_inputs_are_refused_with_the_place(tmp_path, changes, words):
    real, simulated = run(tmp_path / "real", "one"), run(tmp_path / "sim", "one", **changes)
    [fault] = refused([real], [simulated])
    assert fault.startswith(f"{simulated}: ")
    assert words in fault
    assert str(real) in fault


def test_a_run_of_other_commands_is_refused(tmp_path):
    real = run(tmp_path / "real", "one")
    write(tmp_path / "sim", "one", "ramp", {"angle_reference": reference("ramp", 0)})
    [fault] = refused([real], [tmp_path / "sim" / "one.h5"])
    assert f"logs other commands (angle_reference of test) than {real} ({COMMAND} of test)" in fault


def test_the_command_line_refuses_in_one_line_and_before_any_fit(tmp_path):
    real = run(tmp_path / "real", "one")
    simulated = run(tmp_path / "sim", "one", change=lambda asked: 2.0 * asked)
    (tmp_path / "nominal.yaml").write_text(MODEL)
    done = leactl("gap", "diagnose", real, "--simulated", simulated, "--model", tmp_path / "nominal.yaml")
    assert done.returncode == 2
    assert f"{simulated}: {COMMAND} of test is" in done.stderr
    assert "Traceback" not in done.stderr
    assert "reading equations" not in done.stderr


def test_without_a_model_simulated_runs_have_to_carry_one(tmp_path):
    real, simulated = run(tmp_path / "real", "one"), run(tmp_path / "sim", "one")
    done = leactl("gap", "diagnose", real, "--simulated", simulated)
    assert done.returncode == 2
    assert f"{simulated}: carries no model" in done.stderr
    alone = leactl("gap", "diagnose", real)
    assert alone.returncode == 2
    assert alone.stderr == "leactl: missing option '--model'; leactl gap diagnose --help tells the usage\n"


def test_every_run_behind_the_option_is_a_simulated_one(tmp_path):
    real = [run(tmp_path / "real", f"{again}", again=again) for again in (0, 1)]
    shutil.copytree(tmp_path / "real", tmp_path / "sim")
    simulated = sorted((tmp_path / "sim").glob("*.h5"))
    done = leactl("gap", "diagnose", "--simulated", *simulated, "--model", tmp_path / "absent.yaml", *real)
    assert done.returncode == 2
    missing = f"leactl: {tmp_path / 'absent.yaml'}: No such file or directory"
    assert done.stderr.splitlines() == [missing]


@given(
    st.lists(st.floats(-50.0, 50.0), min_size=8, max_size=8),
    st.floats(-2.5, 2.5),
    st.sampled_from([200.0, 500.0, 1100.0]),
)
def test_a_command_is_the_same_at_another_rate_and_within_a_few_samples(levels, late, rate):
    """Steps that another log stamps up to two and a half samples off, at its own rate, are no mismatch."""
    ours, theirs = np.arange(2000) / 500.0, np.arange(round(4.0 * rate)) / rate
    values, shift = np.asarray(levels), late / min(rate, 500.0)
    seen = values[np.clip((theirs - shift) * 2.0, 0, 7).astype(int)]
    asked = values[np.clip(ours * 2.0, 0, 7).astype(int)]
    reach = 3.0 / min(rate, 500.0)
    beyond = distance_outside(ours, asked, RunCommand(theirs, seen, "A"), reach)
    assert np.max(beyond[ours <= theirs[-1]]) <= tolerance_of(asked, seen)


@given(st.floats(0.06, 10.0), st.floats(0.0, 1.0))
def test_another_amplitude_is_a_mismatch(more, noise):
    time = np.arange(2000) / 500.0
    asked = np.sin(2.0 * np.pi * time)
    noisy = asked + 0.005 * noise * np.random.default_rng(0).standard_normal(len(time))
    beyond = distance_outside(time, (1.0 + more) * asked, RunCommand(time, noisy, "A"), 0.006)
    assert np.max(beyond) > tolerance_of((1.0 + more) * asked, noisy)
