"""Whole runs over the emulated wires: what ends up in the file, and how the bench is left on every kind of end."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from leactl.bench import benchfile
from leactl.driver.far_end import Frame
from leactl.errors import DeviceError, DeviceFault, InputError, LeactlError, NoAnswer, SafetyTrip
from leactl.protocol import protocolfile
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from tests.latches import latch_of, release, trip_of
from tests.runner.conftest import SPIN


def drives_off(bench):
    return [bench.far_ends[name].state for name in ("drive_test", "drive_load")] == ["disabled", "disabled"]


def recorded(outcome, quantity, role="test"):
    with Run.open(outcome.path) as run:
        return run.channel(quantity, role)


def test_a_run_records_what_the_plan_asked_for_and_leaves_the_bench_safe(spin):
    outcome, bench = spin()
    assert (outcome.status, outcome.error) == ("complete", None)
    assert all(confirmation.safe for confirmation in outcome.safe.values())
    assert drives_off(bench)
    assert verify(outcome.path) == []
    with Run.open(outcome.path) as run:
        assert [step.name for step in run.steps] == ["hold", "hold"]
        hold = run.steps[1]
        assert hold.parameters["current_A"] == 0.7
        assert hold.stop - hold.start == pytest.approx(0.6, abs=1e-9)
        reference = run.channel("q_axis_current_reference", "test")
        inside = (reference.time > hold.start + 1e-9) & (reference.time < hold.stop + 1e-9)  # what was followed
        assert inside.sum() == 60
        # a demand goes out in whole per mille of the drive's rated current: 13.7 mA
        np.testing.assert_allclose(reference.values[inside], 0.7, atol=0.007)
        assert run.attributes["actuator"] == "a1"
        assert run.mechanical == "free"
        assert run.source("protocol") == SPIN
        assert run.source("bench") == (benchfile.SHIPPED / "emulated.yaml").read_text()
        assert "torque_constant: 0.49" in run.source("model")
        assert ("emulation", "seed = 3") in [(event.source, event.message) for event in run.events]


def test_velocity_approaches_what_friction_and_torque_constant_give(spin):
    outcome, _bench = spin(sets=("hold_s=2",))
    velocity = recorded(outcome, "velocity")
    assert np.mean(velocity.values[-60:-5]) == pytest.approx((0.49 * 0.7 - 0.208) / 0.0238, rel=0.03)


def test_the_same_seed_gives_the_same_samples_and_another_seed_others(spin):
    first, second, other = (recorded(spin(sets=(f"seed={seed}",))[0], "q_axis_current") for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.values, second.values)
    assert not np.array_equal(first.values, other.values)


def test_conditions_of_the_emulated_bench_change_its_friction(spin):
    light, _ = spin(condition="unloaded", sets=("hold_s=2", "current_A=1"))
    heavy, _ = spin(condition="loaded", sets=("hold_s=2", "current_A=1"))
    assert np.nanmax(recorded(light, "velocity").values) > np.nanmax(recorded(heavy, "velocity").values) + 1
    with pytest.raises(InputError, match=r"condition 'icy' is not one of .*: unloaded, design, loaded"):
        spin(condition="icy")


# -- ends --------------------------------------------------------------------------------------------------------------


def bench_file(tmp_path, **limits):
    text = (benchfile.SHIPPED / "emulated.yaml").read_text()
    for name, value in limits.items():
        line = next(line for line in text.splitlines() if line.strip().startswith(f"{name}:"))
        text = text.replace(line, f"  {name}: {value}")
    path = tmp_path / "bench.yaml"
    path.write_text(text)
    return str(path)


def test_a_trip_ends_the_run_latches_the_bench_and_refuses_the_next(spin, tmp_path):
    bench_path = bench_file(tmp_path, velocity_rad_s=5)
    outcome, bench = spin(bench=bench_path)
    assert isinstance(outcome.error, SafetyTrip)
    assert outcome.status == "tripped"
    assert "test velocity of" in outcome.reason
    assert drives_off(bench)
    velocity = recorded(outcome, "velocity").values
    assert velocity[-1] > 5 >= velocity[-2]  # the sample that tripped is the last one in the file
    with Run.open(outcome.path) as run:
        assert run.attributes["status"] == "tripped"
        assert run.steps[-1].stop < run.steps[-1].start + 0.6
    with pytest.raises(SafetyTrip, match=f"leactl bench reset {bench_path}"):
        spin(bench=bench_path)
    trip = trip_of("emulated")
    assert trip.run == str(outcome.path)
    assert spin()[0].status == "complete"  # the shipped file of the same name
    release("emulated")
    assert spin(bench=bench_path)[0].status == "tripped"


def test_a_damaged_latch_holds_the_bench(spin):
    path = Path(latch_of("emulated").paths[0])
    path.parent.mkdir(parents=True)
    path.write_text("{")
    with pytest.raises(SafetyTrip, match="cannot be read"):
        spin()


def test_a_drive_that_a_failed_start_does_not_confirm_safe_latches_the_bench(spin):
    def freeze(bench):
        bench.far_ends["drive_test"].frozen = True

    with pytest.raises(DeviceError, match="NOT CONFIRMED SAFE"):
        spin(at=[(0.0, freeze)])
    with pytest.raises(SafetyTrip, match="NOT CONFIRMED SAFE"):
        spin()


def test_a_tare_keeps_the_readings_that_a_condition_asks_for(spin):
    text = """
