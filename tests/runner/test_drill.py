"""The drill of a bench: what an interlock that is gone lets through is found out; nothing of the user's is touched."""

import os
import signal
from pathlib import Path

import pytest
import yaml
from leactl_plugins.elmo_can.driver import ElmoCan

from leactl.bench import benchfile
from leactl.driver.contract import Confirmation
from leactl.emulation.bench.emulated_bench import observed
from leactl.emulation.faults import known_faults
from leactl.errors import InputError, Stopped
from leactl.runfile.verify.integrity import verify
from leactl.runner.drill import real
from leactl.runner.drill.emulated import EmulatedDrill
from leactl.runner.drill.real import Person, RealDrill
from tests.latches import latch_of, release, trip_of


def quietly(_what, _done, _count):
    return


@pytest.fixture
def bench(tmp_path):
    """The shipped emulated bench with some of its blocks changed."""

    def write(interlocks=None, without=(), **blocks):
        data = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
        for name in without:
            del data["interlocks"][name]
        data["interlocks"] |= interlocks or {}
        for name, block in blocks.items():
            data[name] |= block
        path = tmp_path / "mine.yaml"
        path.write_text(yaml.safe_dump(data, sort_keys=False))
        return str(path)

    return write


@pytest.fixture
def drill(tmp_path):
    def run(bench="emulated", *only, tell=quietly):
        return EmulatedDrill(bench, only, tmp_path, tell).run()

    return run


def by_name(drilled):
    results = {}
    for finding in drilled.findings:
        results.setdefault(finding.name, []).append(finding)
    return results


@pytest.mark.long
def test_the_shipped_bench_catches_its_whole_catalogue_and_ends_safe(drill):
    drilled = drill()
    assert [finding.faults for finding in drilled.findings if not finding.held] == []
    result = by_name(drilled)
    assert result.keys() | drilled.left_out.keys() == {"no_fault", "stop", *known_faults()}
    assert drilled.left_out.keys() == {"slow_disk", "supply_stuck_on", "supply_out_of_regulation", "cut_line"}
    assert {finding.on for finding in result["stuck_sensor"]} == {"torque_sensor", "drive_test", "drive_load"}
    assert all(verify(Path(finding.run)) == [] for finding in drilled.findings)


def test_times_count_from_the_fault_to_the_cycle_that_ended_and_to_zero_torque_at_the_plant(drill):
    result = by_name(drill("emulated", "bus_off", "drive_fault", "frozen_drive"))
    (bus_off,) = result["bus_off"]
    assert bus_off.ended_s == pytest.approx(0.01)  # it begins amid a cycle of 20 ms
    # the drives hear no heartbeat any more: 200 ms after the last, which is up to a third of that before the fault
    assert 0.2 - 0.067 - 0.01 <= bus_off.zero_torque_s <= 0.2 + 0.01
    assert [(end.confirmed, end.without_power) for end in bus_off.devices.values()] == [
        (False, True),
        (False, True),
        (True, None),
    ]
    assert result["drive_fault"][0].zero_torque_s <= 0.02
    frozen, _of_load = result["frozen_drive"]
    assert frozen.zero_torque_s is None
    assert (frozen.devices["drive_test"].confirmed, frozen.devices["drive_test"].without_power) == (False, False)
    assert frozen.notes == ["drive_test keeps its power until its supply is switched off, as was told"]


@pytest.mark.parametrize(
    ("without", "fault", "on"),
    [
        (["torque_disagreement"], "scaled_sensor", "torque_sensor"),
        pytest.param(["torque"], "stuck_sensor", "torque_sensor", marks=pytest.mark.long),
        (["angle", "velocity_disagreement"], "stuck_sensor", "drive_load"),
    ],
)
def test_a_bench_without_an_interlock_is_found_out(drill, bench, without, fault, on):
    drilled = drill(bench(without=without), fault)
    assert not drilled.held
    assert [finding.faults for finding in drilled.findings if finding.on == on and not finding.held] == [["not caught"]]


def test_a_current_sensor_that_is_off_is_caught_on_a_bench_that_asks_for_nothing(drill, bench):
    findings = drill(bench(without=["q_axis_current"]), "disconnected_sensor").findings
    assert [finding.held for finding in findings if finding.on == "drive_test"] == [True]


def test_an_interlock_that_takes_too_long_is_found_out(drill, bench):
    drilled = drill(bench({"torque_disagreement": {"tolerance_Nm": 2.0, "for_s": 0.9}}), "scaled_sensor")
    late = [finding for finding in drilled.findings if not finding.held]
    assert [finding.on for finding in late] == ["torque_sensor"]
    assert late[0].faults == ["caught after 0.67 s; 0.5 s were expected"]


