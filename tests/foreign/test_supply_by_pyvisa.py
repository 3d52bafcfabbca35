"""The SCPI driver at an instrument of pyvisa-sim's, and pyvisa with pyvisa-py at the emulated instrument."""

from pathlib import Path

import pytest
from leactl_plugins.scpi_supply.driver import ScpiSupply
from leactl_plugins.scpi_supply.settings import ScpiSupplySettings

from leactl.driver.clock import MonotonicClock
from leactl.driver.contract import Identity
from leactl.driver.serial_port import SerialPort
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.wires.serial import SerialWire
from leactl.emulation.wires.serving import SocketBridge
from leactl.errors import DeviceError
from tests.driver.failing import SERIAL_ENDS

from .serving import served

pyvisa = pytest.importorskip("pyvisa", reason="needs the extra 'foreign'")
pytest.importorskip("pyvisa_sim", reason="needs the extra 'foreign'")
pytest.importorskip("pyvisa_py", reason="needs the extra 'foreign'")

INSTRUMENT = Path(__file__).with_name("supply_by_pyvisa_sim.yaml")
DEVICE_CLEAR = b"\x03"  # the interface's matter, of which pyvisa-sim has none
SETTINGS = {"dialect": "e36xx", "model": "E3633A", "feeds": "leads", "voltage_limit_V": 8.0, "current_limit_A": 10.0}
PATIENT = {"answer_s": 2.0, "period_s": 0.2}


class SimulatedLine:
    """The line to an instrument of pyvisa-sim's: a message for each line out, an answer for each query."""

    def __init__(self):
        self._manager = pyvisa.ResourceManager(f"{INSTRUMENT}@sim")
        self._instrument = self._manager.open_resource("TCPIP0::supply::5025::SOCKET")
        self._instrument.read_termination = self._instrument.write_termination = "\n"
        self._out, self._answers = b"", b""

    def write(self, data):
        """Pass on whole lines."""
        *lines, self._out = (self._out + data.replace(DEVICE_CLEAR, b"")).split(b"\n")
        for line in filter(None, lines):
            text = line.decode("ascii")
            if text.endswith("?"):
                self._answers += self._instrument.query(text).encode("ascii") + b"\n"
            else:
                self._instrument.write(text)
        return len(data)

    def read(self, _timeout):
        """Everything is answered at once."""
        answers, self._answers = self._answers, b""
        return answers

    def close(self):
        """Leave the instrument as it is."""
        self._instrument.close()


def supply(**settings):
    """The driver at the instrument of pyvisa-sim's."""
    clock = MonotonicClock()
    checked = ScpiSupplySettings(**(SETTINGS | PATIENT | settings))
    return ScpiSupply("supply", "test", checked, SerialPort(SimulatedLine, clock, "supply0"), clock)


def asked(question):
    """What the instrument of pyvisa-sim's answers to somebody else."""
    with pyvisa.ResourceManager(f"{INSTRUMENT}@sim").open_resource("TCPIP0::supply::5025::SOCKET") as instrument:
        instrument.read_termination = instrument.write_termination = "\n"
        return instrument.query(question)


def test_it_is_met_switched_off_and_its_protections_are_armed():
    driver = supply()
    driver.open()
    assert driver.identity() == Identity("HEWLETT-PACKARD E3633A", "", "2.1-5.0-1.0")
    assert [asked(query) for query in ("OUTP?", "VOLT:PROT:STAT?", "CURR:PROT:STAT?")] == ["OFF", "ON", "ON"]
    assert [float(asked(query)) for query in ("VOLT?", "CURR?", "VOLT:PROT?", "CURR:PROT?")] == [0.0, 0.0, 8.0, 10.0]
    confirmed = driver.safe_state(1.0)
    assert (confirmed.safe, confirmed.detail) == (True, "output off, 0.000 A")
    driver.close()


def test_it_is_switched_on_and_measured():
    driver = supply()
    driver.open()
    driver.supply(8.0, 2.5)
    driver.switch_on()
    rows = []
    while not rows or not driver.supplying:
        rows += driver.take()
    assert (asked("OUTP?"), float(asked("VOLT?")), float(asked("CURR?"))) == ("ON", 8.0, 2.5)
    assert rows[-1].values[:2] == pytest.approx([7.9982, 1.3e-4])
    assert driver.safe_state(1.0).safe
    assert asked("OUTP?") == "OFF"
    driver.close()


def test_another_model_is_refused_by_name():
    driver = supply(model="E3634A")
    with pytest.raises(DeviceError, match="HEWLETT-PACKARD E3633A answers; E3634A was expected"):
        driver.open()


# -- the emulated instrument, at a host that is pyvisa-py --------------------------------------------------------------


@pytest.fixture
def instrument():
    """An emulated supply behind a TCP server of this process, as pyvisa-py opens it."""
    clock = EmulatedClock()
    wire = SerialWire(clock, 1e-6)
    wire.device = SERIAL_ENDS["scpi_supply"]("e36300", "E36312A", "0", 1)
    bridge = SocketBridge(wire)
    with (
        served(bridge, clock),
        pyvisa.ResourceManager("@py").open_resource(bridge.address.split()[-1]) as opened,
    ):
        opened.read_termination = opened.write_termination = "\n"
        opened.timeout = 5000
        yield opened


def test_pyvisa_sets_and_measures_the_emulated_supply(instrument):
    assert instrument.query("*IDN?").split(",")[:2] == ["Keysight Technologies", "E36312A"]
    instrument.write("VOLT 3.3,(@1);CURR 0.5,(@1);OUTP ON,(@1)")
    assert float(instrument.query("VOLT? (@1)")) == 3.3
    assert instrument.query_ascii_values("OUTP? (@1)") == [1.0]
    assert instrument.query_ascii_values("MEAS:VOLT? (@1)")[0] <= 3.3 * 1.01


def test_pyvisa_reads_the_emulated_error_queue_until_it_is_empty(instrument):
    instrument.write("VLOT 3")
    instrument.write("VOLT 1000,(@1)")
    errors = [instrument.query("SYST:ERR?") for _ in range(3)]
    assert [int(error.split(",")[0]) for error in errors] == [-113, -222, 0]
