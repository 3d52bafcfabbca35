"""The run's watchdog: a second process that stops the bench if the control loop hangs or was killed.

The drives' own dead-man acts first and needs nothing of this machine. The loop counts its cycles in memory that both
processes map, which costs no system call; docs/explanation/dead-man.md says what happens when the count stands still.
"""

import faulthandler
import json
import math
import mmap
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path

from leactl.bench.benchfile import BenchFile, CheckedDevice, host_silences
from leactl.driver.contract import SAFE_STATE_S
from leactl.errors import LeactlError
from leactl.runner.latch import Latch

# indices of the words in the shared memory; an allowed silence of 0 means that the loop is not watched
CYCLES, ALLOWED_NS, FIRED_NS = range(3)
WORDS = 3
LEAST_SILENT_CYCLES = 3  # so many cycles of silence are always allowed, because a slow loop does not hang
READY_TIMEOUT_S = 20.0  # for the start of the process: 0.35 s on an idle machine, most of it imports
GRACE_S = 2.0  # for an orderly end, in addition to the time that the devices may take
REARM_EVERY_S = 0.5  # of the timer that ends a run whose watchdog has died
REARMED_WITHIN_CYCLES = 100  # the timer is rearmed within as many cycles; the loop checks its watchdog far more often
LAST_RESORT_S = 15.0  # of the timer beyond the time of an orderly end, so that a living watchdog acts first


def standstill_text(process: int, silence_ns: int, allowed_ns: int) -> str:
    """Return the message on a loop that stands still."""
    return (
        f"the control loop of process {process} stood still for {silence_ns * 1e-9:.3f} s;"
        f" {allowed_ns * 1e-9:g} s are allowed"
    )


def time_to_end_s(devices: int) -> float:
    """Return how long an orderly end may take until every device has confirmed [s]."""
    return GRACE_S + devices * SAFE_STATE_S


class NoWatchdog:
    """No watchdog process, for a run with devices that are emulated in its own process and time."""

    allowed_s = math.inf  # longest silence of the loop

    def __init__(self) -> None:
        self.sign: memoryview[int] | list[int] = [0] * WORDS

    def tell_recording(self, path: Path) -> None:
        """Pass on the path of the recording, for the latch."""

    def begin(self, period: float) -> None:
        """Begin to watch the loop, with cycles of `period` [s]."""

    def allow_end(self) -> None:
        """Allow the longer silence in which the devices are made safe after the loop."""

    def dismiss(self) -> None:
        """End the watch: the devices are safe."""

    def take_over(self, doubt: str) -> None:
        """Make the devices safe over other connections, and latch the bench: the run could not confirm them safe."""

    def fault(self) -> str:
        """Return why the run is no longer watched; empty while it is."""
        return ""

    def verdict(self) -> str:
        """Return why the watchdog stopped the run; empty if it did not."""
        return ""


