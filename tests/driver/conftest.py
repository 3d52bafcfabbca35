"""Benches on every transport there is; a test that needs emulated time or a broken bus makes its own in-process one."""

from functools import partial

import pytest

from leactl.bench.benchfile import CanBus
from leactl.bench.wiring import MachineWiring

from .adc_bench import AdcBench
from .elmo_bench import ElmoBench
from .elmo_serial_bench import ElmoSerialBench
from .supply_bench import Bk1688bBench, KoradKaBench, SupplyBench
from .transports import (
    CAN,
    I2C,
    SERIAL,
    CanElsewhere,
    CanInProcess,
    FarEndProcess,
    I2cElsewhere,
    I2cInProcess,
    SerialElsewhere,
    SerialInProcess,
    SocketElsewhere,
    can_place,
)
from .transports import i2c_place as place_of_stub


@pytest.fixture(scope="package")
def far_end_process(tmp_path_factory):
    """Processes by transport, each started once, and ended before tests elsewhere use the same buses."""
    running = {}

    def start(kind, transport):
        if (kind, transport) not in running:
            if kind == "serial":
                place = {"link": str(tmp_path_factory.mktemp("serial") / "line")}
            elif kind == "tcp":
                place = {"resource_file": str(tmp_path_factory.mktemp("tcp") / "resource")}
            else:
                place = place_of_stub() if kind == "i2c" else can_place(transport)
            if transport == "udp_multicast":
                try:
                    MachineWiring().can("can0", CanBus(kind="can", **place))().shutdown()
                except OSError as error:
                    pytest.skip(f"no IP multicast here: {error}")
            running[kind, transport] = FarEndProcess(kind, place), place
        return running[kind, transport]

    yield start
    for process, _place in running.values():
        process.end()


@pytest.fixture(params=CAN)
def make_bench(request, far_end_process):
    """Make a drive's bench with these settings; it is let go at the end."""
    made = []

    def make(**settings):
        name = request.param
        wire = CanInProcess() if name == "in_process" else CanElsewhere(*far_end_process("can", name))
        made.append(ElmoBench(wire=wire, **settings))
        return made[-1]

    yield make
    for bench in made:
        bench.close()


@pytest.fixture(params=I2C)
def make_adc(request, far_end_process):
    """Make a converter's bench with these inputs; it is let go at the end."""
    made = []

    def make(*inputs, **options):
        name = request.param
        wire = I2cInProcess() if name == "in_process" else I2cElsewhere(*far_end_process("i2c", name))
        made.append(AdcBench(*inputs, wire=wire, **options))
        return made[-1]

    yield make
    for bench in made:
        bench.adc.close()


@pytest.fixture
def make_at_line(far_end_process):
    """Make a bench of this kind with these settings at this line; it is let go at the end."""
    made = []

    def make(kind, line, **settings):
        if line == "in_process":
            wire = SerialInProcess()
        elif line == "tcp":
            wire = SocketElsewhere(*far_end_process("tcp", line))
        else:
            wire = SerialElsewhere(*far_end_process("serial", line))
        made.append(kind(wire=wire, **settings))
        return made[-1]

    yield make
    for bench in made:
        bench.supply.close()


@pytest.fixture(params=SERIAL)
def make_supply(request, make_at_line):
    """Make a supply that speaks SCPI, with these settings."""
    return partial(make_at_line, SupplyBench, request.param)


@pytest.fixture(params=SERIAL)
def make_bk1688b(request, make_at_line):
    """Make a supply of the 168xB family, with these settings."""
    return partial(make_at_line, Bk1688bBench, request.param)


@pytest.fixture(params=SERIAL)
def make_korad_ka(request, make_at_line):
    """Make a Korad supply, with these settings."""
    return partial(make_at_line, KoradKaBench, request.param)


@pytest.fixture
def make_serial_drive(far_end_process):
    """Make a drive at the end of a pseudo terminal with these settings; it is let go at the end."""
    made = []

    def make(**settings):
        made.append(ElmoSerialBench(wire=SerialElsewhere(*far_end_process("serial", "pty")), **settings))
        return made[-1]

    yield make
    for bench in made:
        bench.drive.close()
