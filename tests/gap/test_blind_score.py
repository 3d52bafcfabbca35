"""The withheld check: answers before the key, nothing done twice, figures that mean what they say."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from typer.testing import CliRunner

from leactl.cli.main import app
from leactl.emulation.blind.key import HASH_NAME
from leactl.errors import InputError
from leactl.gap.blind import check as checking
from leactl.gap.blind.marks import Departure, Mark, mark
from leactl.gap.blind.score import Share, calibration, score
from leactl.gap.blind.truth import Truth, measure
from leactl.processes import HERE


def draw_cases(folder, plans, seed):
    """Two cases of one drawn machine, whatever the library grows by."""
    made = ["gap", "blind", "make", "--machines", "1", "--cases", "2", "--kinds", "single", "--seed", str(seed)]
    with patch("leactl.joints.make.plan", lambda *_: plans):
        result = CliRunner().invoke(app, [*made, "--out", str(folder / "cases"), "--key", str(folder / "key")])
    assert result.exit_code == 0, result.output


@pytest.fixture(scope="session")
def cases(tmp_path_factory):
    """Two whole cases with one effect each, nobody misses either."""
    folder = tmp_path_factory.mktemp("scored")
    draw_cases(folder, [("single", ("quadratic_drag",), "plain"), ("single", ("stribeck",), "plain")], seed=4)
    return folder


@pytest.fixture(scope="session")
def scored(cases):
    """The command, run once."""
    arguments = ["gap", "blind", "score", "--cases", str(cases / "cases"), "--key", str(cases / "key")]
    return CliRunner().invoke(app, [*arguments, "--out", str(cases / "report.md"), "--json"])


def sets_of(folder):
    return checking.Cases(folder / "cases", folder / "key", folder / "cases-answers")


@pytest.mark.long
def test_both_cases_are_named_and_their_gap_is_closed(scored):
    assert scored.exit_code == 0, scored.output
    answer = json.loads(scored.stdout)
    assert answer["format"] == "leactl-gap-score"
    shares = {line["question"]: (line["count"], line["total"]) for line in answer["shares"]}
    assert shares["one effect, plain or strong: first cause right"] == (2, 2)
    assert shares["one effect, any: in the reported set"] == (2, 2)
    assert shares["share closed within 0.08 of an oracle that is told the effect"] == (2, 2)
    assert shares["two effects: both named"] == (0, 0)
    assert answer["mean_set_size"] == 1.0
    assert not any("first cause" in miss["question"] for miss in answer["misses"])


@pytest.mark.long
def test_who_is_told_the_effects_knows_the_stamps_of_a_machine_s_log_as_a_diagnosis_does(tmp_path):
    plans = [("single", ("quadratic_drag",), "faint"), ("single", ("position_dependent_friction",), "plain")]
    draw_cases(tmp_path, plans, seed=3)
    entries = json.loads((tmp_path / "key" / "key.json").read_text())["cases"]
    assert len(entries) == 2
    for name, entry in entries.items():
        measure(tmp_path / "cases" / name, entry, tmp_path / name)
        for line in json.loads((tmp_path / name).read_text())["oracle"]:
            assert line["augmented_rms"] < 2.0 * line["floor_rms"], (name, line["quantity"])


def test_report_holds_the_command_and_every_question(cases, scored):
    text = (cases / "report.md").read_text()
    assert "leactl gap blind score --cases cases --key key" in text
    assert "| one effect, faint: first cause right | >= 85 % | - | 0 of 0 | |" in text
    assert str(cases) not in text


def test_progress_tells_the_time_left(scored):
    assert "2 of 2 diagnosed, about 0.0 min left" in scored.stderr


def test_what_is_answered_is_not_done_again(cases, scored, monkeypatch):
    def again(*_):
        raise AssertionError("a case was done twice")

    monkeypatch.setattr("leactl.gap.blind.answers.diagnose", again)
    monkeypatch.setattr("leactl.gap.blind.check.measure", again)
    entries = json.loads((cases / "key" / "key.json").read_text())
    marks = checking.check([sets_of(cases)], lambda *_: entries, HERE, lambda _: None)
    assert [m.first for m in marks] == [entries["cases"][m.name]["effects"][0] for m in marks]


def test_a_key_of_other_runs_is_an_error_after_the_answers(cases, scored, tmp_path):
    (tmp_path / "key.json").write_text("{}")
    arguments = ["gap", "blind", "score", "--cases", str(cases / "cases"), "--key", str(tmp_path)]
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, InputError)
    assert result.exception.exit_status == 2
    assert "not the key of these runs" in str(result.exception)


def test_cases_that_are_still_being_made_are_refused_before_any_is_diagnosed(cases, tmp_path):
    half = tmp_path / "cases"
    shutil.copytree(cases / "cases", half)
    (half / "key.sha256").unlink()
    result = CliRunner().invoke(app, ["gap", "blind", "score", "--cases", str(half), "--key", str(cases / "key")])
    assert isinstance(result.exception, InputError)
    assert "once every case is made" in str(result.exception)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cases"]


def test_a_key_is_opened_after_the_last_answer_only(tmp_path, monkeypatch):
    for name in ("case-1", "case-2"):
        (tmp_path / "cases" / name).mkdir(parents=True)
        (tmp_path / "cases" / name / "nominal.yaml").touch()
    order = []
    monkeypatch.setattr("leactl.gap.blind.answers.answer", lambda case, out: order.append(case.name))

    def read_key(*_):
        order.append("key")
        return {"cases": {}}

    with pytest.raises(InputError, match="no such case"):
        checking.check([sets_of(tmp_path)], read_key, HERE, lambda _: None)
    assert order == ["case-1", "case-2", "key"]


def test_a_case_that_cannot_be_read_is_told_after_all_others(tmp_path, monkeypatch):
    done = []
    for name in ("case-1", "case-2", "case-3"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "nominal.yaml").touch()

    def answer(case, out):
        if case.name == "case-1":
            raise InputError("case-1: broken")
        done.append(case.name)

    monkeypatch.setattr("leactl.gap.blind.answers.answer", answer)
    with pytest.raises(InputError, match="case-1: broken"):
        checking.check([checking.Cases(tmp_path, tmp_path, tmp_path / "a")], lambda *_: {}, HERE, lambda _: None)
    assert done == ["case-2", "case-3"]


def half_a_second(out):
    time.sleep(0.5)
    out.write_text("done")


STOPPED = """
import sys
from pathlib import Path
from leactl.processes import Workers, each
from tests.gap.test_blind_score import half_a_second

