"""A power supply on the emulated bench: what it puts out heats the motor or drives the drives, and is cut last."""

import json
import os
import signal
import subprocess

import pytest
import yaml

from leactl.bench import benchfile
from leactl.bench.bench import Bench
from leactl.driver.far_end import FailingSupply
from leactl.driver.safe_state import make_safe, unconfirmed_devices
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.emulation.plant.exact.rig import Rig
from leactl.emulation.plant.stepped.rig import SteppedRig
from leactl.errors import InputError
from tests.cli.terminal import COMMAND, leactl

LEADS = {"dialect": "e36xx", "model": "E3633A", "feeds": "leads", "voltage_limit_V": 8.0, "current_limit_A": 10.0}
BUS = {"dialect": "dp800", "model": "DP811", "feeds": "bus", "voltage_limit_V": 34.0, "current_limit_A": 10.0}
WATCH = """
name: watch
setup: heated
rate_Hz: 50
steps:
  - wait_until: {quantity: line_current, role: test, below: 0.1, above: -0.1, unit: A, timeout_s: 20}
"""


def written(path, supply, role="test", drives=False, **emulated):
    text = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    if not drives:
        text["devices"], text["buses"], text["interlocks"] = {}, {}, {}  # an interlock needs what it watches
    text["buses"]["supply0"] = {"kind": "serial", "stop_bits": 2}
    text["devices"]["supply"] = {"driver": "scpi_supply", "bus": "supply0", "role": role, "settings": supply}
    text["emulated"] |= emulated
    path.write_text(yaml.safe_dump(text, sort_keys=False))
    return path


@pytest.fixture
def opened(tmp_path):
    """Open a bench with a supply; everything is let go at the end."""
    benches = []

    def open_bench(setup, supply, **options):
        file, devices, _document = benchfile.load(str(written(tmp_path / "bench.yaml", supply, **options)))
        emulated = EmulatedBench(file, devices, setup, "")
        bench = Bench(file, devices, emulated)
        bench.open()
        benches.append(bench)
        return bench, emulated

    yield open_bench
    for bench in benches:
        bench.close()


def run(bench, seconds, period=0.1):
    rows, end = [], bench.clock.now() + seconds
    while bench.clock.now() < end:
        rows += bench.take()
        bench.clock.sleep_until(bench.clock.now() + period)
    return rows


def switched_on(bench, volts, amperes):
    supply = bench.drivers["supply"]
    supply.supply(volts, amperes)
    supply.switch_on()
    run(bench, 2.0)
    assert supply.supplying
    return supply


PLANTS = {
    "rig": {},
    "phases": {"bench": {"phase_resolved": True}},
    "stepped": {"effects": [{"name": "resistance_temperature"}]},
}


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_nine_amperes_through_two_leads_heat_the_winding_until_they_are_cut(opened, plant):
    bench, emulated = opened("heated", LEADS, **plant)
    test = emulated.rig.actuators["test"]
    switched_on(bench, 8.0, 9.0)
    rows = run(bench, 600.0)
    volts, amperes = rows[-1].values
    assert amperes == pytest.approx(9.0)
    hot = test.winding_temperature
    assert 35.0 < hot < 120.0
    assert volts == pytest.approx(emulated.rig.lead_resistance * 9.0, rel=1e-3)
    assert volts > 1.04 * rows[0].values[0]
    outcome = make_safe(bench.drivers.values())
    assert outcome["supply"] == (True, "output off, 0.000 A")
    run(bench, 60.0)
    assert test.winding_temperature < hot - 1.0
    assert emulated.rig.line_current == 0.0


def test_a_supply_at_its_voltage_gives_less_current_as_the_winding_warms(opened):
    bench, _emulated = opened("heated", LEADS)
    switched_on(bench, 5.0, 10.0)
    rows = run(bench, 300.0)
    assert all(row.values[0] == pytest.approx(5.0) for row in rows)
    assert rows[-1].values[1] < 0.97 * rows[0].values[1]


@pytest.mark.parametrize(
    ("admits", "said"),
    [(True, "the output is still on"), (False, "the instrument reports its output off, but 9.000 A flow")],
)
def test_a_supply_that_does_not_switch_off_goes_on_heating_and_is_told(opened, admits, said):
    bench, emulated = opened("heated", LEADS)
    switched_on(bench, 8.0, 9.0)
    far = emulated.far_ends["supply"]
    assert isinstance(far, FailingSupply)
    far.stuck_on(admits)
    told = unconfirmed_devices(make_safe(bench.drivers.values()))
    assert told == f"NOT CONFIRMED SAFE, switch off the supply: supply: not confirmed within 1 s: {said}"
    assert emulated.rig.line_current == 9.0


def test_half_the_current_is_out_of_regulation_and_a_fault(opened):
    bench, emulated = opened("heated", LEADS)
    switched_on(bench, 8.0, 9.0)
    emulated.far_ends["supply"].lose_regulation(0.5)
    assert emulated.rig.line_current == pytest.approx(4.5)
    assert run(bench, 3.0)[-1].fault == "supply: out of regulation, condition 0"


