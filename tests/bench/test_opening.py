"""How a bench opens and ends when a drive does not play along: no drive stays in operation, none waits for another."""

import pytest

from leactl.bench import benchfile
from leactl.bench.bench import Bench
from leactl.driver.contract import SAFE_STATE_S
from leactl.driver.safe_state import make_safe
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.errors import DeviceError


@pytest.fixture
def emulated():
    file, devices, _ = benchfile.load("emulated")
    wiring = EmulatedBench(file, devices, "free", "unloaded")
    bench = Bench(file, devices, wiring)
    yield wiring, bench
    bench.close()


def run_away(far_end):
    far_end.state = "enabled"
    far_end._values[0x6060, 0] = 9
    far_end._values[0x60FF, 0] = 30000
    far_end._follow()


@pytest.mark.parametrize("failing", ["drive_test", "drive_load"])
def test_where_one_drive_fails_to_open_none_is_left_in_operation(emulated, failing):
    wiring, bench = emulated
    for name in ("drive_test", "drive_load"):
        run_away(wiring.far_ends[name])
    far_end = wiring.far_ends[failing]
    far_end._entries[0x6007, 0] = far_end._entries[0x6007, 0]._replace(high=0)
    with pytest.raises(DeviceError, match=f"^{failing}: .*0x6007") as caught:
        bench.open()
    assert "NOT CONFIRMED" not in str(caught.value)
    assert [wiring.far_ends[name].state for name in ("drive_test", "drive_load")] == ["disabled", "disabled"]


def test_what_cannot_be_confirmed_stands_in_the_error(emulated):
    wiring, bench = emulated
    wiring.far_ends["drive_test"].frozen = True
    run_away(wiring.far_ends["drive_load"])
    with pytest.raises(DeviceError, match=r"^drive_test: .*NOT CONFIRMED SAFE, [^:]*: drive_test: [^;]*$"):
        bench.open()
    assert wiring.far_ends["drive_load"].state == "disabled"


def test_a_dead_drive_delays_no_other_and_keeps_its_deadline(emulated):
    wiring, bench = emulated
    bench.open()
    dead, healthy = wiring.far_ends["drive_test"], wiring.far_ends["drive_load"]
    dead.frozen = True
    run_away(healthy)
    began, off = bench.clock.now(), []
    wiring.clock.follow(lambda now: off.append(now) if healthy.state == "disabled" and not off else None)
    outcome = make_safe(bench.drivers.values())
    assert off[0] - began < 0.01
    assert bench.clock.now() - began < SAFE_STATE_S + 0.01
    assert [confirmation.safe for confirmation in outcome.values()] == [False, True, True, True]
