"""Requirements on every device, open and closed: units, calls that do not wait, nothing held when closed."""

import threading
from contextlib import nullcontext, suppress
from pathlib import Path

from leactl.driver.contract import CyclicDevice, MotionDevice, PowerSupply
from leactl.emulation.trial import drives, supplies
from leactl.emulation.trial.stand import ANSWER_S, Broken, Stand
from leactl.errors import DeviceError
from leactl.quantities import accepted_units

WATCH_S, POLL_S = 0.5, 0.01  # duration of all cycles whose calls are timed, and of one cycle
ROUNDING_S = 1e-6  # rounding error of the emulated clock
FILE_DESCRIPTORS = Path("/proc/self/fd")  # only on Linux; elsewhere only threads and ports are counted


def put_to_use(stand: Stand) -> None:
    """Open a device and put it to its use: a drive into operation, a supply's output on."""
    if isinstance(stand.driver, MotionDevice):
        drives.enter_operation(stand)
    elif isinstance(stand.driver, PowerSupply):
        supplies.open_and_switch_on(stand)
    else:
        stand.driver.open()


def declares_known_quantities_and_units(stand: Stand) -> None:
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


def never_waits(stand: Stand) -> None:
    """No call of a cycle waits, except `end_cycle`, which ends by its deadline; also with an unplugged cable."""
    put_to_use(stand)
    check_calls_end_in_time(stand, is_cut=False)
    stand.cut()
    check_calls_end_in_time(stand, is_cut=True)


def check_calls_end_in_time(stand: Stand, is_cut: bool) -> None:
    """Make the calls of some cycles; raise Broken if one ends late. If the cable is cut, any may raise DeviceError."""

    def call(name: str, longest_duration: float, *arguments: float) -> None:
        deadline = stand.clock.now() + longest_duration
        with suppress(DeviceError) if is_cut else nullcontext():
            getattr(stand.driver, name)(*arguments)
        if (lateness := stand.clock.now() - deadline) > ROUNDING_S:
            raise Broken(f"{name}() ends {lateness:.4f} s too late; no call may delay a cycle")

    start_time = stand.clock.now()
    while (cycle_start := stand.clock.now()) < start_time + WATCH_S:
        if isinstance(stand.driver, MotionDevice):
            call("begin_cycle", 0.0)
            with suppress(DeviceError) if is_cut else nullcontext():
                stand.synchronise()
            call("end_cycle", ANSWER_S, stand.clock.now() + ANSWER_S)
            call("feed", 0.0)
        call("take", 0.0)
        call("notices", 0.0)
        stand.clock.sleep_until(cycle_start + POLL_S)


def releases_everything_when_closed(stand: Stand) -> None:
    """`close` leaves no port, thread or file open; `safe_state` is confirmed afterwards too."""
    put_to_use(stand)
    stand.driver.close()
    stand.renew_driver()
    # counted after a first use, which may start threads that last
    thread_count, file_count = threading.active_count(), count_open_files()
    put_to_use(stand)
    if not drives.call_safe_state(stand):
        raise Broken("safe_state in operation is not confirmed although the device answers")
    stand.driver.close()
    check_released(stand, thread_count, file_count)
    if not drives.call_safe_state(stand):
        raise Broken("safe_state after close() is not confirmed although the device answers")
    stand.driver.close()


def check_released(stand: Stand, thread_count: int, file_count: int) -> None:
    """Raise Broken if a port, a thread or a file is open that was not open before."""
    if stand.is_connected:
        raise Broken("its bus is still open after close(): the port is opened more often than it is closed")
    if (excess := threading.active_count() - thread_count) > 0:
        raise Broken(f"{excess} more threads run after close() than before open()")
    if (excess := count_open_files() - file_count) > 0:
        raise Broken(f"{excess} more files are open after close() than before open()")


def count_open_files() -> int:
    """Return the number of file descriptors of this process; 0 if the system cannot list them."""
    return len(list(FILE_DESCRIPTORS.iterdir())) if FILE_DESCRIPTORS.is_dir() else 0


def safe_state_stops_a_device_left_on(stand: Stand) -> None:
    """`safe_state` of a driver that was never opened takes the power from a device that an earlier host left on."""
    put_to_use(stand)
    stand.renew_driver()
    if not drives.call_safe_state(stand):
        raise Broken("safe_state before open() is not confirmed although the device answers")
    if stand.machine.following[0] != "off" or stand.bench.load.fed[1] > 0.0:
        raise Broken("safe_state before open() is confirmed while the device continues as an earlier host left it")


TRIALS = (declares_known_quantities_and_units, never_waits, releases_everything_when_closed)
OUTPUT_TRIALS = (safe_state_stops_a_device_left_on,)
