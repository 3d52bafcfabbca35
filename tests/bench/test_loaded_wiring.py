"""Connections that are made when no module can be read any more: the program was removed, or its disk is gone."""

import os
import subprocess
import sys

import pytest

from leactl.bench.benchfile import SHIPPED

LIMITS = "voltage_limit_V: 8.0, current_limit_A: 10.0"
SUPPLY = f"driver: scpi_supply, settings: {{dialect: e36xx, model: E3633A, feeds: leads, {LIMITS}}}"
BUSES = """
  supply0: {kind: serial, port: PORT}
  supply1: {kind: visa, resource: "TCPIP::127.0.0.1::9::SOCKET"}
devices:"""
STOP = """
import sys
from leactl.bench.bench import Bench
from leactl.bench.benchfile import check_devices, load
from leactl.bench.wiring import MachineWiring
from leactl.driver.safe_state import make_safe

file, _devices, _document = load(sys.argv[1])
wiring = MachineWiring()
bench = Bench(file, check_devices(file), wiring)
if sys.argv[2] == "loaded":
    wiring.load(file.buses.values())
sys.path.clear()
sys.path_importer_cache.clear()
sys.path_hooks.clear()
for name, confirmation in make_safe(bench.in_order_of_stop).items():
    print(name, confirmation.safe, confirmation.detail)
"""


@pytest.fixture
def bench(tmp_path):
    """A bench with a device on a bus of every kind, none of which answers; its supply's line is a pseudo terminal."""
    leader, follower = os.openpty()
    text = (SHIPPED / "testbed.yaml").read_text(encoding="utf-8")
    text = text.replace("interface: socketcan, channel: can0, bitrate: 1000000", "interface: udp_multicast")
    text = text.replace("interface: udp_multicast", "interface: udp_multicast, channel: 239.74.163.2")
    text = text.replace("{kind: i2c, number: 1}", "{kind: i2c, number: 250}")
    text = text.replace("\ndevices:", BUSES.replace("PORT", os.ttyname(follower)), 1)
    devices = "".join(
        f"  supply_{role}: {{bus: {bus}, role: {role}, {SUPPLY}}}\n"
        for role, bus in (("test", "supply0"), ("load", "supply1"))
    )
    text = text.replace("\nlimits:\n", f"\n{devices}limits:\n", 1)
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    yield path
    os.close(leader)
    os.close(follower)


def stopped(bench, how):
    """What is said of each device by a process that lost every place of modules before it made them safe."""
    done = subprocess.run(
        [sys.executable, "-c", STOP, str(bench), how], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return dict(line.split(" ", 1) for line in done.stdout.splitlines())


def test_every_bus_is_reached_without_a_module_from_the_disk(bench):
    said = stopped(bench, "loaded")
    assert set(said) == {"drive_test", "drive_load", "torque_sensor", "supply_test", "supply_load"}
    for text in said.values():
        assert "module" not in text
    assert "no SDO answer" in said["drive_test"]
    assert "refused" in said["supply_load"]


def test_without_that_they_would_not_be(bench):
    assert "No module named" in stopped(bench, "plain")["supply_test"]
