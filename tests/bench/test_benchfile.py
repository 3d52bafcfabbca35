"""Bench files: the shipped one is whole, and a fault in one is told with its place."""

import json
from importlib import resources

import pytest
from leactl_plugins.elmo_can.settings import ElmoSettings

from leactl import yamlfile
from leactl.bench import benchfile
from leactl.errors import InputError
from leactl.model.motor import load_motor
from leactl.model.nominal import Model
from leactl.runner.thermal_admission import motors_of


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
        ("node: 2,", "node: 1,", "devices.drive_load.settings: address 1 on bus 'can0' is that of drive_test; another"),
        ("node: 2,", "node: 126,", "devices.drive_load.settings: node and host_node are both 126"),
        (
            "node: 1,",
            "node: 1, host_node: 2,",
            "devices.drive_test.settings: the host's address 2 is that of drive_load, which would keep drive_test",
        ),
        (
            "consumer_heartbeat_ms: 200",
            "consumer_heartbeat_ms: 0",
            "settings.consumer_heartbeat_ms: 0: ",
        ),
        ("consumer_heartbeat_ms: 200", "abort_option: 0", "settings.abort_option: 0: 1, 2 or 3"),
        ("node: 2,", "node: 200,", "devices.drive_load.settings.node: 200: at most 127 was expected"),
        ("  current_A: 30\n", "", "limits.current_A: is required and missing"),
        ("  current_A: 30\n", "  current_mA: 30000\n", "limits.current_mA: 30000: unknown key; current_A was"),
        ("  current_A: 30\n", "  current_A: true\n", "limits.current_A: true: a number was expected"),
        ("node: 2,", "node: true,", "devices.drive_load.settings.node: true: a whole number was expected"),
        ("pins: A0-A1", "pins: A1-A0", "settings.inputs[0].pins: 'A1-A0'"),
        (
            "range_V: 6.144, scale_per_V: 3.0",
            "range_V: 4.096, scale_per_V: 3.0",
            "settings.inputs[0]: tells torque from -12.29 to 12.29 N*m; its limits of -17 to 17 N*m would never trip",
        ),
        (
            "range_V: 6.144, scale_per_V: 3.0",
            "range_V: 6.144, scale_per_V: 10.8, offset_V: 1.6667, high_V: 3.0",
            "tells torque from -84.35 to 14.4 N*m",
        ),
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


def test_an_unknown_driver_is_told_together_with_other_faults(tmp_path):
    text = text_of("emulated").replace("driver: ads1115", "driver: ads1116").replace("  current_A: 30\n", "")
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        benchfile.load(str(path))
    told = "\n".join(caught.value.faults)
    assert "limits.current_A: is required and missing" in told
    assert "devices.torque_sensor.driver: driver 'ads1116' is not registered" in told


def test_a_drive_that_goes_on_without_the_host_is_refused(monkeypatch):
    for silence, said in ((None, "does not stop by itself without"), (1.5, "stops by itself 1.5 s after")):
        monkeypatch.setattr(ElmoSettings, "host_silence_s", silence)
        with pytest.raises(
            InputError, match=rf"devices.drive_test.settings: the drive {said} the host; 1 s at the most"
        ):
            benchfile.load("emulated")


@pytest.mark.parametrize("name", benchfile.names())
def test_a_checked_bench_passes_to_another_process_as_json(name):
    bench, devices, _document = benchfile.load(name)
    passed = benchfile.BenchFile.model_validate(json.loads(json.dumps(bench.model_dump(mode="json", by_alias=True))))
    assert passed == bench
    assert benchfile.check_devices(passed) == devices


def test_one_address_on_two_buses_is_two_places(tmp_path):
    text = text_of("emulated").replace("  i2c1:", "  can1: {kind: can, interface: emulated}\n  i2c1:")
    head, load = text.split("  drive_load:")
    path = tmp_path / "mine.yaml"
    path.write_text(head + "  drive_load:" + load.replace("bus: can0", "bus: can1", 1).replace("node: 2,", "node: 1,"))
    assert len(benchfile.load(str(path))[1]) == len(benchfile.load("emulated")[1])


def test_an_unknown_bench_lists_the_known():
    with pytest.raises(InputError, match="known: emulated"):
        benchfile.load("emulatde")


def test_the_nominal_model_is_the_motor_s_own_text_with_the_bench_around_it(tmp_path):
    motor = tmp_path / "mine.yaml"
    motor.write_text(load_motor("lea")[1].text.replace("torque_constant: 0.49 ", "torque_constant: 0.51 "))
    bench = tmp_path / "bench.yaml"
    bench.write_text(text_of("testbed").replace("{test: lea,", f"{{test: {motor},"))
    text = benchfile.nominal_model(benchfile.load(str(bench))[0])
    assert text.startswith(motor.read_text())
    nominal = yamlfile.parse(text, "nominal.yaml").validate(Model)
    assert (nominal.torque_constant, nominal.bench.bus_voltage) == (0.51, 29.6)
    assert nominal.bench.shaft_stiffness is None


def test_a_motor_file_is_found_from_the_bench_file_and_not_from_the_working_directory(tmp_path, monkeypatch):
    """Another motor's file of that name in the working directory would have the guard protect that motor."""
    for folder, capacitance in (("bench", "22.9"), ("elsewhere", "200")):
        (tmp_path / folder).mkdir()
        motor = (resources.files("leactl.model") / "motors" / "lea.yaml").read_text()
        motor = motor.replace("winding_capacitance: 22.9", f"winding_capacitance: {capacitance}")
        (tmp_path / folder / "motor.yaml").write_text(motor)
    path = tmp_path / "bench" / "bench.yaml"
    path.write_text(text_of("emulated").replace("motors: {test: lea,", "motors: {test: motor.yaml,"))
    monkeypatch.chdir(tmp_path / "elsewhere")
    bench = benchfile.load("../bench/bench.yaml")[0]
    assert bench.motors == {"test": "../bench/motor.yaml", "load": "lea"}
    assert motors_of(bench)["test"].thermal.winding_capacitance == 22.9


@pytest.mark.parametrize(
    "line",
    [
        "{kind: can, channel: can3}",
        "{kind: serial, port: /dev/ttyUSB0}",
    ],
)
def test_two_names_of_one_wire_are_refused(tmp_path, line):
    text = text_of("testbed")
    assert "\nbuses:\n" in text
    (tmp_path / "bench.yaml").write_text(text.replace("\nbuses:\n", f"\nbuses:\n  one: {line}\n  two: {line}\n"))
    with pytest.raises(InputError, match=r"buses\.two: leads where one does; one name was expected"):
        benchfile.load(str(tmp_path / "bench.yaml"))