STUCK = {"fault": "supply_stuck_on", "at_s": 10, "for_s": 20, "device": "supply"}


@pytest.mark.parametrize(
    ("admits", "said"),
    [(True, "the output is still on"), (False, "the instrument reports its output off, but 9.000 A flow")],
)
def test_a_bench_file_lets_a_supply_be_stuck_on_until_it_is_mended(opened, admits, said):
    bench, emulated = opened("heated", LEADS, faults=[STUCK | {"admits": admits}])
    switched_on(bench, 8.0, 9.0)
    run(bench, 10.0 - bench.clock.now())
    assert unconfirmed_devices(make_safe(bench.drivers.values())).endswith(f"supply: not confirmed within 1 s: {said}")
    assert emulated.rig.line_current == 9.0
    bench.clock.sleep_until(30.1)
    assert make_safe(bench.drivers.values())["supply"].safe
    assert emulated.rig.line_current == 0.0


def test_a_bench_file_lets_a_supply_lose_its_regulation(opened):
    fault = {"fault": "supply_out_of_regulation", "at_s": 10, "device": "supply", "share": 0.5}
    bench, emulated = opened("heated", LEADS, faults=[fault])
    switched_on(bench, 8.0, 9.0)
    assert not any(row.fault for row in run(bench, 9.9 - bench.clock.now()))
    assert run(bench, 2.0)[-1].fault == "supply: out of regulation, condition 0"
    assert emulated.rig.line_current == pytest.approx(4.5)


def test_leads_of_a_motor_that_is_not_set_up_for_it_carry_nothing(opened):
    bench, _emulated = opened("coupled", LEADS)
    supply = switched_on(bench, 8.0, 9.0)
    assert run(bench, 3.0)[-1].values == (pytest.approx(8.0), 0.0)
    assert supply.supplying


def test_the_supply_of_the_bus_is_what_the_drives_read_and_is_made_safe_after_them(opened):
    bench, emulated = opened("free", BUS, role="bench", drives=True)
    assert emulated.machines["test"].bus_voltage == 0.0
    switched_on(bench, 29.6, 10.0)
    assert emulated.machines["test"].bus_voltage == pytest.approx(29.6)
    emulated.rig.actuators["test"].command("velocity", 20.0)
    run(bench, 2.0, period=0.01)
    assert emulated.rig.actuators["test"].velocity == pytest.approx(20.0, rel=0.01)
    power = emulated.rig.bus_power
    assert emulated.far_ends["supply"].fed.amperes == pytest.approx(power / 29.6, rel=0.1)
    outcome = make_safe(bench.drivers.values())
    assert list(outcome) == ["drive_test", "drive_load", "torque_sensor", "daq", "supply"]
    assert outcome["supply"].safe
    assert emulated.rig.bus_voltage == 0.0
    assert emulated.rig.actuators["test"].mode == "off"


def test_supplies_come_last_whatever_the_order_of_the_file(opened):
    bench, _emulated = opened("free", BUS, role="bench", drives=True)
    assert list(make_safe(reversed(bench.drivers.values())))[-1] == "supply"


@pytest.mark.parametrize("kind", [Rig, SteppedRig])
def test_a_drive_without_a_bus_drives_nothing(kind):
    rig = kind("free")
    rig.supply(0.0)
    rig.actuators["test"].command("current", 5.0)
    rig.advance(0.1)
    assert (rig.bus_voltage, rig.actuators["test"].current_true) == (0.0, 0.0)
    rig.supply(12.0)
    rig.actuators["test"].command("velocity", 38.0)
    rig.advance(3.0)
    assert rig.bus_voltage == 12.0
    assert rig.actuators["test"].voltage == pytest.approx(12.0 / 2**0.5, rel=0.01)  # the ceiling of that bus


def test_only_the_test_motor_has_leads(opened):
    with pytest.raises(InputError, match="an emulated supply feeds leads of 'test', not of 'load'"):
        opened("heated", LEADS, role="load")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    (tmp_path / "watch.yaml").write_text(WATCH)
    written(tmp_path / "bench.yaml", LEADS)
    return tmp_path


def test_a_run_ends_with_the_supply_confirmed_off(here):
    ended = leactl("run", "watch.yaml", "--bench", "bench.yaml", "--json", **os.environ)
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["safe"]["supply"] == {"confirmed": True, "detail": "output off, 0.000 A"}


def test_a_run_meets_a_served_supply_on_a_pseudo_terminal(here):
    server = subprocess.Popen(
        [*COMMAND, "bench", "serve", "bench.yaml", "--setup", "heated"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        name, _serial, _on, path = server.stdout.readline().split()
        assert name == "supply0:"
        assert server.stdout.readline() == "serving; Ctrl-C ends it\n"
        bus = f"--bus=supply0=serial:{path}"
        ended = leactl("run", "watch.yaml", "--bench", "bench.yaml", "--served", bus, "--json", **os.environ)
        assert ended.returncode == 0, ended.stderr
        assert json.loads(ended.stdout)["safe"]["supply"]["confirmed"]
    finally:
        server.send_signal(signal.SIGINT)
        _out, err = server.communicate()
    assert (server.returncode, err) == (0, "")
