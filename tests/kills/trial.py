"""One trial: a run at speed with current in both drives, struck at a random moment, and what became of everything."""

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import h5py
import yaml

from leactl.bench import benchfile
from leactl.runfile.read.reader import Run
from leactl.runfile.summary import RECORDING
from leactl.runfile.verify.integrity import recover, verify
from tests.cli.terminal import COMMAND
from tests.driver.transports import ROOT, can_place
from tests.kills import stuck
from tests.kills.strikes import STRIKES, End, Struck, expected

BENCH = "killed"
START_S, STOP_S, END_S = 60.0, 15.0, 40.0
MARGIN_S = 0.020
GOES_ON_S = 0.5
IN_ORDER = (0, 4, 5)  # exit statuses of runs that have confirmed every device
PROTOCOL = """
name: struck
setup: coupled
rate_Hz: 100
steps:
  - mode: {test: current, load: velocity}
  - ramp: {role: load, to_velocity_rad_s: 10, rate_rad_s2: 40}
  - ramp: {role: test, to_current_A: 4, rate_A_s: 40}
  - hold: {role: test, current_A: 4, duration_s: 120}
"""


class ServedBench:
    """The bench's process and the files that lead to it."""

    def __init__(self, directory: Path, bus: str, consumer_ms: int, *changes: str) -> None:
        self.directory, self.consumer_s = directory, consumer_ms * 1e-3
        self.trigger = directory / "stuck"
        bench = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
        bench["name"] = BENCH
        on_pty = {"interface": "pty", "options": {"sleep_after_open": 0.0}}
        place = on_pty if bus == "pty" else can_place("udp_multicast")
        bench["buses"] = {"can0": bench["buses"]["can0"] | place}
        del bench["devices"]["torque_sensor"], bench["interlocks"]["torque"], bench["interlocks"]["torque_disagreement"]
        for role in ("test", "load"):
            bench["devices"][f"drive_{role}"]["settings"] |= {
                "consumer_heartbeat_ms": consumer_ms,
                "sdo_timeout_s": 1.0,
            }
        bench["devices"]["stuck"] = {"driver": "stuck", "role": "bench", "settings": {"trigger": str(self.trigger)}}
        bench["limits"] |= {"age_s": 30, "cyclic_age_s": 30}  # a busy machine is not what is tried here
        (directory / "bench.yaml").write_text(yaml.safe_dump(bench))
        (directory / "struck.yaml").write_text(PROTOCOL)
        stuck.register(directory)
        self.environment = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(directory), str(ROOT), *filter(None, sys.path)])
        }
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.kills.served", "bench.yaml", *changes],
            cwd=directory,
            env=self.environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        where = self._process.stdout.readline()
        assert where, "the bench's process did not start"
        self.options = [f"--bus=can0=slcan:{json.loads(where).split()[-1]}"] if bus == "pty" else []
        self._lines: queue.Queue[dict] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()
        self.last: dict[str, dict] = {}

    def _read(self) -> None:
        for line in self._process.stdout:
            self._lines.put(json.loads(line))

    def wait(self, flowing: bool, seconds: float) -> bool:
        """Wait until current flows in both drives, or in neither; whether it came to that."""
        until = time.monotonic() + seconds
        while any(self.last.get(role, {}).get("flowing", False) != flowing for role in ("test", "load")):
            assert self._process.poll() is None, "the bench's process has ended"
            with suppress(queue.Empty):
                line = self._lines.get(timeout=0.1)
                self.last[line["role"]] = line
            if time.monotonic() > until:
                return False
        return True

    def close(self) -> None:
        self._process.send_signal(signal.SIGINT)
        self._process.communicate()


def strike_once(served: ServedBench, number: int, names: Sequence[str], after_s: float) -> dict:
    """Start a run, strike it so long after current flows, and say what was found; `void` where there was no strike.

    Where none of the strikes ends a run, SIGINT does, half a second later.
    """
    place = served.directory / str(number)
    folder, state = place / "runs", place / "state"
    folder.mkdir(parents=True, exist_ok=True)
    os.environ["LEACTL_STATE"] = str(state)
    served.trigger.unlink(missing_ok=True)
    found: dict = {"number": number, "struck": list(names), "after_s": round(after_s, 4), "load": os.getloadavg()[0]}
    command = [*COMMAND, "run", str(served.directory / "struck.yaml"), "--bench", str(served.directory / "bench.yaml")]
    run = subprocess.Popen(
        [*command, "--served", *served.options, "--out", str(folder)],
        env=served.environment | {"LEACTL_STATE": str(state)},
        cwd=place,
        stdout=subprocess.PIPE,  # a file could be struck as the run's own is; what is said fits into the pipe
        stderr=subprocess.STDOUT,
        text=True,
    )
    dog = 0
    try:
        flowed = served.wait(True, START_S)
        since = time.monotonic()
        time.sleep(after_s)
        if not flowed or run.poll() is not None:
            run.kill()
            return found | {"void": run.communicate()[0].strip() or "no current flowed"}
        dog = watchdog_of(run.pid)
        struck = Struck(run.pid, dog, folder, state, served.trigger)
        for name in names:
            was_closed = is_closed(folder)
            with suppress(ProcessLookupError):  # another strike was quicker
                STRIKES[name].fall(struck)
        if expected(names) is End.NONE:
            time.sleep(GOES_ON_S)
            with suppress(ProcessLookupError):
                os.kill(run.pid, signal.SIGINT)
        held_s = time.monotonic() - since
        if not served.wait(False, STOP_S):
            return found | {"faults": ["current still flows"]}
        late = {role: end["at"] - end["heard"] for role, end in served.last.items()}
        found |= {"stop_s": {role: round(value, 5) for role, value in late.items()}}
        faults = [
            f"{role}: {value:.4f} s after the last heartbeat"
            for role, value in late.items()
            if value > served.consumer_s + MARGIN_S
        ]
        if expected(names) is End.UNTOLD and any("SIGSTOP" in name for name in names):  # it would stand for ever
            with suppress(ProcessLookupError):
                os.kill(run.pid, signal.SIGKILL)
        try:
            found["status_of_process"] = run.wait(END_S)
        except subprocess.TimeoutExpired:
            faults.append("the process did not end")
            run.kill()
        faults += gone(dog)
        (place / "said").write_text(run.stdout.read())  # its end comes once nothing is left that could say more
        if not (was_closed and names[-1] == "run's folder removed"):  # a finished run that somebody removes is gone
            faults += file_faults(place, found, held_s)
        faults += start_faults(served, struck, names, found.get("status_of_process"))
        return found | {"faults": faults + orphans(state) + mistakes(place)}
    finally:
        if run.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(dog or run.pid, signal.SIGKILL)  # a stopped watchdog would stay
            run.kill()
            run.wait()
        run.stdout.close()
        served.wait(False, STOP_S)


