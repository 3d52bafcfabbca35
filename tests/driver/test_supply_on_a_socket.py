"""A supply behind a real TCP connection that falls silent, that another client takes, and that is not there."""

import socket

import pytest

from leactl.bench.benchfile import VisaBus
from leactl.bench.wiring import MachineWiring
from leactl.driver.safe_state import make_safe, unconfirmed_devices
from leactl.driver.serial_port import SerialPort
from leactl.errors import DeviceError, NoAnswer

from .supply_bench import HEATED, SupplyBench


@pytest.fixture
def bench(make_at_line):
    return make_at_line(SupplyBench, "tcp", answer_s=0.3)


def test_a_supply_that_falls_silent_is_missed_and_not_called_safe(bench):
    bench.energise()
    bench.far.freeze()
    with pytest.raises(NoAnswer, match=r"supply: no answer to .* within 0\.3 s"):
        bench.until(lambda _: False)
    confirmed = bench.made_safe()
    assert not confirmed.safe
    assert confirmed.detail.startswith("not confirmed within 2 s: no answer to *IDN?")
    assert bench.far.output()[0] is True


def test_a_supply_that_another_client_takes_is_missed_and_switched_off_over_a_new_connection(bench):
    bench.energise()
    host, port = VisaBus(kind="visa", resource=bench.wire.resource).address
    with socket.create_connection((host, port)):
        with pytest.raises(DeviceError, match="supply: bus 'supply0': the device is gone: "):
            bench.until(lambda _: False)
        before = bench.connections
        assert bench.made_safe().safe
        assert bench.connections > before
    assert bench.far.output() == [False, 0.0, 0.0]


def test_an_address_that_does_not_answer_is_told_within_the_deadline():
    """A listener whose queue is full drops what else comes, as the address of an instrument that is off does."""
    listener = socket.create_server(("127.0.0.1", 0), backlog=0)
    address = listener.getsockname()
    holders = [socket.socket() for _ in range(4)]
    for holder in holders:
        holder.setblocking(False)
        holder.connect_ex(address)
    wiring = MachineWiring()
    bus = VisaBus(kind="visa", resource=f"TCPIP::127.0.0.1::{address[1]}::SOCKET")
    port = SerialPort(wiring.serial("supply0", bus), wiring.clock, "supply0")
    supply = SupplyBench.driver("supply", "test", SupplyBench.driver.Settings(**HEATED), port, wiring.clock)
    began = wiring.clock.now()
    try:
        said = unconfirmed_devices(make_safe([supply]))
    finally:
        supply.close()
        for held in (*holders, listener):
            held.close()
    assert wiring.clock.now() - began < 5.0  # a connection to nowhere is tried for two minutes by itself
    assert said.startswith(
        "NOT CONFIRMED SAFE, switch off the supply: supply: not confirmed within 1 s: bus 'supply0': "
    )
    assert said.endswith("no answer within 0.3 s; is it switched on, and on this network?")
