"""No sequence of calls on supervisor and bench puts a demand on the wire that the supervisor did not pass.

Judged by the frames alone: every RPDO of both drives is read back in amperes, rad/s and counts.
"""

import math
import struct
from contextlib import suppress

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule
from leactl_plugins.elmo_can.emulator import ElmoEmulator

from leactl import yamlfile
from leactl.bench.bench import Bench
from leactl.bench.benchfile import load
from leactl.driver.contract import Mode, Row
from leactl.driver.far_end import Frame
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.wires.buses import CanWire, EmulatedCanBus
from leactl.errors import DeviceError, InputError, SafetyTrip
from leactl.safety.interlocks import Interlocks
from leactl.safety.supervisor import Axis, Supervisor
from tests.driver.elmo_bench import Tap, q_axis
from tests.driver.failing import COUNTS, RATED_MA, Shaft
from tests.safety.guards import guard_of
from tests.safety.rig import LIMITS

PERIOD = 0.01
NODES = {"test": 1, "load": 2}
BENCH = f"""
name: pair
motors: {{test: lea}}
buses: {{can0: {{kind: can, interface: emulated}}}}
devices:
  first: {{driver: elmo_can, bus: can0, role: test, settings: {{node: 1, counts_per_turn: {COUNTS}}}}}
  second: {{driver: elmo_can, bus: can0, role: load, settings: {{node: 2, counts_per_turn: {COUNTS}}}}}
limits: {{current_A: 30, velocity_rad_s: 40, torque_Nm: 15, bus_voltage_low_V: 20, bus_voltage_high_V: 60, age_s: 2.5,
  winding_temperature_degC: 130}}
"""
INTERLOCKS = (
    "{velocity: {trip_rad_s: 30, for_s: 0.03, rate_rad_s_per_s: 2000}, q_axis_current: {trip_A: 25, for_s: 0.05}}"
)
MOST = {Mode.CURRENT: 30.0, Mode.TORQUE_PROFILE: 30.0, Mode.VELOCITY: 40.0}
PER_COUNT = 2 * math.pi / COUNTS
roles = st.sampled_from(list(NODES))
anything = st.one_of(
    st.floats(-30, 30),
    st.floats(-0.3, 0.3),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([30.0, 30.1, 34.0, -31.0, 39.9, -40.1, 45.0]),
)


class Wiring:
    """Two drives on a wire, with a tape of what the host sent."""

    def __init__(self):
        self.clock, self.tape = EmulatedClock(), []
        self.wire = CanWire(self.clock)
        self.shafts = {role: Shaft() for role in NODES}
        self.far = {
            role: ElmoEmulator(node, self.shafts[role], rated_current_ma=RATED_MA, counts_per_turn=COUNTS)
            for role, node in NODES.items()
        }
        for drive in self.far.values():
            self.wire.attach(drive)

    def can(self, _name, _bus):
        return lambda: Tap(EmulatedCanBus(self.wire), self.tape)

    def i2c(self, _name, _bus):
        raise NotImplementedError

    serial = i2c

    def apply_weight_torque(self, torque):
        """Nothing."""

    def wait_for_disk(self):
        return