def start_faults(served: ServedBench, struck: Struck, names: Sequence[str], status: int | None) -> list[str]:
    """The next start is refused after every end that was out of order, whoever died, with a cause; a reset mends it."""
    bench, end = str(served.directory / "bench.yaml"), expected(names)
    environment = served.environment | {"LEACTL_STATE": str(struck.state)}
    again = [*COMMAND, "run", str(served.directory / "struck.yaml"), "--bench", bench, "--served", *served.options]

    def answer(*command: str) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            command,
            env=environment,
            cwd=struck.folder.parent,
            capture_output=True,
            text=True,
            timeout=END_S,
            check=False,
        )
        with (struck.folder.parent / "stderr").open("a") as told:
            told.write(done.stderr)
        return done

    start = answer(*again, "--dry-run")
    of_latch = [name for name in names if name.startswith("latch ")]
    bent = bool(of_latch) and of_latch[-1] != "latch removed"
    orderly = status in IN_ORDER and end is not End.UNTOLD and not bent
    alone = len(names) == 1
    if orderly and (end in (End.IN_ORDER, End.NONE) or not alone):
        faults = [] if start.returncode == 0 or not alone else [f"the next start after an end in order: {start.stderr}"]
    else:
        said = ["ended without a word, and its watchdog too"] if end is End.UNTOLD else []
        said += ["is tripped since"] if end is not End.UNTOLD or not alone else []
        refused = start.returncode == 3 and any(words in start.stderr for words in said)
        faults = [] if refused else [f"the next start: {start.stderr}"]
    reset = answer(*COMMAND, "bench", "reset", bench, "--yes")
    start = answer(*again, "--dry-run")
    if start.returncode != 0:
        faults.append(f"after a reset ({reset.returncode}): {start.stderr}")
    return faults


def is_closed(folder: Path) -> bool:
    """Whether a run's file is finished; HDF5 opens none for reading alone that is still written."""
    for path in folder.glob("*.h5"):
        with suppress(OSError), h5py.File(path, "r") as file:
            return bool(file.attrs["status"] != RECORDING)
    return False


def orphans(state: Path) -> list[str]:
    """Processes that are left of a run and its watchdog, told by where they keep state."""
    mark = f"LEACTL_STATE={state}".encode()
    results = []
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if mark in (place / "environ").read_bytes().split(b"\0"):
                results.append(f"left behind: {(place / 'cmdline').read_bytes().replace(bytes(1), b' ').decode()}")
    return results


def mistakes(place: Path) -> list[str]:
    """What no command may say."""
    told = (place / "said").read_text()
    return [f"said: {word}" for word in ("internal error", "Traceback") if word in told]


def watchdog_of(process: int) -> int:
    """The only child of a run."""
    (child,) = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return int(child)


def gone(dog: int) -> list[str]:
    """Wait until the watchdog has done its work; one that was stopped together with the run goes now."""
    until = time.monotonic() + END_S
    while time.monotonic() < until:
        try:
            state = Path(f"/proc/{dog}/stat").read_text().rpartition(")")[2].split()[0]
        except FileNotFoundError:
            return []
        if state == "Z":  # nobody has waited for it: its parent is dead
            return []
        if state == "T":
            os.kill(dog, signal.SIGKILL)
        time.sleep(0.02)
    return ["the watchdog did not end"]


def file_faults(place: Path, found: dict, held_s: float) -> list[str]:
    """What is wrong with the run's file, which is to be readable up to its last flush."""
    files = list(place.rglob("*.h5"))
    if len(files) != 1:
        return [f"{len(files)} run files"]
    path, faults = files[0], []
    findings = verify(path)
    if findings:
        if not any("incomplete recording" in finding for finding in findings):
            faults += findings
        path = recover(path)
        faults += verify(path)
    with Run.open(path) as run:
        found["status"] = run.status
        enabled = run.channel("drive_enabled", role="test")
        on = enabled.time[enabled.values == 1.0]
        recorded_s = float(on[-1] - on[0]) if len(on) else 0.0  # struck before the first flush: nothing yet
        found["lost_s"] = round(held_s - recorded_s, 3)
    return faults