def test_a_drive_that_is_called_safe_and_is_not_is_found_out(drill, monkeypatch):
    monkeypatch.setattr(ElmoCan, "safe_state", lambda self, _deadline_s: Confirmation(True, "said to be off"))
    monkeypatch.setattr(ElmoCan, "stop_now", lambda self: None)
    drilled = drill("emulated", "over_voltage")
    (finding,) = by_name(drilled)["over_voltage"]
    assert finding.faults == [
        "drive_test was confirmed safe and has power",
        "drive_load was confirmed safe and has power",
    ]


def test_a_bench_that_trips_by_itself_is_not_drilled_any_further(drill, bench):
    drilled = drill(bench({"velocity": {"trip_rad_s": 3}}), "bus_off")
    (finding,) = drilled.findings
    assert finding.faults[0].startswith("tripped: test velocity of 3.")
    assert drilled.left_out == {"bus_off": "a run without a fault did not pass"}
    assert not drilled.held


def test_latches_of_the_user_are_neither_heeded_nor_made_and_own_faults_of_the_bench_are_left_out(drill, bench):
    latch_of("emulated").set("before", None)
    before = dict(os.environ), trip_of("emulated")
    faults = {"faults": [{"fault": "bus_off", "at_s": 0.5, "bus": "can0"}]}
    assert drill(bench(emulated=faults), "over_voltage").held
    assert (dict(os.environ), trip_of("emulated")) == before
    release("emulated")
    assert drill("emulated", "over_voltage").held
    assert trip_of("emulated") is None


@pytest.mark.parametrize("setup", ["free", "locked"])
def test_other_set_ups_are_drilled_as_far_as_they_can_move(drill, bench, tmp_path, setup):
    text = f"setup: {setup}\n"
    path = bench()
    with open(path, "a") as file:
        file.write(text)
    assert drill(path, "frozen_drive", "lost_frames").findings[0].held


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_drill_whether_it_comes_in_a_run_or_between_two(drill, number):
    def tell(_what, done, _count):
        if done == 2:
            os.kill(os.getpid(), number)

    with pytest.raises(Stopped, match=f"stopped by {signal.Signals(number).name}"):
        drill("emulated", "bus_off", "drive_fault", tell=tell)


def test_a_signal_that_comes_as_a_run_closes_its_file_ends_the_drill(drill, monkeypatch):
    from leactl.runfile.write.writer import RunWriter

    made = RunWriter.close

    def close(self, *arguments):
        os.kill(os.getpid(), signal.SIGINT)
        made(self, *arguments)

    monkeypatch.setattr(RunWriter, "close", close)
    with pytest.raises(Stopped, match="stopped by SIGINT"):
        drill("emulated", "bus_off")


def test_what_cannot_be_drilled_is_refused(drill, bench):
    with pytest.raises(InputError, match="fault 'gremlins' is not known"):
        drill("emulated", "gremlins")
    with pytest.raises(InputError, match="bench 'testbed' is not emulated"):
        drill("testbed")
    path = bench()
    with open(path, "a") as file:
        file.write("setup: heated\n")
    with pytest.raises(InputError, match="set-up 'heated' with drives test, load: nothing could be moved"):
        drill(path)


# -- a real bench, whose devices are emulated in its place -------------------------------------------------------------


def test_a_sensor_that_a_person_unplugs_must_trip_and_leaves_the_bench_latched(tmp_path):
    seen = []

    def unplug(text):
        assert text.startswith("Unplug torque_sensor now")
        bench = seen[-1]
        bench.i2c_buses["i2c1"].silent.append(bench.far_ends["torque_sensor"])

    person = Person(lambda _text: True, unplug, True)
    with observed(seen.append):
        drilled = RealDrill("emulated", [real.UNPLUGGED], tmp_path, person).run()
    (finding,) = drilled.findings
    assert (finding.status, finding.faults) == ("failed", [])
    assert "not acknowledged" in finding.reason


def test_a_sensor_that_stays_plugged_and_a_key_that_nobody_presses_are_no_success(tmp_path):
    person = Person(lambda _text: True, lambda _text: None, True)
    drilled = RealDrill("emulated", [real.UNPLUGGED, real.KEY], tmp_path, person).run()
    assert [finding.faults for finding in drilled.findings] == [["not caught"], ["not caught"]]


def test_what_a_person_does_not_agree_to_is_left_alone(tmp_path):
    asked = []
    person = Person(asked.append, lambda _text: None, True)
    drilled = RealDrill("emulated", [], tmp_path, person).run()
    assert drilled.findings == []
    assert [text.split(":")[0] for text in asked] == [real.STOP, real.KEY, real.UNPLUGGED]
    assert "kill -9" in drilled.left_out[real.DEAD_MAN]
    assert "0.2 s" in drilled.left_out[real.DEAD_MAN]
