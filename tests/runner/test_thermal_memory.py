"""What is remembered of windings between runs: cooling, crashes, files that cannot be trusted, a disk that fails."""

import json
import math
import os
import signal
import subprocess
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest
import yaml

from leactl.bench import benchfile
from leactl.errors import InputError
from leactl.model.motor import load_motor
from leactl.runner import state, thermal_memory
from leactl.runner.thermal_memory import OVERDUE_S, Keeper, Memory
from leactl.runner.windings import Windings
from tests.cli.terminal import COMMAND, leactl, live_run, start

LEA = load_motor("lea")[0]
NOW = 1.8e9  # s since 1970
WARM = np.array([90.0, 80.0, 50.0])


def memory(actuator="a1", motor=LEA, limit=130.0, ambient=25.0):
    return Memory(actuator, motor, limit, ambient, state.of_user())


def test_what_was_kept_is_recalled():
    memory().keep(WARM, NOW, running=False)
    found = memory().recall(NOW)
    assert found.nodes == pytest.approx(WARM, abs=0.1)
    assert found.known.startswith("at rest since 2027-01-15T08:00:00")


def test_windings_cool_while_nothing_runs_the_housing_slowly():
    memory().keep(WARM, NOW, running=False)
    nodes = [memory().recall(NOW + seconds).nodes for seconds in (0, 60, 600, 3600, 7 * 86400)]
    assert all(later[0] < earlier[0] for earlier, later in pairwise(nodes))
    assert nodes[1][0] < 65.0
    assert nodes[1][2] > 40.0
    assert nodes[-1] == pytest.approx(28.0, abs=0.1)


def test_a_run_that_died_left_its_winding_at_the_limit_and_its_housing_warmer():
    memory().keep(WARM, NOW, running=True)
    found = memory().recall(NOW)
    assert found.nodes[:2] == pytest.approx(130.0, abs=0.1)
    assert 52.0 < found.nodes[2] < 70.0
    assert found.known.startswith("its last run ended without a word after 2027-")
    # nothing is known of the time until a writing was overdue
    assert memory().recall(NOW + OVERDUE_S).nodes == pytest.approx(found.nodes)
    assert memory().recall(NOW + 600.0).nodes[0] < 80.0
    assert memory().recall(NOW + 2 * 86400.0).nodes == pytest.approx(28.0, abs=0.1)


