"""What the doctor makes of a machine's files, and what the commands it names would change."""

import pytest

from leactl.bench.host_checks import ip_link, run_checks


def finding(root, subject, link=None):
    return next(item for item in run_checks(root, lambda name: link or {}) if item.subject == subject)


def interface(root, name, kind, state):
    folder = root / "sys/class/net" / name
    folder.mkdir(parents=True)
    (folder / "type").write_text(f"{kind}\n")
    (folder / "operstate").write_text(f"{state}\n")


def test_a_machine_without_buses_says_how_to_get_them(tmp_path):
    interface(tmp_path, "eth0", 1, "up")
    assert "ip link set can0 up type can bitrate 1000000" in finding(tmp_path, "CAN").mend
    assert "modprobe i2c-dev" in finding(tmp_path, "I2C").mend


def test_a_can_interface_that_is_down_is_named_with_its_own_command(tmp_path):
    interface(tmp_path, "can0", 280, "up")
    interface(tmp_path, "can1", 280, "down")
    interface(tmp_path, "vcan0", 280, "unknown")  # what a virtual interface calls up
    assert finding(tmp_path, "CAN can0").fine
    assert finding(tmp_path, "CAN vcan0").fine
    down = finding(tmp_path, "CAN can1")
    assert (down.fine, down.needed, down.found) == (False, False, "down")
    assert down.mend == "sudo ip link set can1 up type can bitrate 1000000"


def can_link(controller="ERROR-ACTIVE", queue=1000, left=0, tx=0):
    """What iproute2 5.x and 6.x print by `ip -json -details link show can0`, but for what is not read."""
    data = {
        "state": controller,
        "berr_counter": {"tx": tx, "rx": 0},
        "restart_ms": 0,
        "bittiming": {"bitrate": 500000, "sample_point": "0.875", "tq": 125},
    }
    told = {"info_kind": "can", "info_data": data, "info_xstats": {"restarts": 0, "bus_error": 3, "bus_off": left}}
    return {"ifname": "can0", "mtu": 16, "operstate": "UP", "txqlen": queue, "linkinfo": told}


def test_a_can_interface_tells_controller_rate_counters_restart_and_queue(tmp_path):
    interface(tmp_path, "can0", 280, "up")
    here = finding(tmp_path, "CAN can0", can_link())
    assert (here.fine, here.mend) == (True, "")
    assert here.found == (
        "up, 500000 bit/s, controller ERROR-ACTIVE, error counters 0 sent, 0 received, restart-ms 0, txqueuelen 1000"
    )


@pytest.mark.parametrize(
    ("state", "link", "mend"),
    [
        (
            "down",
            can_link("BUS-OFF", left=2),
            "look at cable, termination and bit rate; then: sudo ip link set can0 down &&"
            " sudo ip link set can0 up type can bitrate 500000 restart-ms 100",
        ),
        ("up", can_link("ERROR-PASSIVE", tx=128), "look at cable, termination and bit rate"),
    ],
)
def test_a_controller_that_is_off_the_bus_or_about_to_leave_it_is_not_fine(tmp_path, state, link, mend):
    interface(tmp_path, "can0", 280, state)
    here = finding(tmp_path, "CAN can0", link)
    assert (here.fine, here.mend) == (False, mend)
    assert ("has left the bus 2 times" in here.found) is (state == "down")


def test_a_short_queue_is_fine_and_its_command_is_given(tmp_path):
    interface(tmp_path, "can0", 280, "up")
    here = finding(tmp_path, "CAN can0", can_link(queue=10))
    assert (here.fine, here.mend) == (True, "room for more frames: sudo ip link set can0 txqueuelen 1000")


@pytest.mark.parametrize("prints", ["", "[]", "[1]", "{}", "not json", None])
def test_a_machine_whose_iproute2_tells_nothing_is_looked_at_all_the_same(tmp_path, monkeypatch, prints):
    if prints is not None:
        ip = tmp_path / "ip"
        ip.write_text(f"#!/bin/sh\nprintf '%s' '{prints}'\n")
        ip.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin" if prints is not None else str(tmp_path))
    assert ip_link("can0") == {}


def test_buses_of_this_user_are_fine(tmp_path):
    (tmp_path / "dev").mkdir()
    (tmp_path / "dev/i2c-1").touch()
    (tmp_path / "dev/ttyUSB0").touch()
    assert finding(tmp_path, "I2C i2c-1").fine
    assert finding(tmp_path, "serial ttyUSB0").fine
