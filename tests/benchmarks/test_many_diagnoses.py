"""Two hundred diagnoses by one worker of a Dask scheduler and by two: the same answers, nearly twice as soon."""

import os
import shutil
import time

import pytest

from leactl.gap.blind.answers import answer_all
from leactl.joints.make import make
from leactl.scheduler import ScheduledWorkers
from tests.benchmarks.test_many_runs import LEAST_GAIN, MOST_LOAD
from tests.dask_cluster import dask_clusters

JUDGED = 200
DIAGNOSES = int(os.environ.get("DIAGNOSES", JUDGED))
DRAWN = 4  # cases; the others are copies


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    """Cases of two drawn machines."""
    drawn, folder = tmp_path_factory.mktemp("drawn"), tmp_path_factory.mktemp("cases")
    make(DRAWN, drawn / "cases", drawn / "key", 2, "stepped", 3, ["single"], lambda step: None)
    names = sorted(path.parent for path in (drawn / "cases").glob("*/nominal.yaml"))
    for number in range(DIAGNOSES):
        shutil.copytree(names[number % DRAWN], folder / f"case-{number:03}")
    return folder


@pytest.mark.long
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core")
def test_two_workers_diagnose_two_hundred_cases_sooner(tmp_path, figure, request):
    pytest.importorskip("distributed", reason="Dask is not installed")
    busy = os.getloadavg()[0]
    if busy > MOST_LOAD and DIAGNOSES == JUDGED:
        pytest.skip(f"a load of {busy:.1f}; two workers are judged below {MOST_LOAD}")
    cases = request.getfixturevalue("cases")
    seconds, answers = [], []
    for count in (1, 2):
        with dask_clusters() as cluster, ScheduledWorkers(cluster(count)[0]) as workers:
            began = time.monotonic()
            names = answer_all(cases, tmp_path / str(count), workers, lambda step: None)
            seconds.append(time.monotonic() - began)
        answers.append([(tmp_path / str(count) / f"{name}.json").read_bytes() for name in names])
    one, two = seconds
    figure(f"{DIAGNOSES} diagnoses by one worker: {one:.0f} s, by two: {two:.0f} s, {one / two:.2f} times as fast")
    figure(
        f"beside a load of {busy:.1f} on {os.cpu_count()} cores; at least {LEAST_GAIN} for {JUDGED} where they are free"
    )
    assert answers[0] == answers[1]
    if DIAGNOSES < JUDGED:
        pytest.skip(f"{DIAGNOSES} diagnoses; {JUDGED} are judged")
    assert one / two >= LEAST_GAIN