if __name__ == "__main__":
    jobs = [(Path(sys.argv[1]) / str(number),) for number in range(400)]
    with Workers(2) as workers:
        each(half_a_second, jobs, workers, "done", lambda step: print(step, flush=True))
"""


@pytest.mark.long
def test_a_stop_keeps_what_is_done_and_ends_soon(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(STOPPED)
    (tmp_path / "out").mkdir()
    with subprocess.Popen(
        [sys.executable, str(script), str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": os.getcwd()},
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does it
        assert process.wait(timeout=60) != 0
    done = sorted((tmp_path / "out").iterdir())
    assert 1 <= len(done) < 400  # which would take a hundred seconds, were it not stopped
    assert {path.read_text() for path in done} == {"done"}


def test_a_folder_without_cases_is_an_error(tmp_path):
    with pytest.raises(InputError, match="no case in it"):
        checking.check([checking.Cases(tmp_path, tmp_path, tmp_path / "a")], lambda *_: {}, HERE, lambda _: None)


def answer_of(*causes, verdict="effect", where=(), shrinkage=(), parameters=()):
    named = [{"effect": name, "probability": p, "indistinguishable_from": peers} for name, p, peers in causes]
    return {
        "verdict": verdict,
        "causes": named,
        "where": list(where),
        "shrinkage": list(shrinkage),
        "calibration": list(parameters),
    }


def truth_of(*effects, kind="single", strength="plain", base=None):
    return Truth(kind, effects, (), strength, {}, base or {})


UNMEASURED = {"moved": [], "oracle": []}


def test_a_class_counts_as_reported_but_its_first_alone_as_first():
    answer = answer_of(("time_skew", 0.6, ["torque_sensor_lag"]), ("torque_sensor_lag", 0.4, []))
    result = mark("c", truth_of("torque_sensor_lag"), answer, UNMEASURED)
    assert result.reported == ("time_skew", "torque_sensor_lag")
    assert (result.first_right, result.in_set, result.all_named) == (False, True, True)


def test_a_pair_is_named_only_with_both():
    answer = answer_of(("cogging", 0.99, []), ("unbalance", 0.3, []))
    result = mark("c", truth_of("cogging", "unbalance", kind="pair"), answer, UNMEASURED)
    assert (result.first_right, result.all_named) == (True, False)


def test_an_unknown_is_owned_up_to_without_a_cause_only():
    truth = truth_of(kind="unknown")
    assert mark("c", truth, answer_of(verdict="unknown"), UNMEASURED).says_unknown
    assert not mark("c", truth, answer_of(("cogging", 0.7, []), verdict="effect"), UNMEASURED).says_unknown
    assert not mark("c", truth, answer_of(verdict="none"), UNMEASURED).says_unknown


def line(quantity, role="test", **values):
    return {"quantity": quantity, "role": role, "mechanical": "coupled", **values}


def test_where_is_right_on_a_channel_as_good_as_the_first():
    moved = [
        line("velocity", "load", by_effects=45.3, after_calibration=2.0),
        line("velocity", "test", by_effects=45.1, after_calibration=9.0),
        line("torque", by_effects=20.0, after_calibration=1.0),
    ]
    told = {"moved": moved, "oracle": []}
    first = mark("c", truth_of("unbalance"), answer_of(where=[line("velocity")]), told)
    assert (first.moved_right, first.left_right) == (True, True)
    other = mark("c", truth_of("unbalance"), answer_of(where=[line("velocity", "load")]), told)
    assert (other.moved_right, other.left_right) == (True, False)
    drowned = {"moved": [line("torque", by_effects=0.5, after_calibration=0.4)], "oracle": []}
    assert mark("c", truth_of("unbalance"), answer_of(where=[line("torque")]), drowned).moved_right is None


def test_shares_closed_have_the_oracles_gap_and_floor_in_common():
    told = {
        "moved": [line("torque", by_effects=5.0, after_calibration=4.0)],
        "oracle": [line("torque", calibrated_rms=1.1, augmented_rms=0.1, floor_rms=0.1)],
    }
    answer = answer_of(shrinkage=[line("torque", augmented_rms=0.6)])
    result = mark("c", truth_of("unbalance"), answer, told)
    assert (result.closed, result.oracle_closed) == (pytest.approx(0.5), pytest.approx(1.0))


def test_departures_leave_out_what_has_no_one_truth():
    parameters = [
        {"parameter": "rotor_inertia", "fitted": 2.0, "std": 0.5},
        {"parameter": "back_emf_constant", "fitted": 2.0, "std": 0.5},
        {"parameter": "bench.shaft_stiffness", "fitted": 1.0, "std": 0.5},
    ]
    base = {"rotor_inertia": 1.0, "back_emf_constant": 1.0, "bench.shaft_stiffness": 1.0}
    result = mark("c", truth_of("shaft_compliance", base=base), answer_of(parameters=parameters), UNMEASURED)
    assert result.departures == (Departure("rotor_inertia", 2.0),)


def test_wilson_interval_of_known_figures():
    low, high = Share("", "", 8, 10).interval
    assert (low, high) == (pytest.approx(0.4902, abs=1e-4), pytest.approx(0.9433, abs=1e-4))
    assert Share("", "", 10, 10).interval[1] == 1.0
    assert Share("", "", 0, 0).interval is None


def marks_of(stated, right):
    plain = Mark("c", truth_of("cogging"), "effect", (("cogging", 0.5),), ("cogging",), None, None, None, None, ())
    return [
        replace(plain, causes=(("cogging", p),), reported=("cogging",) if good else ("backlash",))
        for p, good in zip(stated, right, strict=True)
    ]


def test_sound_probabilities_have_no_calibration_error_and_the_skill_of_their_spread():
    random = np.random.default_rng(0)
    stated = np.repeat([0.05, 0.95], 5000)
    result = calibration(marks_of(stated, random.random(10_000) < stated))
    assert result.error < 0.01
    assert result.skill == pytest.approx(1 - 0.05 * 0.95 / 0.25, abs=0.02)
    assert [(b.low, b.count) for b in result.bins] == [(0.0, 5000), (0.9, 5000)]


def test_proud_probabilities_are_shown_up():
    result = calibration(marks_of([1.0] * 10, [True] * 6 + [False] * 4))
    assert result.error == pytest.approx(0.4)
    assert result.skill < 0


def test_every_miss_is_listed_with_what_was_said():
    answer = answer_of(("backlash", 0.9, []))
    misses = score([mark("case-7", truth_of("presliding"), answer, UNMEASURED)]).misses
    assert {(m.case, m.truth, m.answer) for m in misses} == {("case-7", "presliding, plain", "effect: backlash 0.90")}
    assert len(misses) == 3


def test_effects_that_no_record_tells_apart_count_as_one_and_others_do_not():
    truth = replace(truth_of("asymmetric_friction"), alike={"asymmetric_friction": ["current_sensor_offset"]})
    given = answer_of(("current_sensor_offset", 0.9, []), ("asymmetric_friction", 0.9, []))
    result = mark("c", truth, given, UNMEASURED)
    assert (result.first_right, result.in_set, result.all_named) == (True, True, True)
    assert not result.names_what_is_not_there
    further = answer_of(("asymmetric_friction", 0.9, []), ("cogging", 0.6, []))
    assert mark("c", truth, further, UNMEASURED).names_what_is_not_there


def gap(nominal, calibrated, augmented):
    return line("velocity", nominal_rms=nominal, calibrated_rms=calibrated, augmented_rms=augmented, floor_rms=0.1)


def test_a_gap_that_grew_is_told_where_something_was_named_or_recalibrated():
    parameters = [{"parameter": "rotor_inertia", "fitted": 2.0, "std": 0.5}]
    lines = [gap(1.0, 2.0, 3.0), gap(1.0, 0.5, 0.1)]
    given = answer_of(("cogging", 0.9, []), shrinkage=lines, parameters=parameters)
    result = mark("c", truth_of("cogging"), given, UNMEASURED)
    assert (result.effect_closes, result.calibration_closes) == (False, False)
    better = answer_of(("cogging", 0.9, []), shrinkage=[gap(2.0, 1.0, 0.2)], parameters=parameters)
    result = mark("c", truth_of("cogging"), better, UNMEASURED)
    assert (result.effect_closes, result.calibration_closes) == (True, True)
    quiet = mark("c", truth_of("cogging"), answer_of(shrinkage=lines), UNMEASURED)
    assert (quiet.effect_closes, quiet.calibration_closes) == (None, None)


def test_groups_show_each_machine_and_simulator_and_targets_follow_what_was_drawn():
    answer = answer_of(("cogging", 0.9, []))
    truths = [replace(truth_of("cogging"), machine=name, simulator="stepped") for name in ("spindle 1", "wheel 2")]
    result = score([mark(f"case-{k}", truth, answer, UNMEASURED) for k, truth in enumerate(truths)])
    assert {(group.by, group.name, group.cases) for group in result.groups} == {
        ("machine", "spindle 1", 1),
        ("machine", "wheel 2", 1),
    }
    assert result.shares[0].target == ">= 95 %"
    assert score([mark("c", truth_of("cogging"), answer, UNMEASURED)]).shares[0].target == ">= 98 %"


def test_a_report_cannot_take_the_place_of_the_answers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cases").mkdir()
    (tmp_path / "cases" / HASH_NAME).write_text("0\n")
    asked = ["gap", "blind", "score", "--cases", "cases", "--key", "key", "--out", "cases-answers"]
    completed = CliRunner().invoke(app, asked)
    assert isinstance(completed.exception, InputError)
    assert (
        str(completed.exception)
        == "--out cases-answers: is the folder that the answers go to; the name of a file was expected"
    )


def test_as_many_keys_as_sets_of_cases_are_needed(tmp_path):
    with pytest.raises(InputError, match="give one for each"):
        checking.Cases.side_by_side([tmp_path / "a", tmp_path / "b"], [tmp_path / "key"], [])


def test_parameters_are_compared_as_ratios_where_no_run_tells_a_torque():
    parameters = [
        {"parameter": "torque_constant", "fitted": 1.0, "std": 0.01},
        {"parameter": "rotor_inertia", "fitted": 3.0, "std": 0.5},
    ]
    truth = truth_of("cogging", base={"torque_constant": 2.0, "rotor_inertia": 4.0})
    result = mark("c", replace(truth, ratios_to="torque_constant"), answer_of(parameters=parameters), UNMEASURED)
    assert result.departures == (Departure("rotor_inertia", 2.0),)
