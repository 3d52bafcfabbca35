"""Who each shipped driver says its device is, over its own emulator; nothing before it is opened."""

import pytest

from leactl.bench import benchfile
from leactl.bench.bench import Bench
from leactl.driver import conformance, registry
from leactl.driver.contract import Driver, Identity
from leactl.emulation.bench.emulated_bench import EmulatedBench

TOLD = {
    "elmo_can": Identity("Gold DC Whistle, hardware 1.0", "1", "Whistle 01.01.16.00 08Mar2018G"),
    "elmo_serial": Identity("Elmo Whistle", "1", "1.01.12.00 08Mar2018"),
    "odrive_can": Identity("ODrive 5.2.0", "", "0.6.11"),
    "moteus_can": Identity("moteus, model 0x0120", "AE4AMzA0UREgNjY2", "1.1.14"),
    "ni_daq": Identity("NI USB-6218", "1A2B3C4", ""),
    "korad_ka": Identity("KORADKA6003P", "", "2.0"),
    "scpi_supply": Identity("HEWLETT-PACKARD E3634A", "MY123", "1.7-5.0-1.0"),
}
DEVICES = {
    "elmo_can": "bus: can0, role: test, settings: {node: 1, counts_per_turn: 40000}",
    "elmo_serial": "bus: line, role: test, settings: {counts_per_turn: 40000}",
    "odrive_can": "bus: can0, role: test, settings: {node: 1, endpoints: emulated}",
    "moteus_can": "bus: can0, role: test, settings: {node: 1}",
    "ads1115": "bus: i2c1, role: bench, settings: {inputs: [{name: torque, quantity: torque, role: test, pins: A0-A1,"
    " range_V: 6.144, scale_per_V: 3.0}]}",
    "ni_daq": "role: bench, settings: {library: emulated, inputs: [{name: ab, quantity: phase_voltage_ab, role: test,"
    " channel: ai0, range_V: 10}]}",
    "scpi_supply": "bus: line, role: test, settings: {dialect: e36xx, model: E3634A, feeds: leads, voltage_limit_V: 20,"
    " current_limit_A: 5, serial_number: MY123}",
    "bk1688b": "bus: line, role: test, settings: {model: 1688B, feeds: leads, voltage_limit_V: 15, current_limit_A: 5}",
    "korad_ka": "bus: line, role: test, settings: {model: KA6003P, feeds: bus, voltage_limit_V: 9, current_limit_A: 3}",
}
FILE = """
name: one-device
motors: {{test: lea, load: lea}}
buses:
  can0: {{kind: can, interface: emulated}}
  i2c1: {{kind: i2c, number: 1}}
  line: {{kind: serial}}
devices:
  it: {{driver: {driver}, {entry}}}
limits: {{current_A: 30, velocity_rad_s: 40, torque_Nm: 17, bus_voltage_low_V: 20, bus_voltage_high_V: 60, age_s: 2.5,
  winding_temperature_degC: 130}}
emulated: {{seed: 1}}
"""


@pytest.mark.parametrize("driver", DEVICES)
def test_a_device_tells_itself_once_it_is_open(tmp_path, driver):
    path = tmp_path / "bench.yaml"
    path.write_text(FILE.format(driver=driver, entry=DEVICES[driver]))
    file, devices, _ = benchfile.load(str(path))
    bench = Bench(file, devices, EmulatedBench(file, devices, "heated", ""))
    assert bench.drivers["it"].identity() == Identity()
    try:
        bench.open()
        assert bench.drivers["it"].identity() == TOLD.get(driver, Identity())
        assert bench.provenance["it"].facts == {k: v for k, v in TOLD.get(driver, Identity())._asdict().items() if v}
    finally:
        bench.close()


def test_every_other_driver_has_nothing_to_ask():
    others = [registry.load(name) for name in registry.names() if name not in DEVICES]
    assert all(driver.identity is Driver.identity for driver in others)


def test_an_identity_of_another_kind_breaks_the_contract():
    class Vague(registry.load("ads1115")):
        """Says who it is in a text."""

        def safe_state(self, deadline_s): ...

        def identity(self) -> str:
            return "a converter"

    assert "identity does not return an Identity" in conformance.faults_of(Vague)
