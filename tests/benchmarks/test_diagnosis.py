"""A whole diagnosis of ten runs: time and memory against fixed limits, and how time grows with samples."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leactl.gap.diagnose import Case, diagnose, hold_out_runs
from leactl.gap.signals.record import read_record
from leactl.model.nominal import read_model

SECONDS, GIGABYTES = 10.0, 1.5
LINEAR = 1.15  # times as long as in proportion to its samples, that a larger case may take


@pytest.fixture
def practice():
    sets = [parent.parent / "shared" / "gap-cases" / "practice" for parent in Path(__file__).resolve().parents]
    result = next((folder / "practice-2" for folder in sets if folder.is_dir()), None)
    if result is None:
        pytest.skip("the practice cases (../shared/gap-cases) are not on this machine")
    return result


def test_a_case_is_diagnosed_within_seconds(practice, tmp_path, figure):
    runs = sorted(practice.glob("*.h5"))
    leactl = Path(sys.executable).with_name("leactl")
    command = [leactl, "gap", "diagnose", *runs, "--model", practice / "nominal.yaml", "--json", tmp_path / "a.json"]
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode, took, memory = (
        os.waitstatus_to_exitcode(status),
        time.perf_counter() - began,
        usage.ru_maxrss / 1e6,
    )
    assert process.returncode == 0
    figure(
        f"diagnosis of {len(runs)} runs: {took:.1f} s and {memory:.2f} GB; limits {SECONDS:.0f} s and {GIGABYTES} GB"
    )
    assert took < SECONDS
    assert memory < GIGABYTES


def test_time_grows_no_faster_than_samples(practice, figure):
    model = read_model(practice / "nominal.yaml")[0]
    records = [read_record(path) for path in sorted(practice.glob("*.h5"))]
    took = {}
    for times in (1, 4, 16):
        fitted, held_out = hold_out_runs([scaled(record, times) for record in records])
        began = time.perf_counter()
        diagnose(Case(model, fitted, held_out))
        samples = sum(
            len(clock.time) * len(clock.values) for r in (*fitted, *held_out) for clock in (r.fast, r.slow) if clock
        )
        took[times] = (time.perf_counter() - began, samples)
    parts = ", ".join(f"{samples / 1e6:.2f} million {seconds:.1f} s" for seconds, samples in took.values())
    figure(f"diagnosis by samples, 1, 4 and 16 times: {parts}")
    for less, more in ((1, 4), (4, 16)):
        assert took[more][0] / took[less][0] <= LINEAR * took[more][1] / took[less][1]


def scaled(record, times):
    """The first quarter of a run, or as many whole runs one after the other as make so many quarters."""
    return replace(record, fast=longer(record.fast, times), slow=longer(record.slow, times))


def longer(clock, times):
    if clock is None:
        return None
    count = len(clock.time) // 4 * times
    index = np.arange(count) % len(clock.time)
    values = {key: channel[index] for key, channel in clock.values.items()}
    valid = {key: mask[index] for key, mask in clock.valid.items()}
    return replace(clock, time=clock.time[0] + clock.interval * np.arange(count), values=values, valid=valid)
