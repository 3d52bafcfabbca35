"""No sequence of calls on the supervisor puts levels on a supply, or switches it on, that the supervisor did not pass.

Judged by the bytes alone: every command that the supply's line carried is read back.
"""

import math
from contextlib import suppress

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from leactl.driver.contract import Row
from leactl.errors import DeviceError, InputError, SafetyTrip
from tests.safety.supply_rig import SupplyRig

MARKS = range(10, 20)  # 1.0 to 1.9 V, which mark the way off and are set before anything is commanded
anything = st.floats(allow_nan=True, allow_infinity=True)
volts = st.one_of(st.sampled_from([8.0, 5.0, 2.0]), anything)
amperes = st.one_of(st.sampled_from([9.0, 2.5, 0.1, 10.1, 21.3]), anything)


class Unsupervised(RuleBasedStateMachine):
    """Calls in any order; what the supervisor let pass is kept here and compared with the wire."""

    def __init__(self):
        super().__init__()
        self.rig = SupplyRig()
        self.passed = set()  # levels since the supply was last to be off, in tenths

    def judge(self):
        for line in self.rig.lines():
            word, digits = line[:4], line[4:]
            if word == b"SOUT":
                assert digits == b"1" or self.passed
            elif word == b"CURR":
                assert int(digits) in {0, *(current for _, current in self.passed)}
            elif word == b"VOLT":
                assert int(digits) in {*MARKS, *(voltage for voltage, _ in self.passed)}

    def is_to_be_off(self):
        self.judge()
        self.passed.clear()

    def latched(self, call, *arguments):
        """A call that may end the run, and the end of it."""
        try:
            call(*arguments)
        except (SafetyTrip, DeviceError) as error:
            self.judge()  # what was sent until then
            self.rig.supervisor.latch(str(error))
        if self.rig.supervisor.tripped:
            self.is_to_be_off()

    @rule(voltage=volts, current=amperes)
    def put_out(self, voltage, current):
        tripped = self.rig.supervisor.tripped
        try:
            self.rig.supplies.put_out("test", voltage, current)
        except InputError:
            return
        except SafetyTrip:
            self.is_to_be_off()
            return
        assert not tripped
        assert 1.0 <= voltage <= 8.0
        assert 0.1 <= current <= 10.0
        self.passed.add((round(voltage / 0.1), round(current / 0.1)))

    @rule()
    def switch_off(self):
        self.judge()
        with suppress(DeviceError):
            self.rig.supplies.switch_off("test")
        self.is_to_be_off()

    @precondition(lambda self: not self.rig.supervisor.tripped)
    @rule(cycles=st.integers(1, 20))
    def cycle(self, cycles):
        for _ in range(cycles):
            self.latched(self.rig.cycle)
            self.judge()
            if self.rig.supervisor.tripped:
                return

    @rule()
    def go_on_after_all(self):
        """A loop that takes no notice of the trip."""
        with suppress(SafetyTrip, DeviceError):
            for row in self.rig.supply.take():
                self.rig.supervisor.receive(row)
        self.rig.clock.sleep_until(self.rig.clock.now() + 0.1)
        self.judge()

    @rule(current=st.one_of(st.floats(0, 12), st.just(math.nan)), fault=st.sampled_from(["", "out of regulation"]))
    def receive(self, current, fault):
        self.latched(self.rig.supervisor.receive, Row("supply", self.rig.clock.now(), (5.0, current), fault))

    @rule()
    def trip(self):
        self.latched(self.rig.supervisor.trip, "by hand")

    @rule(what=st.sampled_from(["spoil", "cut", "mend", "panel", "time"]))
    def the_bench_fails(self, what):
        rig = self.rig
        match what:
            case "spoil":
                rig.far.spoil(b"\xff\r".hex(), None)
            case "cut" | "mend":
                rig.wire.wire.cut = what == "cut"
            case "panel":
                rig.far.go_off()
            case "time":
                rig.clock.sleep_until(rig.clock.now() + 0.3)

    @rule()
    def make_safe(self):
        confirmed = self.rig.supervisor.make_safe()["supply"]
        assert not (confirmed.safe and self.rig.far.on)
        self.is_to_be_off()


def test_no_call_sequence_reaches_a_supply_unsupervised():
    Unsupervised.TestCase.settings = settings(max_examples=60, stateful_step_count=20)
    Unsupervised.TestCase().runTest()
