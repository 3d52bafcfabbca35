"""What the doctor makes of a machine's files, and what the commands it names would change."""

from leactl.bench.host_checks import run_checks


def finding(root, subject):
    return next(item for item in run_checks(root) if item.subject == subject)


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


def test_buses_of_this_user_are_fine(tmp_path):
    (tmp_path / "dev").mkdir()
    (tmp_path / "dev/i2c-1").touch()
    (tmp_path / "dev/ttyUSB0").touch()
    assert finding(tmp_path, "I2C i2c-1").fine
    assert finding(tmp_path, "serial ttyUSB0").fine
