"""A process beside the run that stops the bench where the control loop no longer can: it hangs, or it was killed.

The drives' own dead-man comes first and needs nothing of this machine. The loop counts its cycles in memory that both
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

CYCLES, ALLOWED_NS, FIRED_NS = range(3)  # words of the shared memory; an allowed silence of 0 is not watched
WORDS = 3
CYCLES_ALLOWED = 3  # at the least: a slow loop is no hung one
READY_S = 20.0  # 0.35 s on an idle machine, most of it imports
GRACE_S = 2.0  # of an orderly end, beside what the devices may take
REARM_EVERY_S = 0.5  # the timer that ends a run which nobody watches any more
REARMED_WITHIN_CYCLES = 100  # at the latest; the loop looks at its watchdog far more often
LAST_RESORT_S = 15.0  # that the timer leaves a living watchdog to act first, beyond the time of an orderly end


def hung(process: int, silence_ns: int, allowed_ns: int) -> str:
    """What is said of a loop that stands still."""
    return (
        f"the control loop of process {process} stood still for {silence_ns * 1e-9:.3f} s;"
        f" {allowed_ns * 1e-9:g} s are allowed"
    )


def time_to_end_s(devices: int) -> float:
    """How long an orderly end may take until every device has confirmed [s]."""
    return GRACE_S + devices * SAFE_STATE_S


class Unwatched:
    """No process beside the run: drives that are emulated in it, on its own time, stop when it does."""

    allowed_s = math.inf  # silence of the loop

    def __init__(self) -> None:
        self.sign: memoryview[int] | list[int] = [0] * WORDS

    def recording(self, path: Path) -> None:
        """Tell where the run is recorded, for the latch."""

    def begin(self, period: float) -> None:
        """The loop begins: from here on its silence counts."""

    def ending(self) -> None:
        """The loop is over and the devices are being made safe, which takes longer than a cycle."""

    def dismiss(self) -> None:
        """The devices are safe: nothing is left to be watched."""

    def take_over(self, doubt: str) -> None:
        """The run could not confirm that its devices are safe: make them so over other connections, and latch."""

    def fault(self) -> str:
        """Why the run is no longer watched; empty while it is."""
        return ""

    def verdict(self) -> str:
        """Why the run was stopped by its watchdog; empty where it was not."""
        return ""


class Watchdog(Unwatched):
    """The parent's side of the process `leactl.runner.watchdog_process`."""

    def __init__(self, file: BenchFile, devices: Sequence[CheckedDevice], kept: Sequence[int], latch: Latch) -> None:
        self._silence_s = min(
            (silence for silence in host_silences(devices).values() if silence is not None), default=SAFE_STATE_S
        )
        self._end_ns = round(1e9 * time_to_end_s(len(devices)))
        self._period, self._rearmed_at = 0.0, 0.0
        self._nowhere = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 (closed with the process's pipes)
        memory = os.memfd_create("leactl-watchdog")
        try:
            os.ftruncate(memory, 8 * WORDS)
            self.sign = memoryview(mmap.mmap(memory, 8 * WORDS)).cast("q")
            command = [sys.executable, "-P", "-m", "leactl.runner.watchdog_process", str(memory)]
            # a session of its own, so that Ctrl-C and a closed terminal reach the run alone; the locks that it keeps
            # hold the bench until it has done its work
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                pass_fds=(memory, *kept),
                start_new_session=True,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(place or str(Path.cwd()) for place in sys.path)},
            )
        finally:
            os.close(memory)
        bench = file.model_dump(mode="json", by_alias=True)  # keys as a person writes them
        names = [device.name for device in devices]
        orders = {"process": os.getpid(), "bench": bench, "devices": names, "latch": asdict(latch)}
        self._tell(json.dumps(orders))

    def _tell(self, line: str) -> None:
        pipe = self._process.stdin
        assert pipe is not None
        with suppress(BrokenPipeError):  # it has ended, which `wait_until_ready` and `fault` tell
            pipe.write(line.encode() + b"\n")
            pipe.flush()

    def wait_until_ready(self) -> None:
        """Return once the run is watched; before that no device may be touched.

        Raises
        ------
        LeactlError : the watchdog did not start.
        """
        answers = self._process.stdout
        assert answers is not None
        came = select.select([answers], [], [], READY_S)[0]
        said = answers.readline().decode(errors="replace").strip() if came else f"no answer within {READY_S:g} s"
        if said != "ready":
            raise LeactlError(f"the run's watchdog did not start: {said or 'it ended without a word'}")

    def recording(self, path: Path) -> None:
        """Tell where the run is recorded, for the latch."""
        self._tell(f"run {path.absolute()}")

    def begin(self, period: float) -> None:
        """The loop begins: from here on its silence counts.

        Once the shortest consumer time is over since the last cycle, a drive has stopped by itself: no run is ended
        that could have gone on.
        """
        self._period = period
        self.allowed_s = max(self._silence_s, CYCLES_ALLOWED * period)
        self._allow(round(1e9 * self.allowed_s))

    def ending(self) -> None:
        """The loop is over and the devices are being made safe, which takes longer than a cycle."""
        self._allow(self._end_ns)

    def _allow(self, silence_ns: int) -> None:
        self.sign[CYCLES] += 1
        if not self.sign[FIRED_NS]:
            self.sign[ALLOWED_NS] = silence_ns
        self._rearm()

    def _rearm(self) -> None:
        """Rearm the timer that ends this process if a driver's call hangs after the watchdog has died.

        A thread of C counts the time. When it runs out, that thread ends the process without the interpreter. Nobody
        latches the bench then; the next start finds a run that ended without a word, and does.
        """
        self._rearmed_at = time.monotonic()
        last_s = 1e-9 * self._end_ns + LAST_RESORT_S + REARMED_WITHIN_CYCLES * self._period
        with suppress(RuntimeError, MemoryError):  # no memory for a thread now: rearmed at the next look
            faulthandler.dump_traceback_later(last_s, exit=True, file=self._nowhere)

    def dismiss(self) -> None:
        """Let the process go and wait for its end; harmless when it has gone."""
        self._part("done")

    def take_over(self, doubt: str) -> None:
        """Have the process make the devices safe and latch the bench, and wait for its end."""
        self._part("unsafe " + " ".join(doubt.split()))

    def _part(self, word: str) -> None:
        faulthandler.cancel_dump_traceback_later()
        process = self._process
        if process.stdin is not None and not process.stdin.closed:
            self._tell(word)
            with suppress(BrokenPipeError):
                process.stdin.close()
        try:
            process.wait(1e-9 * self._end_ns)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()
        self._nowhere.close()

    def fault(self) -> str:
        """Why the run is no longer watched, empty while it is; rearms the timer of the last resort."""
        if time.monotonic() - self._rearmed_at > REARM_EVERY_S:
            self._rearm()
        status = self._process.poll()
        return "" if status is None else f"the run's watchdog has ended, status {status}"

    def verdict(self) -> str:
        """Why the run was stopped by its watchdog; empty where it was not."""
        silence = self.sign[FIRED_NS]
        return hung(os.getpid(), silence, self.sign[ALLOWED_NS]) if silence else ""


@contextmanager
def beside(file: BenchFile, devices: Sequence[CheckedDevice], kept: Sequence[int], latch: Latch) -> Iterator[Watchdog]:
    """Have a run watched until the block is left.

    Parameters
    ----------
    devices : those that another process can reach; none of a bench that is emulated in this one.
    kept : descriptors that hold the bench's locks.
    latch : what it sets once it has ended a run.

    Raises
    ------
    LeactlError : the watchdog did not start.
    """
    watchdog = Watchdog(file, devices, kept, latch)
    try:
        watchdog.wait_until_ready()
        yield watchdog
    finally:
        watchdog.dismiss()
