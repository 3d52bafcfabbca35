"""Every fault in a whole run: what ends it, how fast, and whether the drives are as they are said to be."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from leactl.bench import benchfile
from leactl.emulation.faults import known_faults
from leactl.errors import DeviceError, DeviceFault
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from tests.latches import release
from tests.runner.conftest import SPIN

LOADED = """
name: loaded
setup: coupled
rate_Hz: 100
steps:
  - mode: {load: velocity, test: current}
  - hold: {role: load, velocity_rad_s: 5, duration_s: 0.5}
  - hold: {role: test, current_A: 4, duration_s: 3}
  - mode: {test: "off", load: "off"}
"""
AT_S = 1.5
DRIVES = {"drive_test", "drive_load"}
SILENT = "test q_axis_current: no reading for 0.05"


class End(NamedTuple):
    """How a run ends."""

    status: str
    reason: str
    within_s: float
    unconfirmed: frozenset[str] = frozenset()
    energised: frozenset[str] = frozenset()


CAUGHT = [
    ("{fault: lost_frames, bus: can0}", End("tripped", SILENT, 0.05, DRIVES)),
    ("{fault: lost_frames, bus: can0, for_s: 0.2}", End("tripped", SILENT, 0.05)),
    ("{fault: lost_frames, bus: can0, direction: to_host}", End("tripped", SILENT, 0.05, DRIVES)),
    ("{fault: lost_frames, bus: can0, direction: to_devices}", End("tripped", SILENT, 0.05, DRIVES)),
    ("{fault: late_frames, bus: can0, delay_s: 0.1, direction: to_host}", End("tripped", SILENT, 0.05)),
    (
        "{fault: late_frames, bus: can0, delay_s: 0.04, direction: to_host}, "
        "{fault: late_frames, at_s: 2, bus: can0, delay_s: 0.04, direction: to_host}",
        End("tripped", SILENT, 0.05),
    ),
    ("{fault: bus_off, bus: can0}", End("failed", "bus 'can0': cannot send 0x201: Failed to transmit", 0.01, DRIVES)),
    (
        "{fault: saturated_sensor, device: torque_sensor, quantity: torque}",
        End("tripped", "input torque is saturated at +6.144 V", 0.02),
    ),
    (
        "{fault: saturated_sensor, device: drive_test, quantity: q_axis_current, end: low}",
        End("tripped", "test q_axis_current of -448.9 A fell below the limit of -30 A", 0.02),
    ),
    (
        "{fault: noisy_sensor, device: torque_sensor, quantity: torque, spread: 6, unit: N*m}",
        End("tripped", "", 0.3),
    ),
    (
        "{fault: noisy_sensor, device: drive_test, quantity: velocity, spread: 5, unit: rad/s}",
        End("tripped", "test velocity is ", 2.0),
    ),
    (
        "{fault: disconnected_sensor, device: torque_sensor}",
        End("failed", "bus 'i2c1', address 0x48: not acknowledged (errno 121)", 0.01),
    ),
    (
        "{fault: frozen_drive, device: drive_test}",
        End("tripped", SILENT, 0.05, {"drive_test"}, {"test"}),
    ),
    (
        "{fault: frozen_drive, device: drive_load}",
        End("tripped", SILENT.replace("test", "load"), 0.05, {"drive_load"}, {"load"}),
    ),
    (
        "{fault: drive_fault, device: drive_test, code: 0x2340}",
        End("failed", "drive_test: emergency 0x2340 (short circuit)", 0.01),
    ),
    ("{fault: heartbeat_loss, device: drive_test}", End("failed", "drive_test: no heartbeat of node 1 for 0.3", 0.36)),
    (
        "{fault: heartbeat_loss, device: drive_test, answers: true}",
        End("tripped", SILENT, 0.05, {"drive_test"}),
    ),
    (
        "{fault: over_voltage, bus_voltage_V: 75}",
        End("tripped", "test bus_voltage of 75 V passed the limit of 60 V", 0.21),
    ),
    (
        "{fault: under_voltage, bus_voltage_V: 12}",
        End("tripped", "test bus_voltage of 12 V fell below the limit of 20 V", 0.21),
    ),
    (
        "{fault: under_voltage, bus_voltage_V: 12, for_s: 0.3}",
        End("tripped", "test bus_voltage of 12 V fell below the limit of 20 V", 0.21),
    ),
    ("{fault: clock_jump, jump_s: 1}", End("failed", "drive_test: no heartbeat of node 1 for 1.0", 1.01)),
    ("{fault: clock_jump, jump_s: -1}", End("tripped", "the bench's clock went back by 0.99 s", 0.02)),
    ("{fault: clock_jump, jump_s: -0.05}", End("tripped", "the bench's clock went back by 0.04 s", 0.02)),
    (
        "{fault: stuck_sensor, device: torque_sensor, quantity: torque}",
        End("tripped", "test torque has been exactly ", 2.0),
    ),
    (
        "{fault: stuck_sensor, device: drive_test, quantity: velocity}",
        End("tripped", "test velocity has been exactly ", 2.0),
    ),
    (
        "{fault: stuck_sensor, device: drive_test, quantity: q_axis_current}",
        End("tripped", "test q_axis_current has been exactly ", 2.0),
    ),
    (
        "{fault: stuck_sensor, device: drive_load, quantity: angle}",
        End("tripped", "load velocity is ", 2.0),
    ),
    (
        "{fault: disconnected_sensor, device: torque_sensor, quantity: torque}",
        End("tripped", "test q_axis_current of 4.01 A contradicts test torque, by which 0.667", 0.3),
    ),
    (
        "{fault: disconnected_sensor, device: drive_test, quantity: q_axis_current}",
        End("tripped", "test q_axis_current of 0 A contradicts test torque, by which ", 0.3),
    ),
    (
        "{fault: scaled_sensor, device: torque_sensor, quantity: torque, gain: 4}",
        End("tripped", "test q_axis_current of 4.01 A contradicts test torque, by which 1", 0.3),
    ),
    (
        "{fault: scaled_sensor, device: drive_test, quantity: q_axis_current, gain: 1000}",
        End("tripped", "test q_axis_current of 448.9 A passed the limit of 30 A", 0.02),
    ),
]

# tests/emulation/test_supply_feeds_the_bench.py, tests/runner/test_serial_runs.py
ELSEWHERE = {"supply_stuck_on", "supply_out_of_regulation", "cut_line"}


@pytest.fixture
def rehearse(spin, tmp_path):
    """Run the protocol on a bench with these faults, at `AT_S` where they do not say when."""

    def rehearse(faults, text=LOADED, **options):
        if faults.count("at_s") < faults.count("fault:"):
            faults = faults.replace("}", f", at_s: {AT_S}}}", 1)
        path = tmp_path / "rehearsal.yaml"
        path.write_text((benchfile.SHIPPED / "emulated.yaml").read_text() + f"  faults: [{faults}]\n")
        return spin(text, bench=str(path), condition="", **options)

    return rehearse


def test_the_protocol_is_complete_where_nothing_goes_wrong(rehearse):
    outcome, _bench = rehearse("{fault: bus_off, at_s: 1000, bus: can0}")
    assert (outcome.status, outcome.overruns) == ("complete", 0)
    assert outcome.duration_s > AT_S + 1.1


@pytest.mark.parametrize(("fault", "end"), CAUGHT, ids=[fault[8:].rstrip("}") for fault, _end in CAUGHT])
def test_a_fault_ends_the_run_in_time_and_what_is_said_of_the_drives_is_true(rehearse, fault, end):
    outcome, bench = rehearse(fault)
    assert (outcome.status, outcome.reason[: len(end.reason)]) == (end.status, end.reason)
    assert AT_S - 1e-9 <= outcome.duration_s <= AT_S + end.within_s + 1e-9
    assert {name for name, confirmation in outcome.safe.items() if not confirmation.safe} == end.unconfirmed
    assert {role for role, actuator in bench.rig.actuators.items() if actuator.mode != "off"} == end.energised
    assert verify(outcome.path) == []


def test_a_fault_that_is_there_from_the_start_is_met_when_the_bench_is_opened(rehearse):
    with pytest.raises(DeviceFault, match=r"drive_test: in fault at start, .*0x7380 \(feedback loss\)"):
        rehearse("{fault: drive_fault, at_s: 0, device: drive_test, code: 0x7380}")


def test_a_cycle_that_a_clock_jump_has_lost_is_noted(rehearse):
    outcome, _bench = rehearse("{fault: clock_jump, jump_s: 0.035}")
    assert (outcome.status, outcome.overruns) == ("complete", 1)
    with Run.open(outcome.path) as run:
        assert any(event.message.startswith("cycle late by ") for event in run.events)


def test_chance_is_the_same_for_a_seed_and_another_for_another(rehearse):
    def lost(seed):
        fault = "{fault: lost_frames, bus: can0, share: 0.2, direction: to_host}"
        release("emulated")  # a drive whose last answer was lost is not confirmed safe
        outcome, _bench = rehearse(fault, sets=(f"seed={seed}",))
        with Run.open(outcome.path) as run:
            return np.isnan(run.channel("velocity", "test").values).tolist()

    first = lost(5)
    assert any(first)
    assert lost(5) == first
    assert lost(6) != first


@st.composite
def misfortunes(draw):
    """One to four faults of the catalogue at any moments, each as its example says."""
    kinds = [fault.example for name, fault in sorted(known_faults().items()) if name not in {"slow_disk", *ELSEWHERE}]
    chosen = draw(st.lists(st.sampled_from(kinds), min_size=1, max_size=4))
    moments = st.integers(0, 2000).map(lambda milliseconds: f"at_s: {milliseconds / 1000}")
    return ", ".join(entry.replace("at_s: 2", draw(moments)) for entry in chosen)


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(misfortunes())
def test_no_drive_is_called_safe_that_is_not(rehearse, faults):
    release("emulated")
    try:
        outcome, bench = rehearse(faults)
    except DeviceError:
        return  # met when the bench was opened
    roles = {"drive_test": "test", "drive_load": "load"}
    confirmed = {roles[name] for name, found in outcome.safe.items() if found.safe and name in roles}
    assert {role for role in confirmed if bench.rig.actuators[role].mode != "off"} == set()
    assert verify(outcome.path) == []
    assert len(confirmed) == 2 or outcome.status != "complete"


SLOW = "{fault: slow_disk, at_s: 0, delay_s: 0.4}"  # with the pause between two flushes more than a second


def test_a_slow_disk_holds_up_no_cycle_and_loses_nothing(rehearse):
    outcome, _bench = rehearse(SLOW, SPIN, sets=("hold_s=1.2",), realtime=True)
    assert (outcome.status, verify(outcome.path)) == ("complete", [])
    with Run.open(outcome.path) as run:
        assert run.channel("velocity", "test").time[-1] == pytest.approx(outcome.duration_s, abs=0.02)


def test_every_write_of_the_run_file_waits_for_a_slow_disk(rehearse, monkeypatch):
    waited = []
    monkeypatch.setattr("leactl.emulation.bench.emulated_bench.time.sleep", waited.append)
    assert rehearse(SLOW)[0].status == "complete"
    assert waited.count(0.4) == len(waited) >= 2  # the first flush and the last


def test_a_disk_that_falls_behind_is_noted(rehearse, monkeypatch):
    monkeypatch.setattr("leactl.runner.flushing.FLUSH_INTERVAL_S", 0.0)  # noted after 0.4 s, long before the run ends
    monkeypatch.setattr("leactl.runner.flushing.PROMISED_FLUSH_S", 0.2)
    outcome, _bench = rehearse(SLOW, SPIN, sets=("hold_s=1.2",), realtime=True)
    with Run.open(outcome.path) as run:
        assert any(event.level == "warning" and "disk" in event.message for event in run.events)


def test_every_fault_of_the_catalogue_is_rehearsed_here():
    rehearsed = " ".join([SLOW, *(fault for fault, _ in CAUGHT)])
    assert {name for name in known_faults() if f"fault: {name}," not in rehearsed} == ELSEWHERE
