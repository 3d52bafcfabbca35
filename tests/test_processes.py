"""Jobs in several processes: the order and the faults of one process, and no worker that outlives the first."""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from leactl.errors import InputError, LeactlError
from leactl.processes import Workers, each

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


def killed(signum):
    os.kill(os.getpid(), signum)


NAMES = [f"{'bad' if number % 7 == 3 else 'job'}-{number}" for number in range(20)]


@pytest.mark.parametrize("processes", [1, 2])
def test_results_keep_the_order_of_their_jobs_and_faults_their_lines(processes):
    with Workers(processes) as workers:
        found = list(workers.in_order(told_apart, [(name,) for name in NAMES]))
    assert [done.faults or done.value()[0] for done in found] == [
        [f"{name}: first", f"{name}: second"] if name.startswith("bad") else name for name in NAMES
    ]
    here = {done.value()[1] == os.getpid() for done in found if not done.faults}
    assert here == {processes == 1}


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
