"""The process of the watchdog: `python -m leactl.runner.watchdog_process MEMORY`, started by `leactl.runner.watchdog`.

The run sends it lines on stdin, whose end means that the run's process has ended. To stop the devices, the watchdog
opens its own connections.
"""

import ctypes
import json
import mmap
import os
import select
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

from leactl.bench.bench import Bench
from leactl.bench.benchfile import BenchFile, check_devices
from leactl.bench.wiring import MachineWiring
from leactl.driver.contract import Confirmation
from leactl.driver.safe_state import make_safe, unconfirmed_devices
from leactl.errors import LeactlError
from leactl.runner.latch import Latch, OpenLatch
from leactl.runner.watchdog import ALLOWED_NS, CYCLES, FIRED_NS, WORDS, standstill_text, time_to_end_s

MCL_CURRENT = 1  # <sys/mman.h>
OOM_SCORE, KILLED_LAST = Path("/proc/self/oom_score_adj"), "-1000"
CHECKS_PER_SILENCE = 10  # within an allowed silence
IDLE_CHECK_S = 0.1  # between two checks while the silence is not limited
KILL_TIMEOUT_S = 5.0  # longest wait for the end of a killed process
SPARE_DESCRIPTORS = 16  # descriptors reserved for connections, in case the system has no more by then
STDERR_TIMEOUT_S = 0.1  # longest wait until stderr takes a line


class Inbox:
    """Messages of the run: path of its recording, its orderly end, and the end of the pipe when its process ends.

    `unsafe` is the text on devices that a run could not confirm safe at its orderly end.
    """

    def __init__(self) -> None:
        self.run, self.done, self.ended, self.unsafe = "none yet", False, False, ""
        self._line = b""

    def first(self) -> bytes:
        """Wait for the line of orders and return it; empty if the run ended before."""
        while b"\n" not in self._line and not self.ended:
            self._read()
        line, _, self._line = self._line.partition(b"\n")
        return line

    def wait(self, seconds: float) -> None:
        """Wait up to `seconds` for messages and take them."""
        if self.ended:
            time.sleep(seconds)
        elif select.select([0], [], [], seconds)[0]:
            self._read()
        *lines, self._line = self._line.split(b"\n")
        for line in lines:
            word, _, value = line.partition(b" ")
            if word == b"run":
                self.run = os.fsdecode(value)
            if word == b"unsafe":
                self.unsafe = os.fsdecode(value)
            self.done = self.done or word == b"done"

    def _read(self) -> None:
        """Wait for bytes on stdin and keep them; no bytes mean that the run's process has ended."""
        received = os.read(0, 65536)
        self.ended = not received
        self._line += received


def main() -> None:
    """Watch a run, and end it if it does not end itself."""
    # the terminal's signals are the run's; where the whole group is asked to end, the run still needs its watchdog
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    sign = memoryview(mmap.mmap(int(sys.argv[1]), 8 * WORDS)).cast("q")
    inbox = Inbox()
    line = inbox.first()
    if not line:
        return
    orders = json.loads(line)
    file = BenchFile.model_validate(orders["bench"])
    bench = None
    try:
        if orders["devices"]:
            wiring = MachineWiring()
            bench = Bench(file, check_devices(file), wiring)
            wiring.load(file.buses.values())
        spare_descriptors = [os.open(os.devnull, os.O_RDONLY) for _ in range(SPARE_DESCRIPTORS)]
    except Exception as error:  # noqa: BLE001 (a foreign plug-in may fail in any way; the run is told, and not begun)
        print(f"{type(error).__name__}: {error}".splitlines()[0], flush=True)
        return
    try:
        latch = OpenLatch(Latch(**orders["latch"]))
    except LeactlError as error:
        print(error, flush=True)
        return
    protect_process()
    print("ready", flush=True)
    process = int(orders["process"])
    cause = watch(process, sign, inbox)
    if cause:
        for descriptor in spare_descriptors:
            os.close(descriptor)
        stop_and_latch(latch, bench, process, cause, inbox)
    latch.close()


