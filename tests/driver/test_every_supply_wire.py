"""What every supply's driver must do at its line, whatever the commands of its instrument are."""

from typing import NamedTuple

import pytest

from leactl.errors import DeviceError, NoAnswer

from .supply_bench import Bk1688bBench, KoradKaBench, SupplyBench
from .transports import SERIAL


class Spoken(NamedTuple):
    """What stands on the line of one kind of supply."""

    bench: type[SupplyBench]
    measuring: bytes  # a query of every round
    half: bytes  # the beginning of a command
    garbled: bytes  # an answer that means nothing
    off: bytes  # all that `stop_now` sends
    confirmed: str  # detail of the safe state
    answer_s: float  # that an answer may take


SUPPLIES = {
    "scpi_supply": Spoken(
        SupplyBench,
        b"MEAS",
        b"VOLT 3",
        b"\xff\xff\r\n",
        b"\x03\nSYST:REM\nOUTP OFF\n",
        "output off, 0.000 A",
        0.3,
    ),
    "bk1688b": Spoken(
        Bk1688bBench, b"GETD", b"VOLT0", b"\xff\xff\r", b"\rSOUT1\r", "output off, 0.00 V and 0.00 A", 0.3
    ),
    "korad_ka": Spoken(
        KoradKaBench,
        b"VOUT1?",
        b"VSET1:0",
        b"\xff\xff",
        b"OUT0",
        "output off, 0.00 V and 0.000 A, its state off",
        0.2,
    ),
}


@pytest.fixture(params=SUPPLIES)
def spoken(request):
    return SUPPLIES[request.param]


@pytest.fixture
def here(spoken):
    """A bench in this process: its time is emulated, and its line fails on request."""
    return spoken.bench()


LINES = [(name, line) for name in SUPPLIES for line in (*SERIAL, *(["tcp"] if name == "scpi_supply" else []))]


@pytest.fixture(params=LINES, ids="-".join)
def at_a_line(request, make_at_line):
    """A bench on one of the lines that its supply may have, and what stands on that."""
    name, line = request.param
    return make_at_line(SUPPLIES[name].bench, line), SUPPLIES[name]


# -- in the loop -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slow_s", [0.0, 0.2])
def test_nothing_waits_in_the_loop_whatever_the_instrument_does(here, slow_s):
    here.energise()
    if slow_s:
        here.far.slow_down(slow_s)
    for step in range(8000):
        if step == 3000:
            here.far.freeze()
        before = here.clock.now()
        try:
            here.supply.take()
        except NoAnswer:
            break
        finally:
            assert here.clock.now() == before
        here.clock.sleep_until(before + 0.001)
    else:
        raise AssertionError("a frozen supply is not missed")


def test_three_rounds_lost_in_a_row_end_it(here, spoken):
    here.energise()
    here.far.freeze()
    with pytest.raises(NoAnswer, match=rf"supply: no answer to .* within {spoken.answer_s:g} s"):
        here.until(lambda _: False, limit_s=5.0)


def test_an_adapter_that_is_pulled_out_is_a_device_error(here):
    here.energise()
    here.wire.wire.gone = True
    with pytest.raises(DeviceError, match="supply: bus 'supply0': the device is gone"):
        here.until(lambda _: False)


# -- the safe state --------------------------------------------------------------------------------------------------


def never_opened(bench, _spoken):
    bench.far.leave_on(8.0, 9.0)


def energised(bench, _spoken):
    bench.energise()


def in_the_middle_of_a_query(bench, spoken):
    bench.energise()
    bench.until(lambda _: spoken.measuring in bench.said)


def behind_a_half_sent_command(bench, spoken):
    bench.energise()
    bench.port.write(spoken.half)


def with_bytes_lost(bench, _spoken):
    bench.energise()
    bench.far.miss(20)


def with_an_answer_garbled(bench, spoken):
    bench.energise()
    bench.far.spoil(spoken.garbled.hex())


def after_stop_now(bench, _spoken):
    bench.energise()
    bench.supply.stop_now()


def closed(bench, _spoken):
    bench.energise()
    bench.supply.close()


def safe_already(bench, _spoken):
    bench.energise()
    bench.supply.safe_state(1.0)


STATES = [
    never_opened,
    energised,
    in_the_middle_of_a_query,
    behind_a_half_sent_command,
    with_bytes_lost,
    with_an_answer_garbled,
    after_stop_now,
    closed,
    safe_already,
]


@pytest.mark.parametrize("state", STATES, ids=lambda state: state.__name__)
def test_off_from_any_state(at_a_line, state):
    bench, spoken = at_a_line
    state(bench, spoken)
    assert bench.made_safe() == (True, spoken.confirmed)
    assert bench.far.output()[0] is False


def test_a_connection_that_is_dead_is_replaced(at_a_line):
    bench, _spoken = at_a_line
    bench.energise()
    bench.dead_connections = bench.connections
    bench.supply.stop_now()
    assert bench.made_safe().safe
    assert bench.connections == bench.dead_connections + 1


def test_stop_now_waits_for_nothing(here, spoken):
    here.energise()
    before = here.clock.now()
    here.supply.stop_now()
    assert (here.clock.now(), bytes(here.said)) == (before, spoken.off)


@pytest.mark.parametrize("admits", [True, False])
def test_a_supply_that_does_not_switch_off_is_not_called_safe_until_it_is_mended(here, admits):
    here.energise()
    here.far.stuck_on(admits)
    assert not here.made_safe().safe
    assert here.far.output()[2] > 0.0  # A
    here.far.mend()
    assert here.made_safe().safe
    assert here.far.output()[0] is False


@pytest.mark.parametrize("failure", ["cut", "gone"])
def test_a_line_that_is_dead_is_not_called_safe(here, failure):
    here.energise()
    setattr(here.wire.wire, failure, True)
    confirmed = here.made_safe()
    assert not confirmed.safe
    assert "not confirmed within 1 s: " in confirmed.detail
    setattr(here.wire.wire, failure, False)
    assert here.made_safe().safe
