"""Locks that allow one run at a time on a bench: for its name, each of its buses and each of its export folders.

Each lock is an abstract socket, a name in the kernel that is the same for every user, home and directory of state on
this machine: there is no lock file that could vanish, lead elsewhere or be out of a user's reach. A lock ends with its
process, whatever ends that. A bus is locked by the machine's own name for it, so that two bench files cannot reach the
same devices.
"""

import errno
import os
import re
import socket
import stat
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from leactl.bench.benchfile import BenchFile, Bus, CheckedDevice, I2cBus, SerialBus, VisaBus
from leactl.driver.file_records import RecordSettings
from leactl.errors import DeviceError, InputError
from leactl.runner import lock_holders, state_folder

HOLDER_QUEUE_LENGTH = 4096  # requests for the holder stay in the queue of its socket; if it is full, none is answered
UDP_MULTICAST_PORT = 43113  # of python-can, unless an option names another


@contextmanager
def held(bench: BenchFile, devices: Sequence[CheckedDevice]) -> Iterator[list[int]]:
    """Lock a bench, the buses of its devices and their export folders until the block is left.

    It yields the descriptors of the locks: a process that inherits them holds the locks as well, until its own end.

    Raises
    ------
    DeviceError : another run holds one of the locks; with its process.
    InputError : this is no Linux.
    """
    if sys.platform != "linux":
        raise InputError(
            f"bench '{bench.name}': devices are driven on Linux alone; emulated benches and files are for any system"
        )
    bus_names = sorted({device.entry.bus for device in devices if device.entry.bus})
    subjects = {name_of(bench): f"bench '{bench.name}'"}
    for name in bus_names:
        key, display_name = _bus_key(bench.buses[name])
        subjects.setdefault(key, f"bus '{name}' ({display_name})")
    for device in devices:
        settings = device.settings
        if isinstance(settings, RecordSettings) and settings.exports_folder is not None:
            folder = str(Path(settings.exports_folder).resolve())
            subjects.setdefault(folder, f"the folder {folder} of '{device.name}'")
    with ExitStack() as stack:
        yield [
            stack.enter_context(alone(key, f"{subject} is driven by another run")) for key, subject in subjects.items()
        ]


@contextmanager
def bus_held(bus: Bus) -> Iterator[None]:
    """Lock one bus, which need not be in a bench file, until the block is left.

    Raises
    ------
    DeviceError : a run drives devices on it; with its process.
    InputError : this is no Linux.
    """
    if sys.platform != "linux":
        raise InputError("devices are asked on Linux alone")
    key, display_name = _bus_key(bus)
    with alone(key, f"{display_name} is driven by a run"):
        yield


@contextmanager
def idle(bench: str) -> Iterator[None]:
    """Lock every bench of a name, on real buses or served, until the block is left, so that no run has one.

    Raises
    ------
    DeviceError : a run, another reset, or a watchdog that has not made a bench safe yet, holds one; with its process.
    """
    with ExitStack() as stack:
        if sys.platform == "linux":  # elsewhere no device is driven
            served_names = (_served_lock_name(bench, folder) for folder in state_folder.folders())
            for name in dict.fromkeys((_real_lock_name(bench), *served_names)):
                stack.enter_context(alone(name, f"bench '{bench}' cannot be reset: a run or another reset has it"))
        yield


def name_of(bench: BenchFile) -> str:
    """Return the name of a bench's lock; that of a served bench contains the state folder, because names may repeat."""
    if bench.emulated is None:
        return _real_lock_name(bench.name)
    return _served_lock_name(bench.name, state_folder.folder_of(bench, in_process=False))


def _real_lock_name(bench: str) -> str:
    """Return the name of the lock of a bench on real buses."""
    return f"bench-{bench}"


def _served_lock_name(bench: str, folder: state_folder.StateFolder) -> str:
    """Return the name of the lock of a served bench, whose state is in this folder."""
    return f"{folder.directory}/bench-{bench}"


