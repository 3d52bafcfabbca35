"""A run pauses at its next rest, in supervised cycles, and goes on; remarks stand in its record."""

import numpy as np
import pytest

from leactl.runfile.read.reader import Run
from leactl.runner import loop, operators, runs_underway
from tests.runner.conftest import SPIN
from tests.runner.test_operators import keyboard, typing  # noqa: F401 (a fixture)

RESTING = SPIN.replace(
    '  - mode: {test: "off"}\n',
    "  - hold: {role: test, current_A: 0.0, duration_s: 0.1}\n"
    "  - hold: {role: test, current_A: 0.5, duration_s: 0.3}\n"
    '  - mode: {test: "off"}\n',
)


def asking(ask):
    """Something asked of the run by another process, as an action at a moment."""

    def act(_bench):
        (run,), _faults = runs_underway.running()
        ask(run)
        run.close()

    return act


PAUSE, GO_ON = (asking(lambda run, wanted=wanted: run.ask_to_pause(wanted)) for wanted in (True, False))


def paused(outcome):
    with Run.open(outcome.path) as run:
        assert [step.name for step in run.steps].count("pause") <= 1
        step = next((step for step in run.steps if step.name == "pause"), None)
        reference = run.channel("q_axis_current_reference", role="test")
        messages = [event.message for event in run.events if event.source == "operator"]
    return step, reference, messages


def test_a_pause_begins_at_the_next_rest_commands_nothing_and_ends_when_asked(spin):
    outcome, bench = spin(RESTING, at=[(0.3, PAUSE), (3.0, GO_ON)])
    assert outcome.status == "complete"
    step, reference, messages = paused(outcome)
    with Run.open(outcome.path) as run:
        before = run.steps[run.steps.index(step) - 1]
    assert (before.parameters["current_A"], before.stop) == (0.0, step.start)
    assert 2.9 < step.stop < 3.1
    inside = (reference.time > step.start + 0.02) & (reference.time < step.stop)
    assert inside.sum() > 180
    assert not reference.values[inside].any()
    assert np.nanmax(reference.values[reference.time > step.stop]) == pytest.approx(0.5, abs=0.02)
    assert messages[0] == "paused"
    assert messages[1].startswith("went on after a pause of 2.")
    assert bench.far_ends["drive_test"].state == "disabled"


def test_a_pause_that_is_taken_back_before_a_rest_changes_nothing(spin):
    outcome, _bench = spin(RESTING, at=[(0.3, PAUSE), (0.5, GO_ON)])
    assert outcome.status == "complete"
    assert paused(outcome)[0] is None


def test_a_run_is_stopped_while_it_pauses(spin):
    outcome, _bench = spin(RESTING, at=[(0.3, PAUSE), (2.0, asking(lambda run: run.ask_to_stop()))])
    assert (outcome.status, outcome.reason) == ("stopped", runs_underway.STOP_CAUSE)
    assert paused(outcome)[0].stop == pytest.approx(2.0, abs=0.1)


def test_remarks_of_many_come_all_and_whole(spin):
    texts = [f"remark {number} {'x' * 200}" for number in range(300)]

    def all_at_once(run):
        for text in texts:
            run.remark(text)

    outcome, _bench = spin(at=[(0.3, asking(all_at_once))])
    with Run.open(outcome.path) as run:
        assert [e.message for e in run.events if e.source == "operator"] == [f"remark: {text}" for text in texts]


def test_a_stop_is_not_taken_back_by_the_end_of_a_pause(spin):
    def both(run):
        run.ask_to_stop()
        run.ask_to_pause(False)

    outcome, _bench = spin(RESTING, at=[(0.3, PAUSE), (2.0, asking(both))])
    assert outcome.status == "stopped"


def test_a_pause_that_nobody_ends_ends_the_run_in_order(spin, monkeypatch):
    monkeypatch.setattr(loop, "LONGEST_PAUSE_S", 1.5)
    outcome, _bench = spin(RESTING, at=[(0.3, PAUSE)])
    assert (outcome.status, outcome.reason) == ("stopped", "paused for 1.5 s")
    assert all(confirmation.safe for confirmation in outcome.safe.values())


def test_a_fault_ends_a_run_that_pauses(spin):
    def unplug(bench):
        bench.i2c_buses["i2c1"].silent.append(bench.far_ends["torque_sensor"])

    outcome, bench = spin(RESTING, at=[(0.3, PAUSE), (2.0, unplug)])
    assert outcome.status == "failed"
    assert outcome.error.exit_status == 5
    assert bench.far_ends["drive_test"].state == "disabled"


def test_the_key_p_begins_and_ends_a_pause(spin, keyboard):  # noqa: F811
    with operators.keyboard(shown=True) as keys:
        outcome, _bench = spin(
            RESTING,
            at=[(0.3, typing(keyboard, b"p")), (2.0, typing(keyboard, b"p"))],
            stops=[keys.pressed],
            pauses=[keys.pause_pressed],
        )
    assert outcome.status == "complete"
    assert paused(outcome)[0].stop == pytest.approx(2.0, abs=0.1)


def test_remarks_stand_in_the_record_with_the_moment_they_came(spin):
    texts = ("the bearing squeaks", 'Ölspur, "rechts"')
    outcome, _bench = spin(
        at=[(0.3, asking(lambda run: run.remark(texts[0]))), (0.6, asking(lambda run: run.remark(texts[1])))]
    )
    with Run.open(outcome.path) as run:
        told = [(event.time, event.message) for event in run.events if event.source == "operator"]
    assert [message for _, message in told] == [f"remark: {text}" for text in texts]
    assert told[0][0] == pytest.approx(0.3, abs=0.25)
