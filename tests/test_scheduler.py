"""Jobs by a Dask scheduler and two workers, all of them processes: the same answers, also where a worker is lost."""

import os
import signal
import subprocess
import sys

import pytest

from leactl import __version__, run_protocol
from leactl.errors import InputError, LeactlError
from leactl.processes import JOBS_AHEAD, Workers
from leactl.scheduler import ScheduledWorkers
from tests.cli.terminal import COMMAND, leactl
from tests.dask_cluster import dask_clusters
from tests.test_processes import NAMES, told_apart

pytestmark = pytest.mark.long  # half a minute


@pytest.fixture
def cluster():
    with dask_clusters() as make:
        yield make


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LEACTL_STATE", str(folder / "state"))
        for seed in range(1, 7):
            settings = {"trials": 1, "hold_s": 2, "settle_s": 1, "seed": seed}
            run_protocol("friction", settings=settings, condition="design", out=folder / "runs")
    return folder / "runs"


def ends_its_worker_once(name, folder):
    try:
        (folder / "ended").touch(exist_ok=False)
    except FileExistsError:
        return name
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def ends_its_worker(name):
    os.kill(os.getpid(), signal.SIGKILL)


def test_results_keep_their_order_and_a_lost_worker_costs_none(cluster, tmp_path):
    address, processes = cluster(2)
    with ScheduledWorkers(address) as workers:
        results = list(workers.in_order(told_apart, [(name,) for name in NAMES]))
        lost = list(workers.in_order(ends_its_worker_once, [(name, tmp_path) for name in NAMES]))
        done = list(workers.as_done(ends_its_worker_once, [(name, tmp_path) for name in NAMES]))
    with Workers() as workers:
        here = list(workers.in_order(told_apart, [(name,) for name in NAMES]))
    assert [result.faults for result in results] == [item.faults for item in here]
    assert [result.value()[0] for result in results if not result.faults] == [
        item.value()[0] for item in here if not item.faults
    ]
    assert [item.value() for item in lost] == NAMES
    assert sorted(item.value() for item in done) == sorted(NAMES)
    assert sorted(process.poll() is None for process in processes) == [False, True]


def test_as_many_jobs_are_with_the_scheduler_for_many_as_for_few(cluster):
    address, _ = cluster(2)
    names = [f"job-{number}" for number in range(10 * JOBS_AHEAD)]
    with ScheduledWorkers(address) as workers:
        for order in (workers.in_order, workers.as_done):
            there = []
            for done in order(told_apart, [(name,) for name in names]):
                there.append((len(workers._client.futures), done.value()[0]))
            assert max(count for count, _ in there) <= 2 * JOBS_AHEAD + 1
            assert sorted(name for _, name in there) == sorted(names)


def test_commands_answer_alike_while_a_worker_is_lost(cluster, runs, monkeypatch):
    address, (first, _) = cluster(2)
    monkeypatch.chdir(runs.parent)  # paths are those of the command's folder
    trend = "runs", "trend", "coulomb_friction", runs.name, "--set", "torque_constant=0.49", "--json"
    for words in (("runs", "verify", runs.name), ("analyze", runs.name, "--set", "torque_constant=0.49", "--json")):
        alone, there = leactl(*words), leactl(*words, "--scheduler", address)
        assert (there.returncode, there.stdout) == (0, alone.stdout)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([*COMMAND, *trend, "--scheduler", address], **pipes) as process:
        process.stderr.readline()  # the first run is waited for
        first.kill()
        answer, _ = process.communicate(timeout=120)
    assert (process.returncode, answer) == (0, leactl(*trend).stdout)


def test_what_cannot_do_the_work_is_told_in_one_line(cluster, runs):
    verify = "runs", "verify", runs
    done = leactl(*verify, "--scheduler", "tcp://127.0.0.1:9")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "--scheduler tcp://127.0.0.1:9: cannot be reached: " in done.stderr
    for address in ("nonsense://x:1", "localhost", "tcp://:5", "tcp://a b:5", "tcp://localhost"):
        done = leactl(*verify, "--scheduler", address)
        assert done.stderr.endswith(f"--scheduler {address}: an address such as tcp://192.168.0.5:8786 was expected\n")
    done = leactl(*verify, "--scheduler", "tcp://127.0.0.1:9", "--processes", 2)
    assert done.stderr.endswith("give one of both\n")
    address, _ = cluster(0)
    assert "has no worker; dask worker" in leactl(*verify, "--scheduler", address).stderr
    address, _ = cluster(1, "--nthreads", "2")
    done = leactl(*verify, "--scheduler", address)
    assert (done.returncode, done.stdout) == (2, "")
    assert "2 threads; --nthreads 1 was expected" in done.stderr


@pytest.mark.parametrize(
    ("preload", "told"),
    [
        ("import leactl; leactl.__version__ = '9.9'", f"has leactl 9.9; {__version__}, as here, was expected"),
        ("import platform; platform.python_version_tuple = lambda: ('3', '9', '1')", "has Python 3.9; "),
        ("import sys; sys.modules['leactl.scheduler'] = None", "cannot do the work: "),
    ],
)
def test_a_worker_of_another_version_is_told_in_one_line(cluster, runs, tmp_path, preload, told):
    script = tmp_path / "preload.py"
    script.write_text(preload)
    address, _ = cluster(1, "--nthreads", "1", "--preload", str(script))
    done = leactl("runs", "verify", runs, "--scheduler", address)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert told in done.stderr


def test_a_worker_has_one_thread_of_matrix_products(cluster):
    address, _ = cluster(1, environment={"OPENBLAS_NUM_THREADS": ""})
    with ScheduledWorkers(address) as workers:
        (done,) = workers.in_order(os.environ.get, [("OPENBLAS_NUM_THREADS",)])
    assert done.value() == "1"


def test_a_job_that_ends_every_worker_is_told(cluster):
    address, _ = cluster(4)
    with pytest.raises(LeactlError, match="has ended one worker after the other"), ScheduledWorkers(address) as workers:
        list(workers.in_order(ends_its_worker, [("job",)]))


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'leactl\[dask\]'"), ScheduledWorkers("tcp://127.0.0.1:9"):
        pass