@contextmanager
def alone(key: str, taken_message: str) -> Iterator[int]:
    """Hold the lock of a name on this machine until the block is left, and yield its descriptor.

    Parameters
    ----------
    taken_message : beginning of the message that another process holds the lock.

    Raises
    ------
    DeviceError : another process holds the lock, or it cannot be made.
    """
    name = lock_holders.lock_of(key)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as lock:
        try:
            lock.bind(name)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise DeviceError(f"{key}: cannot be held: {error.strerror}") from None
            raise DeviceError(
                f"{taken_message}, {_holder_text(name)}; wait for its end, or: leactl bench stop"
            ) from None
        lock.listen(HOLDER_QUEUE_LENGTH)
        yield lock.fileno()


def _holder_text(name: bytes) -> str:
    """Return as text the process that holds a lock, according to the kernel, and its user if it is another user."""
    holder = lock_holders.holder(name)
    if holder is None:  # between its bind and its listen, or its queue is full
        return "process unknown"
    process, user = holder
    if user == os.geteuid():
        return f"process {process}"
    import pwd  # of POSIX alone, as is fcntl

    try:
        return f"process {process} of user {pwd.getpwuid(user).pw_name}"
    except KeyError:
        return f"process {process} of user {user}"


@contextmanager
def locked(path: Path, taken_message: str) -> Iterator[int]:
    """Hold a lock file until the block is left, and yield its descriptor.

    Parameters
    ----------
    taken_message : beginning of the message that another process holds the lock.

    Raises
    ------
    DeviceError : another process holds the lock.
    InputError : the file cannot be made, or the system has no locks of files.
    """
    try:
        import fcntl
    except ImportError:
        raise InputError(f"{path}: this system has no locks of files, which keep two processes apart here") from None
    try:
        descriptor = state_folder.open_file(path, shared=False)
    except OSError as error:
        raise InputError(f"{path}: no lock can be kept here: {error.strerror or error}") from None
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(descriptor, 20).decode("ascii", "replace").strip() or "unknown"
            raise DeviceError(f"{taken_message}, process {holder}; wait for its end, or: leactl bench stop") from None
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"{os.getpid()}\n".encode())
        yield descriptor
    finally:
        os.close(descriptor)  # releases the lock; the file stays: removing it would let two runs lock two files


def _bus_key(bus: Bus) -> tuple[str, str]:
    """Return the machine's own name of a bus, whatever a bench file calls the bus, and its name for a person."""
    if isinstance(bus, I2cBus):
        return f"i2c-{bus.number}", f"i2c-{bus.number}"
    if isinstance(bus, SerialBus):
        return _device_key(bus.port)
    if isinstance(bus, VisaBus):
        address = "tcp-{}-{}".format(*bus.address)
        return address, address
    channel = str(bus.channel)
    # slcan takes /dev/ttyACM0@115200, and pyserial spy:///dev/ttyACM0?file=...
    path = re.sub(r"^[a-z0-9]+://(?=/)", "", channel).partition("?")[0].partition("@")[0]
    if "/" in path and ("://" not in channel or path.startswith("/")):
        return _device_key(path)
    if bus.interface == "socketcan":
        channel = _interface_name(channel)
    port = bus.options.get("port", UDP_MULTICAST_PORT if bus.interface == "udp_multicast" else None)
    address = "-".join([bus.interface, channel, *([str(port)] if port is not None else [])])
    return address, address


def _device_key(port: str) -> tuple[str, str]:
    """Return a name of a port by its device number in the kernel, which all links to it share, and its path.

    Return the path twice if it is no character device.
    """
    path = str(Path(port).resolve())
    try:
        status = Path(path).stat()
    except OSError:
        return path, path
    if not stat.S_ISCHR(status.st_mode):
        return path, path
    return f"device-{os.major(status.st_rdev)}-{os.minor(status.st_rdev)}", path


def _interface_name(channel: str) -> str:
    """Return the first name of a network interface with others (`ip link property add dev can0 altname ...`)."""
    try:
        return socket.if_indextoname(socket.if_nametoindex(channel))
    except OSError:
        return channel
