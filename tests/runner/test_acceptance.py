"""Acceptance limits: judged in their own unit, and refused before a run where no analysis could judge them."""

import importlib
import pkgutil
from dataclasses import replace
from pathlib import Path

import pytest

import leactl.analysis.experiments
from leactl.analysis import analyze, registry
from leactl.analysis.estimate import NAN, Estimate, Result
from leactl.errors import InputError
from leactl.protocol import protocolfile, shipped
from leactl.protocol.plan import Acceptance
from leactl.runner.acceptance import check_analysis, judge_run_file
from leactl.runner.request import prepare
from tests.runner.conftest import SPIN

LIMIT = "acceptance:\n  - {result: coulomb_friction, high: 1, unit: N*m}\n"
FOUND = {
    "rotor_inertia": (0.00240022, "kg*m^2"),
    "coulomb_friction": (0.2078, "N*m"),
    "settling_time": (0.05, "s"),
    "bandwidth": (10.0, "Hz"),
    "winding_rise": (40.0, "K"),
}


@pytest.fixture
def analysed(monkeypatch):
    """An analysis that finds FOUND; the list tells which runs it was asked about."""
    asked = []

    def analyze_runs(paths):
        asked.append(list(paths))
        rows = (Estimate(name, value, NAN, NAN, NAN, units) for name, (value, units) in FOUND.items())
        return Result("a trial", ("run.h5",), tuple(rows))

    monkeypatch.setattr(analyze, "analyze_runs", analyze_runs)
    return asked


def judged(*limits):
    plan = replace(protocolfile.load("friction"), acceptance=tuple(Acceptance(*limit) for limit in limits))
    return judge_run_file(plan, Path("run.h5"))


@pytest.mark.parametrize(
    ("limit", "value", "line"),
    [
        (("coulomb_friction", 0.1, 0.3, "N*m"), 0.2078, None),
        (("coulomb_friction", 0, 1, "mN*m"), 207.8, "coulomb_friction is 207.8 mN*m, 0 to 1 was required"),
        (("coulomb_friction", 200, 210, "mN*m"), 207.8, None),
        (("settling_time", 0, 60, "ms"), 50, None),
        (("settling_time", 0, 40, "ms"), 50, "settling_time is 50 ms, 0 to 40 was required"),
        (("bandwidth", 62, 63, "rad/s"), 62.8318530717958, None),
    ],
)
def test_a_value_is_judged_and_told_in_the_unit_of_its_limit(analysed, limit, value, line):
    rows, unmet = judged(limit)
    expected = {"result": limit[0], "value": pytest.approx(value), "units": limit[3], "met": line is None}
    assert rows == [expected]
    assert unmet == ([f"acceptance: {line}"] if line else [])


@pytest.mark.parametrize(
    "limit",
    [
        ("rotor_inertia", 0, 0.003, "N*m"),
        ("rotor_inertia", 2, 3, "g*m^2"),
        ("winding_rise", 0, 100, "degC"),  # a rise of 40 K is none of 313 K less 273 K
        ("winding_rise", 0, 100, "degF"),
    ],
)
def test_a_limit_in_a_unit_that_the_result_cannot_be_told_in_is_not_met(analysed, limit):
    name, unit = limit[0], limit[3]
    value, units = FOUND[name]
    rows, unmet = judged(limit)
    assert rows == [{"result": name, "value": value, "units": units, "met": False}]
    assert unmet == [f"acceptance: {name} is {value:.6g} {units}, its limit is in {unit}; write the limit in {units}"]


def test_a_run_is_analysed_once_for_all_its_limits(analysed):
    rows, unmet = judged(("coulomb_friction", 0, 1, "N*m"), ("bandwidth", 0, 1, "Hz"), ("backlash", 0, 1, "rad"))
    assert analysed == [[Path("run.h5")]]
    assert [row["met"] for row in rows] == [True, False, False]
    assert unmet[0] == "acceptance: bandwidth is 10 Hz, 0 to 1 was required"
    assert unmet[1].startswith("acceptance: backlash is not known, 0 to 1 was required: a trial has no result")


