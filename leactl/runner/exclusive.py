"""One run at a time on a bench: a lock for its name and each of its buses and export folders, for the whole run.

The kernel holds the locks for the process, so that they end with it whatever ended it. A lock on the bus as the machine
knows it keeps two bench files apart that reach the same devices.
"""

import fcntl
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from leactl.bench.benchfile import BenchFile, Bus, CheckedDevice, I2cBus, SerialBus
from leactl.driver.batch import RecordSettings
from leactl.errors import DeviceError, InputError
from leactl.runner.latch import state_directory


@contextmanager
def held(bench: BenchFile, devices: Sequence[CheckedDevice]) -> Iterator[list[int]]:
    """Hold a bench and the buses of its devices until the block is left.

    It yields the descriptors of the locks: a process that is handed them holds the bench as well, until its own end.

    Raises
    ------
    DeviceError : another run holds one of them; with its process.
    InputError : there is no place for locks.
    """
    used = sorted({device.entry.bus for device in devices if device.entry.bus})
    places = {f"bench-{bench.name}": f"bench '{bench.name}'"}
    for name in used:
        place = _place(bench.buses[name])
        places.setdefault(place, f"bus '{name}' ({place})")
    for device in devices:
        settings = device.settings
        if isinstance(settings, RecordSettings) and settings.exports_folder is not None:
            folder = str(Path(settings.exports_folder).resolve())
            places.setdefault(folder, f"the folder {folder} of '{device.name}'")
    with ExitStack() as stack:
        yield [
            stack.enter_context(
                locked(state_directory() / f"{_file_name(place)}.lock", f"{what} is driven by another run")
            )
            for place, what in places.items()
        ]


@contextmanager
def locked(path: Path, taken: str) -> Iterator[int]:
    """Hold a lock file until the block is left; `taken` opens the line that says who holds it.

    Raises
    ------
    DeviceError : another process holds it.
    InputError : there is no place for it.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        reason = error.strerror or error
        text = f"{path}: no lock can be kept here: {reason}; set LEACTL_STATE to a directory that can be written"
        raise InputError(text) from None
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(descriptor, 20).decode("ascii", "replace").strip() or "unknown"
            raise DeviceError(f"{taken}, process {holder}; wait for its end, or: leactl bench stop") from None
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"{os.getpid()}\n".encode())
        yield descriptor
    finally:
        os.close(descriptor)  # and the lock with it; the file stays: removing it would let two runs lock two files


def _place(bus: Bus) -> str:
    """A bus as the machine knows it, whatever a bench file calls it; a device by the file its links lead to."""
    if isinstance(bus, I2cBus):
        return f"i2c-{bus.number}"
    if isinstance(bus, SerialBus):
        return str(Path(bus.port).resolve())
    channel = str(bus.channel)
    if channel.startswith("/"):
        return str(Path(channel.partition("@")[0]).resolve())  # slcan takes /dev/ttyACM0@115200
    return "-".join([bus.interface, channel, *([str(bus.options["port"])] if "port" in bus.options else [])])


def _file_name(place: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]", "_", place)
