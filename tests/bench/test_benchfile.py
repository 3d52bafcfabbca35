"""Bench files: the shipped one is whole, and a fault in one is told with its place."""

import pytest

from leactl.bench import benchfile
from leactl.errors import InputError


def text_of(name):
    return benchfile.load(name)[2].text


@pytest.mark.parametrize("name", benchfile.names())
def test_shipped_benches_are_accepted(name):
    bench, devices, document = benchfile.load(name)
    assert bench.name == name
    assert [device.name for device in devices] == list(bench.devices)
    assert f"name: {name}\n" in document.text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("driver: ads1115", "driver: ads1116", "devices.torque_sensor.driver: driver 'ads1116' is not registered"),
        ("bus: i2c1", "bus: can0", "devices.torque_sensor.bus: 'can0': ads1115 needs i2c1"),
        ("node: 2,", "node: 200,", "devices.drive_load.settings.node: 200: input should be less than or equal to 127"),
        ("  current_A: 30\n", "", "limits.current_A: is required and missing"),
        ("  current_A: 30\n", "  current_mA: 30000\n", "limits.current_mA: unknown key"),
        ("pins: A0-A1", "pins: A1-A0", "settings.inputs[0].pins: 'A1-A0'"),
        ("kind: i2c", "kind: spi", "buses.i2c1"),
        ("motors: {test: lea, load: lea}", "motors: {load: lea}", "motors.test is required"),
    ],
)
def test_faults_are_told_with_their_place(tmp_path, old, new, message):
    text = text_of("emulated")
    assert old in text
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        benchfile.load(str(path))
    assert any(message in fault and fault.startswith(f"{path}:") for fault in caught.value.faults), caught.value.faults


def test_an_unknown_bench_lists_the_known():
    with pytest.raises(InputError, match="known: emulated"):
        benchfile.load("emulatde")