name: tared
setup: locked
rate_Hz: 100
steps:
  - hold: {duration_s: 1.1}
  - tare: {samples: 3}
  - when: {quantity: bus_voltage, role: test, above: 10, unit: V, steps: [{hold: {name: first, duration_s: 0.1}}]}
  - tare: {samples: 5}
  - when: {quantity: torque, role: test, above: -100, unit: N*m, steps: [{hold: {name: second, duration_s: 0.1}}]}
"""
    outcome, _bench = spin(text)
    with Run.open(outcome.path) as run:
        assert [step.name for step in run.steps if step.name in ("first", "second")] == ["first", "second"]


def test_a_cable_pulled_out_fails_the_run_and_says_what_is_not_confirmed(spin):
    def pull(bench):
        bench.wires["can0"].cut = True

    outcome, bench = spin(at=[(0.4, pull)])
    assert isinstance(outcome.error, SafetyTrip)  # the exchange falls silent long before the heartbeat runs out
    assert outcome.status == "tripped"
    assert "no reading for 0.0" in outcome.reason
    assert not outcome.safe["drive_test"].safe
    assert any("NOT CONFIRMED SAFE" in note for note in outcome.error.__notes__)
    assert drives_off(bench)  # by their own dead-man
    current = recorded(outcome, "q_axis_current")
    assert np.isnan(current.values[-1])  # nothing is invented while nothing comes
    assert np.isfinite(current.values[:20]).all()


def test_an_emergency_ends_the_run_with_its_code_in_words(spin):
    outcome, bench = spin(at=[(0.4, lambda bench: bench.far_ends["drive_test"].fault(0x2310))])
    assert isinstance(outcome.error, DeviceFault)
    assert "0x2310" in outcome.reason
    assert bench.far_ends["drive_test"].state == "fault"
    assert bench.far_ends["drive_load"].state == "disabled"
    assert len(recorded(outcome, "velocity").values) > 20


def test_a_frozen_drive_is_noticed(spin):
    def freeze(bench):
        bench.far_ends["drive_test"].frozen = True

    outcome, _bench = spin(at=[(0.4, freeze)])
    assert isinstance(outcome.error, SafetyTrip)
    assert "test q_axis_current: no reading for 0.0" in outcome.reason
    assert not outcome.safe["drive_test"].safe
    assert outcome.safe["drive_load"].safe


def test_a_drive_in_fault_at_start_is_refused_before_anything_moves(spin):
    with pytest.raises(DeviceFault, match="drive_test: in fault at start"):
        spin(at=[(0.0, lambda bench: bench.far_ends["drive_test"].fault(0x7300))])


class Babbler:
    """A node that answers every frame with a hundred of its own, the most urgent ones."""

    due = math.inf

    def receive(self, frame, now):
        return [Frame(0x001, b"\xff" * 8)] * 100

    def tick(self, now):
        return []


def test_a_babbling_node_delays_nothing_that_matters(spin):
    outcome, bench = spin(at=[(0.0, lambda bench: bench.wires["can0"].attach(Babbler()))])
    assert outcome.status == "complete"
    assert drives_off(bench)


def test_a_silent_sensor_trips_by_its_age(spin, tmp_path):
    bench_path = bench_file(tmp_path, age_s=0.3)
    stuck = [(0.3, lambda bench: setattr(bench.far_ends["torque_sensor"], "_ends", 1e9))]
    outcome, bench = spin(at=stuck, bench=bench_path)
    assert outcome.status in ("failed", "tripped")
    assert "conversion has not ended" in outcome.reason or "no reading" in outcome.reason
    assert drives_off(bench)


def test_i2c_that_stops_acknowledging_fails_the_run(spin):
    outcome, bench = spin(at=[(0.4, lambda bench: bench.i2c_buses["i2c1"].devices.clear())])
    assert isinstance(outcome.error, NoAnswer)
    assert "0x48: not acknowledged" in outcome.reason
    assert drives_off(bench)


def test_a_programming_error_still_leaves_the_bench_safe(spin, monkeypatch):
    from leactl.runner.loop import Loop

    def explode(self, action):
        raise RuntimeError("no such luck")

    monkeypatch.setattr(Loop, "_move", explode)
    outcome, bench = spin()
    assert isinstance(outcome.error, RuntimeError)
    assert (outcome.status, outcome.reason) == ("failed", "no such luck")
    assert drives_off(bench)
    assert verify(outcome.path) == []


ANGLE = """
name: angle
setup: free
rate_Hz: 50
steps:
  - mode: {test: angle}
  - hold: {role: test, angle_rad: 0, duration_s: 0.1}
  - ramp: {role: test, to_angle_rad: 2, rate_rad_s: 20}
  - hold: {role: test, angle_rad: $to_rad, duration_s: 0.4}