BODY = {"nodes_degC": [40.0, 40.0, 35.0], "time": NOW, "running": False}
FAULTS = {
    "damaged": (lambda text: text.replace(":", ";"), "delimiter"),
    "cut short": (lambda text: text[: len(text.strip()) // 2], ""),
    "empty": (lambda text: "", "Expecting value"),
    "a list": (lambda text: "[1, 2]", ""),
    "no object": (lambda text: "null", ""),
    "nested": (lambda text: "[" * 100_000, ""),
    "format": ({"format": "leactl-run"}, "format leactl-run 1, leactl-thermal 1 was expected"),
    "version": ({"format_version": 2}, "format leactl-thermal 2, leactl-thermal 1 was expected"),
    "another actuator": ({"actuator": "b7"}, "it is of actuator 'b7'"),
    "another motor": ({"motor_sha256": "0" * 64, "motor": "ak80"}, "it is of another motor file ('ak80')"),
    "of the future": ({"time": NOW + 3600.0}, "it is of the future, 2027-"),
    "no time": ({"time": math.nan}, "it is of the future"),
    "an endless time": ({"time": 10**400}, "too large"),
    "a time in words": ({"time": "noon"}, "noon"),
    "kelvin": ({"nodes_degC": [298.0, 298.0, 298.0]}, "three temperatures in degC were expected"),
    "NaN": ({"nodes_degC": [math.nan, 30.0, 30.0]}, "three temperatures in degC were expected"),
    "endless": ({"nodes_degC": [math.inf, 30.0, 30.0]}, "three temperatures in degC were expected"),
    "negative": ({"nodes_degC": [-273.0, 30.0, 30.0]}, "three temperatures in degC were expected"),
    "two nodes": ({"nodes_degC": [30.0, 30.0]}, "three temperatures in degC were expected"),
    "one number": ({"nodes_degC": 30.0}, ""),
    "nulls": ({"nodes_degC": [None, None, None]}, ""),
    "running in words": ({"running": "no"}, "running: true or false was expected"),
    "key missing": ("running", "running"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_file_that_cannot_be_trusted_counts_as_hot(fault):
    change, reason = FAULTS[fault]
    kept = memory()
    kept.keep(np.array([40.0, 40.0, 35.0]), NOW, running=False)
    text = kept.path.read_text()
    if callable(change):
        kept.path.write_text(change(text))
    else:
        body = json.loads(text)
        body = body | change if isinstance(change, dict) else {key: body[key] for key in body if key != change}
        kept.path.write_text(json.dumps(body))
    found = kept.recall(NOW + 30.0)
    assert found.nodes.tolist() == [130.0] * 3
    assert found.known.startswith(f"counts as hot: {kept.path} cannot be used: ")
    assert reason in found.known
    assert "\n" not in found.known


def test_nothing_known_and_nothing_readable_count_as_hot(tmp_path):
    found = memory("never seen").recall(NOW)
    assert (found.nodes.tolist(), found.known) == ([130.0] * 3, "counts as hot: nothing is known of it")
    memory("folder").path.mkdir(parents=True)
    assert memory("folder").recall(NOW).nodes.tolist() == [130.0] * 3


def test_a_clock_that_is_a_little_behind_cools_nothing():
    memory().keep(WARM, NOW, running=False)
    assert memory().recall(NOW - 30.0).nodes == pytest.approx(WARM, abs=0.1)


def test_an_actuator_is_its_own_whatever_its_label():
    memory("a/1").keep(WARM, NOW, running=False)
    assert "it is of actuator 'a/1'" in memory("a_1").recall(NOW).known
    memory("../../x").keep(WARM, NOW, running=False)
    assert memory("../../x").path.parent == memory("a1").path.parent


def test_a_write_that_fails_leaves_the_old_file(monkeypatch):
    kept = memory()
    kept.keep(WARM, NOW, running=False)
    before = kept.path.read_text()
    monkeypatch.setattr(os, "pwrite", lambda *_call: 0)
    with pytest.raises(OSError, match="No space left"):
        kept.keep(np.full(3, 120.0), NOW + 1.0, running=True)
    assert kept.path.read_text() == before


@contextmanager
def keeping(nodes, clock):
    memories = {role: memory(f"bench.{role}") for role in nodes}
    keeper = Keeper(memories, lambda: nodes, lambda: clock[0])
    keeper.start()
    try:
        yield keeper, memories
    finally:
        keeper.stop()


def test_two_actuators_are_kept_side_by_side():
    nodes = {"test": WARM, "load": WARM - 20.0}
    with keeping(nodes, [NOW]) as (_keeper, memories):
        assert all(json.loads(one.path.read_text())["running"] for one in memories.values())
        nodes["test"] = WARM + 5.0
    assert memories["test"].recall(NOW).nodes == pytest.approx(WARM + 5.0, abs=0.1)
    assert memories["load"].recall(NOW).nodes == pytest.approx(WARM - 20.0, abs=0.1)


def test_a_keeper_that_cannot_write_says_so_once_it_is_overdue(monkeypatch):
    monkeypatch.setattr(thermal_memory, "WRITTEN_EVERY_S", 3600.0)  # no writing but the first and the last
    clock = [NOW]
    with keeping({"test": WARM}, clock) as (keeper, _memories):
        assert keeper.fault() == ""
        clock[0] = NOW + OVERDUE_S
        assert keeper.fault() == ""
        clock[0] = NOW + OVERDUE_S + 1.0
        assert keeper.fault().startswith("the windings' state was not written for 11 s")


def test_a_run_whose_bench_was_not_confirmed_safe_is_remembered_as_one_that_died():
    with keeping({"test": WARM}, [NOW]) as (keeper, memories):
        keeper.doubted = True
    assert memories["test"].recall(NOW).known.startswith("its last run ended without a word")


def test_without_a_place_to_keep_state_no_run_begins(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "file"))
    keeper = Keeper({"test": memory()}, lambda: {"test": WARM}, lambda: NOW)
    with pytest.raises(InputError, match=r"the windings' state cannot be kept: .*; set LEACTL_STATE"):
        keeper.start()


def test_a_bench_emulated_in_this_process_leaves_no_file(spin, tmp_path):
    outcome, _bench = spin()
    assert outcome.status == "complete"
    assert not (tmp_path / "state" / "thermal").exists()


def test_a_real_bench_of_which_nothing_is_known_is_hot_and_cold_where_a_person_says_so(testbed):
    file, devices, _document = benchfile.load(str(testbed))
    assert Windings(file, devices).recalled["test"].nodes.tolist() == [130.0] * 3
    assert Windings(file, devices, cold=True).recalled["test"].nodes == pytest.approx(28.0)


# -- a process that is killed ------------------------------------------------------------------------------------------

SPIN = """
name: spin
setup: free
rate_Hz: 100
steps:
  - mode: {test: current}
  - hold: {role: test, current_A: 0.7, duration_s: 60}
"""


@pytest.fixture
def served(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    for role in ("test", "load"):
        bench["devices"][f"drive_{role}"]["settings"] |= {"consumer_heartbeat_ms": 1000, "sdo_timeout_s": 1.0}
    bench["limits"] |= {"age_s": 30, "cyclic_age_s": 30}
    seldom = {"in_a_row": 10_000, "share_percent": 99, "window_s": 600}
    bench["interlocks"] = {"clock": {"jump_s": 10}, "loop_overruns": seldom}
    del bench["buses"]["i2c1"], bench["devices"]["torque_sensor"]
    bench["buses"]["can0"] |= {"interface": "pty", "options": {"sleep_after_open": 0.0}}
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench))
    (tmp_path / "spin.yaml").write_text(SPIN)
    server = subprocess.Popen(
        [*COMMAND, "bench", "serve", "bench.yaml", "--setup", "free"], stdout=subprocess.PIPE, text=True
    )
    where = server.stdout.readline().split()
    while server.stdout.readline() != "serving; Ctrl-C ends it\n":
        assert server.poll() is None
    yield ["--bench", "bench.yaml", "--served", f"--bus=can0=slcan:{where[-1]}"]
    server.kill()
    server.communicate()


def test_a_run_that_is_killed_is_found_by_the_next(tmp_path, served):
    run = start("run", "spin.yaml", *served)
    live_run(tmp_path, run)
    os.kill(run.pid, signal.SIGKILL)
    run.communicate()
    kept = json.loads((tmp_path / "state" / "thermal" / "emulated.test.json").read_text())
    assert kept["running"] is True
    told = leactl("thermal", "state", "--bench", "bench.yaml", "--json")
    [test, _load] = json.loads(told.stdout)["windings"]
    assert test["known"].startswith("its last run ended without a word after ")
    assert 100.0 < test["hottest_phase_degC"] <= 130.0
