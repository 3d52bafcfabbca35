"""Requirements on every device, open and closed: units, calls that do not wait, nothing held when closed."""

import threading
from contextlib import nullcontext, suppress
from pathlib import Path

from leactl.driver.contract import CyclicDevice, MotionDevice, PowerSupply
from leactl.emulation.trial import drives, supplies
from leactl.emulation.trial.stand import ANSWER_S, Broken, Stand
from leactl.errors import DeviceError
from leactl.quantities import accepted_units

LOOKED_S, LOOK_S = 0.5, 0.01
LATE_S = 1e-6  # of rounding
OPEN_FILES = Path("/proc/self/fd")  # of Linux alone; elsewhere only threads and ports are counted


def in_use(stand: Stand) -> None:
    """Open a device and put it to its use: operation, output on, or open."""
    if isinstance(stand.driver, MotionDevice):
        drives.in_operation(stand)
    elif isinstance(stand.driver, PowerSupply):
        supplies.switched_on(stand)
    else:
        stand.driver.open()


def names_its_quantities(stand: Stand) -> None:
    """Each channel has a quantity of the vocabulary and a unit of that quantity."""
    stand.driver.open()
    channels = [channel for spec in stand.driver.streams for channel in spec.channels]
    if isinstance(stand.driver, CyclicDevice):
        channels += stand.driver.loop_channels
    for channel in channels:
        units = accepted_units(channel.quantity)
        if not units:
            raise Broken(f"{channel.name}: '{channel.quantity}' is no quantity of the vocabulary")
        if channel.unit not in units:
            raise Broken(
                f"{channel.name}: {channel.quantity} is in '{channel.unit}'; {' or '.join(units)} was expected"
            )


def waits_for_nothing(stand: Stand) -> None:
    """No call of a cycle waits, except `end_cycle`, which ends by its deadline; also with an unplugged cable."""
    in_use(stand)
    calls_in_time(stand, is_cut=False)
    stand.cut()
    calls_in_time(stand, is_cut=True)


def calls_in_time(stand: Stand, is_cut: bool) -> None:
    """Make the calls of some cycles, and raise Broken if one ends late; any call may report an unplugged cable."""

    def call(name: str, longest: float, *arguments: float) -> None:
        deadline = stand.clock.now() + longest
        with suppress(DeviceError) if is_cut else nullcontext():
            getattr(stand.driver, name)(*arguments)
        if (late := stand.clock.now() - deadline) > LATE_S:
            raise Broken(f"{name}() is over {late:.4f} s too late; it may hold up no cycle")

    began = stand.clock.now()
    while (now := stand.clock.now()) < began + LOOKED_S:
        if isinstance(stand.driver, MotionDevice):
            call("begin_cycle", 0.0)
            with suppress(DeviceError) if is_cut else nullcontext():
                stand.synchronise()
            call("end_cycle", ANSWER_S, stand.clock.now() + ANSWER_S)
            call("feed", 0.0)
        call("take", 0.0)
        call("notices", 0.0)
        stand.clock.sleep_until(now + LOOK_S)


def lets_go_when_closed(stand: Stand) -> None:
    """`close` leaves no port, thread or file open; `safe_state` is confirmed afterwards too."""
    in_use(stand)
    stand.driver.close()
    stand.renew_driver()
    threads, files = threading.active_count(), open_files()  # a process makes some at the first use, and never again
    in_use(stand)
    if not drives.confirmed(stand):
        raise Broken("safe_state in operation is not confirmed although the device answers")
    stand.driver.close()
    holds_nothing(stand, threads, files)
    if not drives.confirmed(stand):
        raise Broken("safe_state after close() is not confirmed although the device answers")
    stand.driver.close()


def holds_nothing(stand: Stand, threads: int, files: int) -> None:
    """Raise Broken if a port, a thread or a file is open that was not open before."""
    if stand.is_connected:
        raise Broken("its bus is still open after close(): the port is opened more often than it is closed")
    if (extra := threading.active_count() - threads) > 0:
        raise Broken(f"{extra} more threads run after close() than before open()")
    if (extra := open_files() - files) > 0:
        raise Broken(f"{extra} more files are open after close() than before open()")


def open_files() -> int:
    """Number of file descriptors of this process; 0 if the system cannot list them."""
    return len(list(OPEN_FILES.iterdir())) if OPEN_FILES.is_dir() else 0


def stops_what_another_has_left_on(stand: Stand) -> None:
    """`safe_state` of a driver that was never opened takes the power from a device that an earlier host left on."""
    in_use(stand)
    stand.renew_driver()
    if not drives.confirmed(stand):
        raise Broken("safe_state before open() is not confirmed although the device answers")
    if stand.machine.following[0] != "off" or stand.bench.load.fed[1] > 0.0:
        raise Broken("safe_state before open() is confirmed while the device goes on as an earlier host has left it")


TRIALS = (names_its_quantities, waits_for_nothing, lets_go_when_closed)
OF_OUTPUTS = (stops_what_another_has_left_on,)