parameters: {to_rad: 2}
"""


def test_an_angle_is_reached_by_a_ramp_and_never_by_a_leap(spin):
    outcome, _bench = spin(ANGLE, sets=())
    assert outcome.status == "complete"
    assert recorded(outcome, "angle").values[-1] == pytest.approx(2, abs=0.2)
    outcome, bench = spin(ANGLE, sets=("to_rad=20",))
    assert isinstance(outcome.error, SafetyTrip)
    assert "test angle_reference of 20 rad is 18.4 rad from 1.6 rad" in outcome.reason
    assert np.nanmax(recorded(outcome, "angle_reference").values) <= 1.6 + 1e-3
    assert drives_off(bench)


def test_a_slow_disk_before_the_loop_begins_ages_nothing(spin, monkeypatch):
    from leactl.emulation.bench.emulated_bench import EmulatedBench
    from leactl.runner import preparation, run_head

    clocks, wired, made = [], preparation.wiring_of, run_head.RunWriter

    def wiring(request) -> EmulatedBench:
        clocks.append((bench := wired(request)).clock)
        return bench

    def slow(*arguments):
        clocks[0].sleep_until(clocks[0].now() + 3.0)
        return made(*arguments)

    monkeypatch.setattr(preparation, "wiring_of", wiring)
    monkeypatch.setattr(run_head, "RunWriter", slow)
    outcome, _bench = spin()
    assert (outcome.status, outcome.reason) == ("complete", "")


# -- refusals ----------------------------------------------------------------------------------------------------------


def test_setpoints_above_the_limits_are_refused_before_the_run(spin, tmp_path):
    with pytest.raises(InputError, match="test q_axis_current_reference: 35 A is above the bench limit of 30 A"):
        spin(sets=("current_A=35",))
    assert not (tmp_path / "runs").exists()


def test_a_loop_too_slow_for_the_drives_dead_man_is_refused_at_the_door(spin, tmp_path):
    slow = "rate_Hz: 14 Hz is too slow for drive_test, which stops after 0.2 s without the host; at least 15 Hz was"
    with pytest.raises(InputError) as caught:
        spin(SPIN.replace("rate_Hz: 100", "rate_Hz: 14"))
    assert [fault[: len(slow)] for fault in caught.value.faults] == [slow, slow.replace("_test", "_load")]
    assert not (tmp_path / "runs").exists()
    assert spin(SPIN.replace("rate_Hz: 100", "rate_Hz: 15"))[0].status == "complete"


def test_a_bench_in_another_setup_is_refused(spin, tmp_path):
    path = tmp_path / "locked.yaml"
    path.write_text((benchfile.SHIPPED / "emulated.yaml").read_text() + "setup: locked\n")
    with pytest.raises(InputError, match="protocol 'spin' needs set-up 'free'; bench 'emulated' is 'locked'"):
        spin(bench=str(path))


@pytest.mark.parametrize("word", ["seed=-1", "seed=1.5", "seed=", "seed=99999999999999999999"])
def test_a_seed_is_a_whole_number(spin, word):
    with pytest.raises(InputError, match="seed"):
        spin(sets=(word,))


def test_an_unusable_directory_leaves_the_bench_safe(spin, tmp_path):
    (tmp_path / "runs").write_text("in the way")
    with pytest.raises(LeactlError, match="cannot create the run file"):
        spin()


# -- actions -----------------------------------------------------------------------------------------------------------


def test_tare_moves_the_zero_that_the_run_then_records(spin, tmp_path):
    text = SPIN.replace("  - mode: {test: current}\n", "  - tare: {samples: 20}\n  - mode: {test: current}\n", 1)
    bench = tmp_path / "offset.yaml"
    shipped = (benchfile.SHIPPED / "emulated.yaml").read_text()
    bench.write_text(shipped + "  effects: [{name: torque_sensor_offset, offset: 0.25}]\n")
    outcome, _bench = spin(text, bench=str(bench))
    planned = protocolfile.load(str(tmp_path / "protocol.yaml")).duration_s
    assert planned == pytest.approx(0.2 + 0.8)
    assert planned <= outcome.duration_s < planned + 0.15  # of enabling
    torque = recorded(outcome, "torque")
    assert np.mean(torque.values[:15]) == pytest.approx(0.25, abs=0.01)
    assert np.mean(torque.values[-15:]) == pytest.approx(0.0, abs=0.01)


def test_wait_until_goes_on_when_the_reading_is_there_and_gives_up_in_time(spin):
    off = '  - mode: {test: "off"}'
    wait = "  - wait_until: {quantity: velocity, role: test, above: 2.0, unit: rad/s, timeout_s: 1}\n"
    text = SPIN.replace(off, wait + off)
    outcome, _bench = spin(text)
    assert outcome.status == "complete"
    outcome, bench = spin(text.replace("above: 2.0", "above: 35.0"))
    assert "35" in outcome.reason
    assert outcome.status == "failed"
    assert drives_off(bench)


def test_the_loop_goes_on_while_the_operator_is_asked(spin):
    text = SPIN.replace("steps:\n", 'steps:\n  - prompt: "Lock the shaft"\n')
    polls = []

    def slow(_text):
        return lambda: len(polls) >= 50 or polls.append(1)

    outcome, _bench = spin(text, operator=slow)
    assert outcome.status == "complete"
    assert len(recorded(outcome, "velocity").time[recorded(outcome, "velocity").time < 0.5]) == 50
    with Run.open(outcome.path) as run:
        assert [e.message for e in run.events if e.source == "operator"] == ["asked: Lock the shaft", "confirmed"]


def test_recording_slower_than_the_loop_keeps_every_nth_cycle(spin):
    text = SPIN.replace("rate_Hz: 100\n", "rate_Hz: 100\nrecord_Hz: 20\n")
    outcome, _bench = spin(text)
    time = recorded(outcome, "velocity").time
    assert time[0] == pytest.approx(0.0, abs=1e-9)  # the first cycle is one of them
    np.testing.assert_allclose(np.diff(time), 0.05, atol=1e-9)


def test_events_hold_the_resolved_parameters(spin):
    outcome, _bench = spin(sets=("current_A=0.75",))
    with Run.open(outcome.path) as run:
        told = [event.message for event in run.events if event.source == "protocol"]
    assert "current_A = 0.75" in told
    assert json.dumps(0.75) in told[0]