class Unsupervised(RuleBasedStateMachine):
    """Calls in any order; what the supervisor let pass is kept here and compared with the wire."""

    file = None

    def __init__(self):
        super().__init__()
        self.wiring = Wiring()
        self.clock, self.tape = self.wiring.clock, self.wiring.tape
        file, devices = self.file
        self.bench = Bench(file, devices, self.wiring)
        self.bench.open()
        axes = {role: Axis(drive, drive) for role, drive in self.bench.drives.items()}
        block = yamlfile.parse(INTERLOCKS).validate(Interlocks)
        self.supervisor = Supervisor(LIMITS, axes, [], self.clock, guard_of(axes), block)
        self.mode = dict.fromkeys(NODES, Mode.OFF)
        self.passed = dict.fromkeys(NODES)
        self.word = dict.fromkeys(NODES, 0)  # the latest controlword
        self.stood = {role: {self.counts(role)} for role in NODES}  # where the shaft was since the drive was engaged
        self.tape.clear()

    def counts(self, role):
        return round(self.wiring.shafts[role].angle / PER_COUNT)

    def judge(self, tripped):
        for identifier, data in self.tape:
            for role, node in NODES.items():
                if identifier == 0x200 + node:
                    self.judge_torque(role, *struct.unpack("<Hhb", data), tripped)
                elif identifier == 0x300 + node:
                    self.judge_motion(role, *struct.unpack("<ii", data), tripped)
                elif identifier == 0x600 + node and data[1:3] in (b"\x40\x60", b"\x71\x60", b"\x7a\x60", b"\xff\x60"):
                    assert data[4:] == bytes(4), f"{data.hex()} commands {role} by SDO"
        self.tape.clear()

    def judge_torque(self, role, word, torque, _mode, tripped):
        self.word[role] = word
        if torque:
            assert not tripped
            assert self.mode[role] in (Mode.CURRENT, Mode.TORQUE_PROFILE)
            assert torque == round(self.passed[role] / q_axis(1))
            assert abs(torque) <= 30.0 / q_axis(1) + 0.5
        if word:
            assert not tripped
            assert self.mode[role] is not Mode.OFF

    def judge_motion(self, role, target, velocity, tripped):
        assert not tripped
        if velocity:
            assert self.mode[role] is Mode.VELOCITY
            assert velocity == round(self.passed[role] / PER_COUNT)
            assert abs(velocity) <= 40.0 / PER_COUNT + 0.5
        if self.mode[role] is Mode.ANGLE and self.word[role]:  # with a controlword of 0 it takes the drive out
            passed = self.passed[role]
            assert target in self.stood[role] or (passed is not None and target == round(passed / PER_COUNT))

    # -- calls ---------------------------------------------------------------------------------------------------------

    @rule()
    def begin(self):
        self.supervisor.begin(PERIOD)

    @rule(role=roles, mode=st.sampled_from(list(Mode)))
    def engage(self, role, mode):
        tripped = self.supervisor.tripped
        try:
            self.supervisor.engage(role, mode)
        except (SafetyTrip, InputError):
            return
        assert not tripped
        self.mode[role], self.passed[role], self.stood[role] = mode, None, {self.counts(role)}
        self.stood[role].add(self.bench.drives[role]._position.counts)

    @rule(role=roles)
    def release(self, role):
        self.supervisor.release(role)
        self.mode[role], self.passed[role] = Mode.OFF, None

    @rule(role=roles, value=anything)
    def command(self, role, value):
        tripped = self.supervisor.tripped
        try:
            self.supervisor.command(role, value)
        except (SafetyTrip, InputError):
            return
        assert not tripped
        assert math.isfinite(value)
        assert abs(value) <= MOST.get(self.mode[role], math.inf)
        self.passed[role] = value

    @rule(cycles=st.integers(1, 8))
    def cycle(self, cycles):
        for _ in range(cycles):
            tripped, began = self.supervisor.tripped, self.clock.now()
            with suppress(SafetyTrip, DeviceError):
                self.bench.exchange(began + 0.6 * PERIOD)
                for row in self.bench.take():
                    self.supervisor.receive(row)
                self.supervisor.check(self.clock.now())
                self.bench.feed()
            self.bench.notices()
            self.clock.sleep_until(began + PERIOD)
            self.judge(tripped)

    @rule(role=roles, mode=st.sampled_from([Mode.CURRENT, Mode.VELOCITY, Mode.ANGLE]), value=anything)
    def engage_and_command(self, role, mode, value):
        """The way into operation, which random calls seldom find."""
        self.engage(role, mode)
        self.cycle(6)
        self.command(role, value)
        self.cycle(2)

    @rule(fault=st.sampled_from(["", "input t is saturated"]), volts=st.sampled_from([29.6, 70.0, math.nan]))
    def receive(self, fault, volts):
        with suppress(SafetyTrip):
            self.supervisor.receive(Row("first_supply", self.clock.now(), (volts,), fault))

    @rule(role=roles, velocity=st.floats(-45, 45), angle=st.floats(-5, 5))
    def shaft_moves(self, role, velocity, angle):
        shaft = self.wiring.shafts[role]
        shaft.velocity, shaft.angle = velocity, angle
        self.stood[role].add(self.counts(role))

    @precondition(lambda self: not self.supervisor.tripped)
    @rule()
    def trip(self):
        with suppress(SafetyTrip):
            self.supervisor.trip("by hand")

    @rule(
        role=roles,
        what=st.sampled_from(["fault", "boot", "disable", "freeze", "thaw", "cut", "mend", "time"]),
    )
    def the_bench_fails(self, role, what):
        far = self.wiring.far[role]
        match what:
            case "fault":
                far.fault(0x2310)
            case "boot":
                far.receive(Frame(0, bytes((0x81, NODES[role]))), self.clock.now())
            case "disable":
                far._go("disabled")
            case "freeze" | "thaw":
                far.frozen = what == "freeze"
            case "cut" | "mend":
                self.wiring.wire.cut = what == "cut"
            case "time":
                self.clock.sleep_until(self.clock.now() + 0.3)

    @rule()
    def make_safe(self):
        self.supervisor.make_safe()
        self.mode, self.passed = dict.fromkeys(NODES, Mode.OFF), dict.fromkeys(NODES)
        self.judge(tripped=True)


def test_no_call_sequence_reaches_a_drive_unsupervised(tmp_path):
    path = tmp_path / "pair.yaml"
    path.write_text(BENCH)
    Unsupervised.file = load(str(path))[:2]
    Unsupervised.TestCase.settings = settings(max_examples=100, stateful_step_count=25)
    Unsupervised.TestCase().runTest()
