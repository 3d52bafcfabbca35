"""Check this machine for a bench: interpreter, packages, plug-ins, buses with permissions, free disk space."""

import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

from leactl.driver import registry
from leactl.driver.can_port import CHECK_BUS_HINT

LEAST_PYTHON = (3, 11)
LEAST_FREE_BYTES = 2 << 30  # enough for some 100 h of recording at 50 Hz, or 3 h at 1 kHz
CAN_TYPE = "280"  # ARPHRD_CAN in /sys/class/net/*/type
IP_TIMEOUT_S = 5.0  # time for an answer of iproute2
# a cycle of two drives at 1 kHz queues seven frames, and Linux gives the queue of an interface room for ten
LEAST_QUEUE_FRAMES = 100
RESTART_MS = 100  # time until a controller that has left the bus returns, so that drives can be commanded to stop


@dataclass(frozen=True)
class HostFinding:
    """Result of one check; `needed` if leactl does not work without it."""

    subject: str
    fine: bool
    needed: bool
    found: str
    mend: str = ""


def ip_link(interface: str) -> Mapping[str, Any]:
    """Return the JSON object of iproute2 for a network interface; empty if there is no answer."""
    command = ["ip", "-json", "-details", "-statistics", "link", "show", interface]
    try:
        answer = subprocess.run(command, capture_output=True, timeout=IP_TIMEOUT_S, check=True)
        [link] = json.loads(answer.stdout)
    except (OSError, subprocess.SubprocessError, ValueError):
        return {}
    return link if isinstance(link, dict) else {}


def run_checks(root: Path = Path("/"), link_of: Callable[[str], Mapping[str, Any]] = ip_link) -> list[HostFinding]:
    """Run all checks; `root` contains /sys and /dev, and `link_of` returns the link of a CAN interface by name."""
    checks = [_python(), _packages(), _plugins(), _can(root, link_of), _i2c(root), _serial(root), ni_daqmx(), _disk()]
    return [finding for findings in checks for finding in findings]


def _python() -> Iterator[HostFinding]:
    """Check the version of the interpreter."""
    fine = sys.version_info >= LEAST_PYTHON
    mend = "" if fine else "sudo apt install python3.11 python3.11-venv"
    yield HostFinding("python", fine, True, f"{platform.python_version()} on {platform.machine()}", mend)


def _packages() -> Iterator[HostFinding]:
    """Check that each package is installed that leactl or one of its extras requires, except those of tests."""
    for requirement in requires("leactl") or ():
        extra = requirement.partition("extra ==")[2].strip(" \"'")
        if extra == "test":
            continue
        name = requirement.partition(";")[0].rstrip().partition(">")[0].strip()
        try:
            yield HostFinding(f"package {name}", True, not extra, version(name))
        except PackageNotFoundError:
            mend = f"pip install 'leactl[{extra}]'" if extra else f"pip install {name}"
            yield HostFinding(f"package {name}", False, not extra, "not installed", mend)


def _plugins() -> Iterator[HostFinding]:
    """Check that each registered driver can be loaded."""
    for registered in registry.survey():
        fine = registered.driver is not None
        mend = "" if fine else f"pip install --force-reinstall {registered.source.partition(' ')[0]}, or remove it"
        yield HostFinding(
            f"driver {registered.name}", fine, False, registered.source if fine else registered.error, mend
        )


def can_interfaces(root: Path = Path("/")) -> dict[str, str]:
    """Return the state of each CAN interface of the kernel, by name."""
    folder = root / "sys/class/net"
    links = sorted(folder.iterdir()) if folder.is_dir() else []
    return {link.name: _text(link / "operstate") for link in links if _text(link / "type") == CAN_TYPE}


def is_up(state: str) -> bool:
    """Return whether a CAN interface in this state passes frames; the state of a virtual interface is `unknown`."""
    return state in ("up", "unknown")


def bring_up_command(interface: str, bitrate: int | None = None) -> str:
    """Return the command that brings a CAN interface up, at 1 Mbit/s if it has no bit rate yet."""
    return f"sudo ip link set {interface} up type can bitrate {bitrate or 1_000_000}"


def _can(root: Path, link_of: Callable[[str], Mapping[str, Any]]) -> Iterator[HostFinding]:
    """Check every CAN interface of the kernel."""
    interfaces = can_interfaces(root)
    if not interfaces:
        yield HostFinding(
            "CAN", False, False, "no SocketCAN interface", f"connect an adapter, then: {bring_up_command('can0')}"
        )
    for name, state in interfaces.items():
        yield _can_link(name, state, link_of(name))


