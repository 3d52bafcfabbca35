"""One trial: a run at speed with current in both drives, struck at a random moment, and what became of everything."""

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import yaml

from leactl.bench import benchfile
from leactl.errors import SafetyTrip
from leactl.runfile.integrity import recover, verify
from leactl.runfile.reader import Run
from leactl.runner import latch, underway
from tests.cli.terminal import COMMAND
from tests.driver.transports import ROOT, can_place
from tests.kills import stuck

BENCH = "killed"
START_S, STOP_S, END_S = 60.0, 15.0, 40.0
MARGIN_S = 0.020
# what is struck: the run's process, or together with it its watchdog, so that nothing is left but the drives' dead-man
WAYS = {
    "kill -9": True,
    "kill -9, watchdog too": False,
    "SIGSTOP": True,
    "SIGSTOP, watchdog too": False,
    "driver call sleeping": True,
    "driver call spinning": True,
    "driver call holding the GIL": True,
}
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


def strike_once(served: ServedBench, number: int, way: str, after_s: float) -> dict:
    """Start a run, strike it so long after current flows, and say what was found; `void` where there was no strike."""
    place = served.directory / str(number)
    place.mkdir(exist_ok=True)
    os.environ["LEACTL_STATE"] = str(place / "state")
    served.trigger.unlink(missing_ok=True)
    found: dict = {"number": number, "way": way, "after_s": round(after_s, 4), "load": os.getloadavg()[0]}
    command = [*COMMAND, "run", str(served.directory / "struck.yaml"), "--bench", str(served.directory / "bench.yaml")]
    with (place / "stderr").open("w") as stderr:
        run = subprocess.Popen(
            [*command, "--served", *served.options, "--out", str(place)],
            env=served.environment | {"LEACTL_STATE": str(place / "state")},
            stdout=stderr,
            stderr=stderr,
        )
    dog = 0
    try:
        flowed = served.wait(True, START_S)
        since = time.monotonic()
        time.sleep(after_s)
        if not flowed or run.poll() is not None:
            return found | {"void": (place / "stderr").read_text().strip() or "no current flowed"}
        dog = watchdog_of(run.pid)
        strike(served, way, run.pid, dog)
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
        if not WAYS[way]:
            os.kill(run.pid, signal.SIGKILL)
        try:
            run.wait(END_S)
        except subprocess.TimeoutExpired:
            faults.append("the process did not end")
        faults += gone(dog) + file_faults(place, found, held_s) + latch_faults(way)
        return found | {"faults": faults + next_start_faults(served, place, way)}
    finally:
        if run.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(dog or run.pid, signal.SIGKILL)  # a stopped watchdog would stay
            run.kill()
            run.wait()
        served.wait(False, STOP_S)


def next_start_faults(served: ServedBench, place: Path, way: str) -> list[str]:
    """The next start is refused, whoever died, and told of the lost run once."""
    bench = str(served.directory / "bench.yaml")
    command = [*COMMAND, "run", str(served.directory / "struck.yaml"), "--bench", bench, "--served", *served.options]
    environment = served.environment | {"LEACTL_STATE": str(place / "state")}
    again = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=END_S, check=False)
    expected = "is tripped since" if WAYS[way] else "ended without a word, and its watchdog too"
    faults = [] if again.returncode == 3 and expected in again.stderr else [f"the next start: {again.stderr}"]
    return faults + [f"left behind: {cause}" for cause, _ in underway.lost(BENCH)]


def strike(served: ServedBench, way: str, process: int, dog: int) -> None:
    what, _, both = way.partition(", ")
    if what.startswith("driver call "):
        served.trigger.write_text(what.removeprefix("driver call "))
        return
    number = signal.SIGKILL if what == "kill -9" else signal.SIGSTOP
    for target in (dog, process) if both else (process,):
        os.kill(target, number)


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
    files = list(place.glob("*.h5"))
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


def latch_faults(way: str) -> list[str]:
    """A bench whose run was stopped by its watchdog refuses the next start with the cause."""
    try:
        for held in latch.tripped(BENCH):  # by its name: its file has a driver that only the struck process knows
            held.refuse()
    except SafetyTrip as refused:
        expected = "ended without making the bench safe" if way.startswith("kill") else "stood still for"
        return [] if WAYS[way] and expected in str(refused) else [f"the next start is refused: {refused}"]
    return ["the next start is not refused"] if WAYS[way] else []
