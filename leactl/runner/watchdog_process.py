"""The watchdog's own process: `python -m leactl.runner.watchdog_process MEMORY`, started by `leactl.runner.watchdog`.

It is told by lines on stdin, whose end is the run's death; what it does then it does over connections of its own.
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
from leactl.runner.latch import Latch, Ready
from leactl.runner.watchdog import ALLOWED_NS, CYCLES, FIRED_NS, WORDS, hung, time_to_end_s

MCL_CURRENT = 1  # <sys/mman.h>
OOM_SCORE, KILLED_LAST = Path("/proc/self/oom_score_adj"), "-1000"
LOOKS = 10  # within an allowed silence
IDLE_S = 0.1  # between two looks while no silence counts
KILLED_S = 5.0  # until the end of a killed process shows
SPARE = 16  # descriptors that are held for connections where the system has no more by then
STDERR_S = 0.1  # that a line may wait to be taken


class Inbox:
    """What the run says: where it is recorded, that it is done; the end of the pipe says that it is no more.

    `unsafe` is what a run that ends in order could not confirm.
    """

    def __init__(self) -> None:
        self.run, self.done, self.ended, self.unsafe = "none yet", False, False, ""
        self._line = b""

    def first(self) -> bytes:
        """The line of orders; empty where the run ended before it."""
        while b"\n" not in self._line and not self.ended:
            self._read()
        line, _, self._line = self._line.partition(b"\n")
        return line

    def wait(self, seconds: float) -> None:
        """Take what comes within a time."""
        if self.ended:
            time.sleep(seconds)
        elif select.select([0], [], [], seconds)[0]:
            self._read()
        *lines, self._line = self._line.split(b"\n")
        for line in lines:
            word, _, rest = line.partition(b" ")
            if word == b"run":
                self.run = os.fsdecode(rest)
            if word == b"unsafe":
                self.unsafe = os.fsdecode(rest)
            self.done = self.done or word == b"done"

    def _read(self) -> None:
        read = os.read(0, 65536)
        self.ended = not read
        self._line += read


def main() -> None:
    """Watch a run, and end it where it does not end itself."""
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
        spare = [os.open(os.devnull, os.O_RDONLY) for _ in range(SPARE)]
    except Exception as error:  # noqa: BLE001 (a foreign plug-in may fail in any way; the run is told, and not begun)
        print(f"{type(error).__name__}: {error}".splitlines()[0], flush=True)
        return
    try:
        latch = Ready(Latch(**orders["latch"]))
    except LeactlError as error:
        print(error, flush=True)
        return
    hold_on()
    print("ready", flush=True)
    process = int(orders["process"])
    cause = watched(process, sign, inbox)
    if cause:
        for descriptor in spare:
            os.close(descriptor)
        act(latch, bench, process, cause, inbox)
    latch.close()


def watched(process: int, sign: "memoryview[int]", inbox: Inbox) -> str:
    """Watch until the run's end; the cause where that is not an orderly one, else empty."""
    seen, since = -1, 0
    while True:
        allowed = sign[ALLOWED_NS]
        inbox.wait(allowed * 1e-9 / LOOKS if allowed else IDLE_S)
        if inbox.unsafe:
            return f"the run ended, and: {inbox.unsafe}"
        if inbox.done:
            return ""
        if inbox.ended:
            return f"process {process} of the run ended without making the bench safe"
        now, count = time.monotonic_ns(), sign[CYCLES]
        if count != seen or not allowed:
            seen, since = count, now
        elif now - since > allowed:
            sign[FIRED_NS] = now - since
            return hung(process, now - since, allowed)


def hold_on() -> None:
    """Be the last that the kernel ends for want of memory, and keep what is in memory there, as far as it permits."""
    with suppress(OSError):
        OOM_SCORE.write_text(KILLED_LAST, encoding="ascii")
    ctypes.CDLL(None).mlockall(MCL_CURRENT)  # refused where RLIMIT_MEMLOCK is less than what is in use


def act(latch: Ready, bench: Bench | None, process: int, cause: str, inbox: Inbox) -> None:
    """Take the power away, end the process, take the power away again where that was in doubt, and latch the bench."""
    devices = bench.in_order_of_stop if bench else []
    safe = stopped(bench)
    say(cause)
    if not (inbox.ended or inbox.unsafe):
        end(process, time_to_end_s(len(devices)), inbox)
        if unconfirmed_devices(safe):  # the process may have held what no second connection could have
            safe = stopped(bench)
    for device, confirmation in safe.items():
        say(f"{device}: {confirmation.detail}")
    if unconfirmed_devices(safe):
        say(unconfirmed_devices(safe))
    try:
        latch.set(cause, Path(inbox.run))
    except LeactlError as error:
        say(f"THE BENCH IS NOT LATCHED: {error}")


def stopped(bench: Bench | None) -> dict[str, Confirmation]:
    """Make every device safe over fresh connections, and let them go."""
    if bench is None:
        return {}
    safe = make_safe(bench.in_order_of_stop)
    bench.close()
    return safe


def end(process: int, grace_s: float, inbox: Inbox) -> None:
    """End the hung process: asked first, for its own orderly end, then killed."""
    ask(process, signal.SIGTERM)
    ask(process, signal.SIGCONT)  # one that was stopped, by Ctrl-Z say, can end itself as well
    until = time.monotonic() + grace_s
    while not (inbox.done or inbox.ended) and time.monotonic() < until:
        inbox.wait(IDLE_S)
    if inbox.done or inbox.ended:
        return
    say(f"process {process} does not end by itself and is killed")
    ask(process, signal.SIGKILL)
    until = time.monotonic() + KILLED_S
    while not inbox.ended and time.monotonic() < until:
        inbox.wait(IDLE_S)


def ask(process: int, number: signal.Signals) -> None:
    """Send a signal to the parent; once it is gone its number may be another's."""
    if os.getppid() == process:
        os.kill(process, number)


def say(text: str) -> None:
    """One line on stderr, if there still is one and it takes it: a terminal held by Ctrl-S must not hold the end."""
    with suppress(OSError):
        if select.select([], [2], [], STDERR_S)[1]:
            os.write(2, f"leactl watchdog: {text}\n".encode())


if __name__ == "__main__":
    main()