def _can_link(name: str, state: str, link: Mapping[str, Any]) -> HostFinding:
    """Check a CAN interface: its state, controller, bit rate, restart and queue, according to the kernel."""
    can_data = _nested(link, "linkinfo", "info_data")
    controller, bitrate = can_data.get("state", ""), _nested(can_data, "bittiming").get("bitrate")
    error_counters, restart_ms, queue = (
        _nested(can_data, "berr_counter"),
        can_data.get("restart_ms"),
        link.get("txqlen"),
    )
    bus_off_count = _nested(link, "linkinfo", "info_xstats").get("bus_off", 0)
    facts = [
        state,
        f"{bitrate} bit/s" if bitrate else "",
        f"controller {controller}" if controller else "",
        f"error counters {error_counters['tx']} sent, {error_counters['rx']} received"
        if {"tx", "rx"} <= error_counters.keys()
        else "",
        f"has left the bus {bus_off_count} times" if bus_off_count else "",
        f"restart-ms {restart_ms}" if restart_ms is not None else "",
        f"txqueuelen {queue}" if queue is not None else "",
    ]
    fine = is_up(state) and controller not in ("BUS-OFF", "ERROR-PASSIVE")
    if controller == "BUS-OFF":
        up_command = f"{bring_up_command(name, bitrate)} restart-ms {RESTART_MS}"
        mend = f"{CHECK_BUS_HINT}; then: sudo ip link set {name} down && {up_command}"
    elif not is_up(state):
        mend = bring_up_command(name, bitrate)
    elif not fine:
        mend = CHECK_BUS_HINT
    elif queue is not None and queue < LEAST_QUEUE_FRAMES:
        mend = f"room for more frames: sudo ip link set {name} txqueuelen 1000"
    else:
        mend = ""
    return HostFinding(f"CAN {name}", fine, False, ", ".join(filter(None, facts)), mend)


def _nested(link: Mapping[str, Any], *keys: str) -> Mapping[str, Any]:
    """Return a nested object of a link by its keys; empty if it is missing or no object."""
    for key in keys:
        value = link.get(key)
        link = value if isinstance(value, dict) else {}
    return link


def i2c_buses(root: Path = Path("/")) -> list[Path]:
    """Return the I2C buses of the kernel."""
    return sorted((root / "dev").glob("i2c-*"))


def _i2c(root: Path) -> Iterator[HostFinding]:
    """Check the permission for every I2C bus of the kernel."""
    buses = i2c_buses(root)
    if not buses:
        mend = "sudo modprobe i2c-dev; on a Raspberry Pi also: sudo raspi-config nonint do_i2c 0"
        yield HostFinding("I2C", False, False, "no /dev/i2c-*", mend)
    yield from (_usable(f"I2C {path.name}", path, "i2c") for path in buses)


def _serial(root: Path) -> Iterator[HostFinding]:
    """Check the permission for every serial port on USB."""
    for pattern in ("ttyUSB*", "ttyACM*"):
        yield from (_usable(f"serial {path.name}", path, "dialout") for path in sorted((root / "dev").glob(pattern)))


def ni_daqmx() -> Iterator[HostFinding]:
    """Check NI's driver and its devices, if the package `nidaqmx` is installed."""
    try:
        from nidaqmx.errors import Error
        from nidaqmx.system import System
    except ImportError:
        return
    try:
        system = System.local()
        driver_version = system.driver_version
        devices = ", ".join(f"{device.name} ({device.product_type})" for device in system.devices) or "no device"
    except Error:
        yield HostFinding("NI-DAQmx", False, False, "NI's driver is not installed", "see ni.com/downloads, NI-DAQmx")
        return
    description = f"{driver_version.major_version}.{driver_version.minor_version}: {devices}"
    yield HostFinding(
        "NI-DAQmx", devices != "no device", False, description, "connect the device" * (devices == "no device")
    )


def _usable(subject: str, path: Path, group: str) -> HostFinding:
    """Check that this user may read and write a device file; `group` is the group that may."""
    fine = os.access(path, os.R_OK | os.W_OK)
    mend = "" if fine else f"sudo usermod -aG {group} $USER, then log in again"
    return HostFinding(subject, fine, False, "readable and writable" if fine else "no permission", mend)


def _disk() -> Iterator[HostFinding]:
    """Check the free space on the disk of the present directory."""
    free = shutil.disk_usage(Path.cwd()).free
    fine = free >= LEAST_FREE_BYTES
    mend = "" if fine else "free space here, or give runs another directory with --out"
    yield HostFinding("disk", fine, False, f"{free / 1e9:.1f} GB free in {Path.cwd()}", mend)


def _text(path: Path) -> str:
    """Return the text of a file of the kernel; empty if it cannot be read."""
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return ""