def watch(process: int, sign: "memoryview[int]", inbox: Inbox) -> str:
    """Watch until the run's end; return the cause of an end that is not orderly, else an empty string."""
    seen_count, changed_at = -1, 0
    while True:
        allowed_ns = sign[ALLOWED_NS]
        inbox.wait(allowed_ns * 1e-9 / CHECKS_PER_SILENCE if allowed_ns else IDLE_CHECK_S)
        if inbox.unsafe:
            return f"the run ended, and: {inbox.unsafe}"
        if inbox.done:
            return ""
        if inbox.ended:
            return f"process {process} of the run ended without making the bench safe"
        now, count = time.monotonic_ns(), sign[CYCLES]
        if count != seen_count or not allowed_ns:
            seen_count, changed_at = count, now
        elif now - changed_at > allowed_ns:
            sign[FIRED_NS] = now - changed_at
            return standstill_text(process, now - changed_at, allowed_ns)


def protect_process() -> None:
    """Ask the kernel to end this process last for lack of memory, and lock its memory, as far as it permits."""
    with suppress(OSError):
        OOM_SCORE.write_text(KILLED_LAST, encoding="ascii")
    ctypes.CDLL(None).mlockall(MCL_CURRENT)  # refused if RLIMIT_MEMLOCK is less than the memory in use


def stop_and_latch(latch: OpenLatch, bench: Bench | None, process: int, cause: str, inbox: Inbox) -> None:
    """Make the devices safe, end the run's process, make them safe again if unconfirmed, and latch the bench."""
    devices = bench.in_order_of_stop if bench else []
    confirmations = stop_devices(bench)
    say(cause)
    if not (inbox.ended or inbox.unsafe):
        end(process, time_to_end_s(len(devices)), inbox)
        if unconfirmed_devices(confirmations):  # the process may have held a line that allows no second connection
            confirmations = stop_devices(bench)
    for device, confirmation in confirmations.items():
        say(f"{device}: {confirmation.detail}")
    if unconfirmed_devices(confirmations):
        say(unconfirmed_devices(confirmations))
    try:
        latch.set(cause, Path(inbox.run))
    except LeactlError as error:
        say(f"THE BENCH IS NOT LATCHED: {error}")


def stop_devices(bench: Bench | None) -> dict[str, Confirmation]:
    """Make every device safe over fresh connections, and close these."""
    if bench is None:
        return {}
    confirmations = make_safe(bench.in_order_of_stop)
    bench.close()
    return confirmations


def end(process: int, grace_s: float, inbox: Inbox) -> None:
    """End the hung process: ask it for an orderly end first, then kill it."""
    ask(process, signal.SIGTERM)
    ask(process, signal.SIGCONT)  # a process stopped by Ctrl-Z can then end itself as well
    deadline = time.monotonic() + grace_s
    while not (inbox.done or inbox.ended) and time.monotonic() < deadline:
        inbox.wait(IDLE_CHECK_S)
    if inbox.done or inbox.ended:
        return
    say(f"process {process} does not end by itself and is killed")
    ask(process, signal.SIGKILL)
    deadline = time.monotonic() + KILL_TIMEOUT_S
    while not inbox.ended and time.monotonic() < deadline:
        inbox.wait(IDLE_CHECK_S)


def ask(process: int, number: signal.Signals) -> None:
    """Send a signal to the run's process while it is the parent; later its number may be another process's."""
    if os.getppid() == process:
        os.kill(process, number)


def say(text: str) -> None:
    """Write one line to stderr if stderr takes it in time: a terminal held by Ctrl-S must not delay the end."""
    with suppress(OSError):
        if select.select([], [2], [], STDERR_TIMEOUT_S)[1]:
            os.write(2, f"leactl watchdog: {text}\n".encode())


if __name__ == "__main__":
    main()
