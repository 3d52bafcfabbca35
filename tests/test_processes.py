"""Jobs in several processes: the order and the faults of one process, and no worker that outlives the first."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from threading import RLock

import pytest

from leactl.errors import InputError, LeactlError
from leactl.processes import JOBS_AHEAD, Workers, each

FIRST_ENDS = """
import sys, time
from tests.test_processes import told_apart
from leactl.processes import Workers

if __name__ == "__main__":
    with Workers(2) as workers:
        for done in workers.in_order(told_apart, [("one",), ("two",)]):
            print(done.result[1], flush=True)
        time.sleep(600)
"""


def told_apart(name):
    if name.startswith("bad"):
        raise InputError([f"{name}: first", f"{name}: second"])
    return name, os.getpid()


class Counted:
    """A result that counts how many of its kind are there."""

    alive = most = 0
    lock = RLock()

    def __init__(self, number):
        self.number = number
        with Counted.lock:
            Counted.alive += 1
            Counted.most = max(Counted.most, Counted.alive)

    def __del__(self):
        with Counted.lock:
            Counted.alive -= 1

    def __reduce__(self):
        return Counted, (self.number,)


def killed(signum):
    os.kill(os.getpid(), signum)


NAMES = [f"{'bad' if number % 7 == 3 else 'job'}-{number}" for number in range(20)]


@pytest.mark.parametrize("processes", [1, 2])
def test_results_keep_the_order_of_their_jobs_and_faults_their_lines(processes):
    with Workers(processes) as workers:
        results = list(workers.in_order(told_apart, [(name,) for name in NAMES]))
    assert [done.faults or done.value()[0] for done in results] == [
        [f"{name}: first", f"{name}: second"] if name.startswith("bad") else name for name in NAMES
    ]
    here = {done.value()[1] == os.getpid() for done in results if not done.faults}
    assert here == {processes == 1}


@pytest.mark.parametrize("order", ["in_order", "as_done"])
def test_as_many_results_are_kept_for_many_jobs_as_for_few(order):
    Counted.most = 0
    numbers = []
    with Workers(2) as workers:
        for done in getattr(workers, order)(Counted, [(number,) for number in range(20 * JOBS_AHEAD)]):
            numbers.append(done.value().number)
            if len(numbers) == 1:
                time.sleep(1)  # in which the workers do what they have been handed
    assert (
        numbers == list(range(20 * JOBS_AHEAD)) if order == "in_order" else set(numbers) == set(range(20 * JOBS_AHEAD))
    )
    assert JOBS_AHEAD < Counted.most <= 2 * JOBS_AHEAD + 2  # the last one asked for, and one on its way


def test_faults_of_all_jobs_come_at_the_end_in_whole_lines():
    told = []
    with pytest.raises(InputError) as refused, Workers(2) as workers:
        each(told_apart, [("job",), ("bad-1",), ("bad-2",)], workers, "done", told.append)
    assert sorted(refused.value.faults) == ["bad-1: first", "bad-1: second", "bad-2: first", "bad-2: second"]
    assert len(told) == 3


def test_a_worker_that_is_ended_from_outside_is_told_in_one_line():
    with pytest.raises(LeactlError, match="ended from outside") as told, Workers(2) as workers:
        list(workers.in_order(killed, [(signal.SIGKILL,)] * 2))
    assert "\n" not in str(told.value)


def test_no_worker_outlives_a_first_process_that_is_killed(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(FIRST_ENDS)
    with subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | {"PYTHONPATH": str(Path.cwd())},
        start_new_session=True,
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline().strip().isdigit()
            process.kill()
            # a worker that lives holds the other end of the pipe, and the read would not come to an end
            process.communicate(timeout=30)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