class Watchdog(NoWatchdog):
    """The parent's side of the process `leactl.runner.watchdog_process`."""

    def __init__(self, file: BenchFile, devices: Sequence[CheckedDevice], locks: Sequence[int], latch: Latch) -> None:
        self._silence_s = min(
            (silence for silence in host_silences(devices).values() if silence is not None), default=SAFE_STATE_S
        )
        self._end_ns = round(1e9 * time_to_end_s(len(devices)))
        self._period, self._rearmed_at = 0.0, 0.0
        self._null_file = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 (closed with the process's pipes)
        memory = os.memfd_create("leactl-watchdog")
        try:
            os.ftruncate(memory, 8 * WORDS)
            self.sign = memoryview(mmap.mmap(memory, 8 * WORDS)).cast("q")
            command = [sys.executable, "-P", "-m", "leactl.runner.watchdog_process", str(memory)]
            # a separate session, so that Ctrl-C and a closed terminal reach the run alone; the inherited locks hold the
            # bench until the watchdog has done its work
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                pass_fds=(memory, *locks),
                start_new_session=True,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(folder or str(Path.cwd()) for folder in sys.path)},
            )
        finally:
            os.close(memory)
        bench = file.model_dump(mode="json", by_alias=True)  # by the keys of a bench file
        names = [device.name for device in devices]
        orders = {"process": os.getpid(), "bench": bench, "devices": names, "latch": asdict(latch)}
        self._send(json.dumps(orders))

    def _send(self, line: str) -> None:
        """Send one line to the process."""
        pipe = self._process.stdin
        assert pipe is not None
        with suppress(BrokenPipeError):  # the process has ended, which `wait_until_ready` and `fault` report
            pipe.write(line.encode() + b"\n")
            pipe.flush()

    def wait_until_ready(self) -> None:
        """Wait until the run is watched; no device may be touched before.

        Raises
        ------
        LeactlError : the watchdog did not start.
        """
        answers = self._process.stdout
        assert answers is not None
        readable = select.select([answers], [], [], READY_TIMEOUT_S)[0]
        answer = (
            answers.readline().decode(errors="replace").strip()
            if readable
            else f"no answer within {READY_TIMEOUT_S:g} s"
        )
        if answer != "ready":
            raise LeactlError(f"the run's watchdog did not start: {answer or 'it ended without a word'}")

    def tell_recording(self, path: Path) -> None:
        """Pass on the path of the recording, for the latch."""
        self._send(f"run {path.absolute()}")

    def begin(self, period: float) -> None:
        """Begin to watch the loop, with cycles of `period` [s].

        The allowed silence is no shorter than the shortest consumer time of a drive. After it that drive has stopped by
        itself, so that no run is ended that could have continued.
        """
        self._period = period
        self.allowed_s = max(self._silence_s, LEAST_SILENT_CYCLES * period)
        self._allow(round(1e9 * self.allowed_s))

    def allow_end(self) -> None:
        """Allow the longer silence in which the devices are made safe after the loop."""
        self._allow(self._end_ns)

    def _allow(self, silence_ns: int) -> None:
        """Count a cycle, allow this silence [ns] unless the watchdog has acted, and rearm the timer."""
        self.sign[CYCLES] += 1
        if not self.sign[FIRED_NS]:
            self.sign[ALLOWED_NS] = silence_ns
        self._rearm()

    def _rearm(self) -> None:
        """Rearm the timer that ends this process if a driver's call hangs after the watchdog has died.

        A thread of C counts the time. When it runs out, that thread ends the process without the interpreter. The bench
        is not latched then; the next start finds a lost run, and latches it.
        """
        self._rearmed_at = time.monotonic()
        timeout_s = 1e-9 * self._end_ns + LAST_RESORT_S + REARMED_WITHIN_CYCLES * self._period
        with suppress(RuntimeError, MemoryError):  # no memory for a thread now: rearmed at the next call of `fault`
            faulthandler.dump_traceback_later(timeout_s, exit=True, file=self._null_file)

    def dismiss(self) -> None:
        """End the process in order and wait for its end; harmless if it has ended."""
        self._send_last("done")

    def take_over(self, doubt: str) -> None:
        """Have the process make the devices safe and latch the bench, and wait for its end."""
        self._send_last("unsafe " + " ".join(doubt.split()))

    def _send_last(self, line: str) -> None:
        """Send a last line, wait for the end of the process, and kill it if it does not end in time."""
        faulthandler.cancel_dump_traceback_later()
        process = self._process
        if process.stdin is not None and not process.stdin.closed:
            self._send(line)
            with suppress(BrokenPipeError):
                process.stdin.close()
        try:
            process.wait(1e-9 * self._end_ns)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()
        self._null_file.close()

    def fault(self) -> str:
        """Return why the run is no longer watched, or an empty string while it is; rearm the timer if that is due."""
        if time.monotonic() - self._rearmed_at > REARM_EVERY_S:
            self._rearm()
        status = self._process.poll()
        return "" if status is None else f"the run's watchdog has ended, status {status}"

    def verdict(self) -> str:
        """Return why the watchdog stopped the run; empty if it did not."""
        silence = self.sign[FIRED_NS]
        return standstill_text(os.getpid(), silence, self.sign[ALLOWED_NS]) if silence else ""


@contextmanager
def started_watchdog(
    file: BenchFile, devices: Sequence[CheckedDevice], locks: Sequence[int], latch: Latch
) -> Iterator[Watchdog]:
    """Start the watchdog of a run; it watches until the block is left.

    Parameters
    ----------
    devices : devices that another process can reach; none of a bench that is emulated in this process.
    locks : descriptors that hold the bench's locks.
    latch : latch that the watchdog sets after ending a run.

    Raises
    ------
    LeactlError : the watchdog did not start.
    """
    watchdog = Watchdog(file, devices, locks, latch)
    try:
        watchdog.wait_until_ready()
        yield watchdog
    finally:
        watchdog.dismiss()