def refused(text, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        prepare(str(path), "emulated", [], "", "", "", tmp_path, realtime=False)
    return [fault.removeprefix(str(path)) for fault in caught.value.faults]


def test_an_analysis_that_is_not_known_is_refused_before_a_device_is_touched(tmp_path):
    known = ", ".join(registry.names())
    text = SPIN.replace("rate_Hz", "analysis: coastdown\nrate_Hz")
    assert refused(text, tmp_path) == [f":4:11  analysis: 'coastdown' is not known; known: {known}"]


def test_limits_that_nothing_would_judge_are_refused(tmp_path):
    (fault,) = refused(SPIN + LIMIT, tmp_path)
    assert fault.startswith(":12:3  acceptance: the protocol names no analysis to judge them by; known: back-drive, ")


@pytest.mark.parametrize(
    "text",
    [
        SPIN,
        SPIN.replace("rate_Hz", "analysis: coast_down\nrate_Hz") + LIMIT,
        SPIN.replace("name: spin", "name: friction") + LIMIT,  # analysed as what it is named
    ],
)
def test_what_can_be_judged_is_let_pass(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    assert prepare(str(path), "emulated", [], "", "", "", tmp_path, realtime=False).plan.text == text


def test_the_known_analyses_are_those_that_can_be_imported():
    room = leactl.analysis.experiments
    modules = [module.name for module in pkgutil.iter_modules(room.__path__)]
    results = [name for name in modules if hasattr(importlib.import_module(f"{room.__name__}.{name}"), "analyze")]
    assert registry.names() == sorted(name.replace("_", "-") for name in results)
    assert not analyze.is_known("intervals")


@pytest.mark.parametrize("name", shipped.names())
def test_every_protocol_that_ships_names_an_analysis_that_is_there(name):
    check_analysis(protocolfile.load(name), name)


@pytest.mark.parametrize(
    ("limit", "fault"),
    [
        (
            "{result: torque_konstant, low: 0.4, unit: N*m/A}",
            ":12:14  acceptance[0].result: torque-constant has no result 'torque_konstant'; torque_constant was",
        ),
        (
            "{result: torque_constant, low: 0.4, unit: Nm}",
            ":12:47  acceptance[0].unit: 'Nm': torque_constant is in N*m/A",
        ),
        ("{result: r_squared, low: 0.9, unit: N*m}", ":12:41  acceptance[0].unit: 'N*m': r_squared is in 1"),
        (
            "{channel: torqe, statistic: max, high: 1, unit: N*m}",
            ":12:15  acceptance[0].channel: 'torqe': quantity 'torqe' is not in the vocabulary; known: ",
        ),
        (
            "{channel: torque, statistic: max, high: 1, unit: A}",
            ":12:54  acceptance[0].unit: 'A': torque is in N*m; one of N*m, mN*m, ",
        ),
        (
            "{channel: torque, step: hodl, statistic: max, high: 1, unit: N*m}",
            ":12:29  acceptance[0].step: 'hodl' is the name of no step; hold was expected",
        ),
        (
            "{channel: torque, statistic: mean, high: 1, unit: N*m, stop: true}",
            ":12:66  acceptance[0].stop: max with high, or min with low, is what can be known before a step is over",
        ),
        ("{channel: torque, statistic: max, unit: N*m}", ":12:5  acceptance[0]: low, high or both were expected"),
        (
            "{channel: torque, statistic: max, low: 2, high: 1, unit: N*m}",
            ":12:44  acceptance[0].low: 2 is above high (1)",
        ),
        ("{channel: torque, statistic: peak, high: 1, unit: N*m}", ":12:34  acceptance[0].statistic: 'peak': 'mean', "),
    ],
)
def test_a_limit_that_nothing_could_meet_is_refused_before_the_run(tmp_path, limit, fault):
    text = SPIN.replace("rate_Hz", "analysis: torque-constant\nrate_Hz").lstrip("\n")
    (told,) = refused(f"{text}acceptance:\n  - {limit}\n", tmp_path)
    assert told.startswith(fault)


@pytest.mark.parametrize("name", registry.names())
def test_every_experiment_declares_its_results(name):
    assert analyze.results_of(name) or name == analyze.GENERIC_ANALYSIS  # its results are named by the run's steps
