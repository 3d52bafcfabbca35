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
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from leactl.bench import benchfile
from leactl.errors import InputError
from leactl.model.motor import load_motor
from leactl.runner import state_folder, thermal_memory
from leactl.runner.boot_time import ClockReadings
from leactl.runner.thermal_admission import Windings
from leactl.runner.thermal_memory import OVERDUE_S, Keeper, Memory
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.temperature_bound import ThermalBound
from tests.cli.terminal import COMMAND, leactl, live_run, start
from tests.safety.phases import Plant

LEA = load_motor("lea")[0]
UPTIME = 5e6  # s
WARM = np.array([90.0, 80.0, 50.0])


def at(seconds=0.0, boot="b1", wall=None):
    """So long after the moment at which the tests keep something, in this boot."""
    return ClockReadings(1.8e9 + seconds if wall is None else wall, boot, UPTIME + seconds)


NOW = at()


def memory(actuator="a1", motor=LEA, limit=130.0, ambient=25.0):
    return Memory(actuator, motor, limit, ambient, state_folder.of_user())


def test_what_was_kept_is_recalled():
    memory().keep(WARM, NOW, running=False)
    result = memory().recall(NOW)
    assert result.nodes == pytest.approx(WARM, abs=0.1)
    assert result.known.startswith("at rest since 2027-01-15T08:00:00")


def test_windings_cool_while_nothing_runs_the_housing_slowly():
    memory().keep(WARM, NOW, running=False)
    nodes = [memory().recall(at(seconds)).nodes for seconds in (0, 60, 600, 3600, 7 * 86400)]
    assert all(later[0] < earlier[0] for earlier, later in pairwise(nodes))
    assert nodes[1][0] < 65.0
    assert nodes[1][2] > 40.0
    assert nodes[-1] == pytest.approx(28.0, abs=0.1)


def test_a_run_that_died_left_its_winding_at_the_limit_and_its_housing_warmer():
    memory().keep(WARM, NOW, running=True)
    result = memory().recall(NOW)
    assert result.nodes[:2] == pytest.approx(130.0, abs=0.1)
    assert 52.0 < result.nodes[2] < 70.0
    assert result.known.startswith("its last run ended without a word after 2027-")
    # nothing is known of the time until a writing was overdue
    assert memory().recall(at(OVERDUE_S)).nodes == pytest.approx(result.nodes)
    assert memory().recall(at(600.0)).nodes[0] < 80.0
    assert memory().recall(at(2 * 86400.0)).nodes == pytest.approx(28.0, abs=0.1)


@pytest.mark.parametrize(("left_on", "hottest"), [(94.9, 130.0), (154.2, 154.2)])
def test_a_supply_that_nobody_has_switched_off_lets_nothing_cool(left_on, hottest):
    memory().keep(WARM, NOW, running=True, left_on=left_on)
    for seconds in (0.0, OVERDUE_S, 7200.0, 7 * 86400.0):
        result = memory().recall(at(seconds))
        assert (result.nodes.tolist(), result.left_on) == ([hottest] * 3, left_on)
        assert result.known.startswith("a supply may heat it still, since 2027-")


def test_a_supply_that_was_seen_off_at_the_end_lets_it_cool():
    memory().keep(WARM, NOW, running=False, left_on=None)
    assert memory().recall(at(600.0)).left_on is None
    assert memory().recall(at(600.0)).nodes[0] < 80.0


def test_a_supply_that_may_be_on_is_handed_on_until_a_run_has_seen_it_off():
    memory().keep(WARM, NOW, running=True, left_on=140.0)
    clock = [at(60.0)]
    kept = memory()
    keeper = Keeper({"test": kept}, lambda: {"test": kept.recall(clock[0]).nodes}, lambda: clock[0])
    keeper.left_on["test"] = kept.recall(clock[0]).left_on
    keeper.start()  # a run that dies before its devices are safe leaves it as it was
    assert memory().recall(at(7200.0)).nodes.tolist() == [140.0] * 3
    keeper.stop()  # before any device was opened
    assert memory().recall(at(7200.0)).nodes.tolist() == [140.0] * 3
    keeper.seen_off = True
    keeper.stop()
    assert memory().recall(at(7200.0)).left_on is None
    assert memory().recall(at(7 * 86400.0)).nodes == pytest.approx(28.0, abs=0.1)


FAULTS = {
    "damaged": (lambda text: text.replace(":", ";"), "delimiter"),
    "cut short": (lambda text: text[: len(text.strip()) // 2], ""),
    "empty": (lambda text: "", "Expecting value"),
    "a list": (lambda text: "[1, 2]", ""),
    "no object": (lambda text: "null", ""),
    "nested": (lambda text: "[" * 100_000, ""),
    "format": ({"format": "leactl-run"}, "format leactl-run 3, leactl-thermal 3 was expected"),
    "version": ({"format_version": 4}, "format leactl-thermal 4, leactl-thermal 3 was expected"),
    "of an earlier version": ({"format_version": 2}, "format leactl-thermal 2, leactl-thermal 3 was expected"),
    "another actuator": ({"actuator": "b7"}, "it is of actuator 'b7'"),
    "another motor": ({"motor_sha256": "0" * 64, "motor": "ak80"}, "it is of another motor file ('ak80')"),
    "of the future": ({"since_boot_s": UPTIME + 3600.0}, "it is of the future, 3.57e+03 s ahead of this boot's clock"),
    "no time": ({"since_boot_s": math.nan}, "nan s after a boot, which is no time"),
    "before its boot": ({"since_boot_s": -1.0}, "-1 s after a boot, which is no time"),
    "an endless time": ({"since_boot_s": 10**400}, "too large"),
    "a time in words": ({"since_boot_s": "noon"}, "noon"),
    "no wall clock": ({"time": math.nan}, "nan s since 1970, which is no time"),
    "no boot": ({"boot": None}, "boot: the identifier of a boot was expected"),
    "kelvin": ({"nodes_degC": [298.0, 298.0, 298.0]}, "three temperatures in degC were expected"),
    "NaN": ({"nodes_degC": [math.nan, 30.0, 30.0]}, "three temperatures in degC were expected"),
    "endless": ({"nodes_degC": [math.inf, 30.0, 30.0]}, "three temperatures in degC were expected"),
    "negative": ({"nodes_degC": [-273.0, 30.0, 30.0]}, "three temperatures in degC were expected"),
    "two nodes": ({"nodes_degC": [30.0, 30.0]}, "three temperatures in degC were expected"),
    "one number": ({"nodes_degC": 30.0}, "three temperatures in degC were expected"),
    "texts": ({"nodes_degC": ["30", "30", "30"]}, "three temperatures in degC were expected"),
    "truths": ({"nodes_degC": [True, True, True]}, "three temperatures in degC were expected"),
    "running as a number": ({"running": 0}, "running: true or false was expected"),
    "nulls": ({"nodes_degC": [None, None, None]}, ""),
    "running in words": ({"running": "no"}, "running: true or false was expected"),
    "key missing": ("running", "running"),
    "a supply in words": ({"left_on_degC": "off"}, "left_on_degC 'off': null or a temperature in degC was expected"),
    "a supply of no temperature": ({"left_on_degC": math.nan}, "null or a temperature in degC was expected"),
    "nothing of a supply": ("left_on_degC", "left_on_degC"),
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
    result = kept.recall(at(30.0))
    assert result.nodes.tolist() == [130.0] * 3
    assert result.known.startswith(f"counts as hot: {kept.path} cannot be used: ")
    assert reason in result.known
    assert "\n" not in result.known


def test_nothing_known_and_nothing_readable_count_as_hot(tmp_path):
    result = memory("never seen").recall(NOW)
    assert (result.nodes.tolist(), result.known) == ([130.0] * 3, "counts as hot: nothing is known of it")
    memory("folder").path.mkdir(parents=True)
    assert memory("folder").recall(NOW).nodes.tolist() == [130.0] * 3


@pytest.mark.parametrize("wall", [0.0, 1.8e9 - 3600.0, 1.8e9 + 3600.0, 4e9])
@pytest.mark.parametrize("running", [False, True])
def test_a_wall_clock_that_is_set_cools_nothing(wall, running):
    memory().keep(WARM, NOW, running=running)
    expected = memory().recall(at(30.0)).nodes
    assert memory().recall(at(30.0, wall=wall)).nodes.tolist() == expected.tolist()


def test_what_has_rested_through_a_boot_has_cooled_for_as_long_as_the_machine_is_up():
    memory().keep(WARM, NOW, running=False)
    up = ClockReadings(1.8e9 + 9e6, "b2", 45.0)  # it may have been off for a second or for months
    assert memory().recall(up).nodes.tolist() == memory().recall(at(45.0)).nodes.tolist()


@pytest.mark.parametrize(("wall", "rested"), [(1.8e9 + 12.0, 12.0), (1.8e9 - 3600.0, 0.0)])
def test_of_a_machine_with_another_boot_no_more_counts_than_lies_between_the_wall_clocks(wall, rested):
    """A folder that two machines share: the other one has been up for days."""
    memory().keep(WARM, NOW, running=False)
    result = memory().recall(ClockReadings(wall, "of the other machine", 9e5)).nodes
    assert result.tolist() == pytest.approx(memory().recall(at(rested)).nodes.tolist())


LAGGED = LEA.model_copy(update={"thermal": LEA.thermal.model_copy(update={"winding_ambient_resistance": 1e4})})
"""All of its heat leaves by the housing."""
HEAVY = LAGGED.model_copy(update={"thermal": LAGGED.thermal.model_copy(update={"winding_capacitance": 2000.0})})
"""The winding holds more than the housing."""
LIGHT = LEA.model_copy(update={"thermal": LEA.thermal.model_copy(update={"housing_capacitance": 2.0})})
"""The housing holds next to nothing."""
SLOWEST = (1.0,) * 9 + (0.0, 1.0)  # resistances and capacitances high
LONG = 2500.0  # s


@settings(max_examples=40, deadline=None)
@example(LAGGED, SLOWEST, LONG, (100.0, 1.0, 1.0))
@example(HEAVY, SLOWEST, LONG, (100.0, 1.0, 0.0))
@example(HEAVY, SLOWEST, LONG, (100.0, 1.0, 1.0))
@example(LIGHT, SLOWEST, 200.0, (100.0, 1.0, 1.0))
@example(LEA, SLOWEST, 61.0, (100.0, 1.0, 0.0))
@given(
    motor=st.sampled_from([LEA, LAGGED, HEAVY, LIGHT]),
    places=st.tuples(*[st.sampled_from([-1.0, 1.0])] * 11),
    rest=st.floats(1.0, 4000.0),
    rises=st.tuples(st.floats(0.0, 100.0), st.floats(0.34, 1.0), st.floats(0.0, 1.0)),
)
def test_no_plant_of_the_box_is_hotter_after_a_rest_than_its_bound(motor, places, rest, rises):
    """Against the matrix exponential of three phases and a housing."""
    plant = Plant.inside(places, motor=motor)
    hottest, mean, housing = (28.0 + rises[0] * share for share in (1.0, rises[1], rises[2]))
    bound = ThermalBound([Box.of(motor)], 25.0)
    bound.set(np.array([[hottest], [mean], [housing]]))
    bound.rest(rest, 25.0)
    others = 1.5 * mean - 0.5 * hottest
    conductance, air = 1.0 / (3.0 * plant.winding_housing_resistance), 1.0 / (3.0 * plant.winding_ambient_resistance)
    rates = np.diag([-(conductance + air)] * 3 + [-(3.0 * conductance + 1.0 / plant.housing_ambient_resistance)])
    rates[:3, 3] = rates[3, :3] = conductance
    capacitances = np.array([plant.winding_capacitance / 3.0] * 3 + [plant.housing_capacitance])
    before = np.array([hottest, others, others, housing]) - plant.ambient
    after = plant.ambient + expm(rates / capacitances[:, None] * rest) @ before
    assert np.all(np.array([after[:3].max(), after[:3].mean(), after[3]]) <= bound.nodes()[:, 0] + 1e-6)


@pytest.mark.parametrize(("start", "ambient"), [(np.inf, 25.0), (np.nan, 25.0), (28.0, np.nan)])
def test_a_rest_from_what_is_no_number_leaves_no_promise(start, ambient):
    bound = ThermalBound([Box.of(LEA)], 25.0)
    bound.set(np.full((3, 1), start))
    bound.rest(1e7, ambient)
    assert bound.hottest()[0] == np.inf


def test_a_rest_of_two_days_leaves_what_one_of_an_hour_leaves_or_less():
    memory().keep(WARM, NOW, running=False)
    hour, days = (memory().recall(at(seconds)).nodes for seconds in (3600.0, 172_800.0))
    assert np.all(days <= hour)
    assert hour[0] < 30.0
    assert days == pytest.approx(28.0, abs=0.01)


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
        kept.keep(np.full(3, 120.0), at(1.0), running=True)
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
        assert all(json.loads(value.path.read_text())["running"] for value in memories.values())
        nodes["test"] = WARM + 5.0
    assert memories["test"].recall(NOW).nodes == pytest.approx(WARM + 5.0, abs=0.1)
    assert memories["load"].recall(NOW).nodes == pytest.approx(WARM - 20.0, abs=0.1)


def test_what_a_labelled_actuator_is_heated_by_is_remembered_without_its_label_too():
    """A later jog has no label; what was hotter before the run stays so."""
    unlabelled, nodes = memory("bench.test"), {"test": WARM}
    for least in (WARM - 10.0, WARM + 15.0):
        keeper = Keeper({"test": memory("LEA-9")}, lambda: nodes, lambda: NOW)
        keeper.further["test"] = unlabelled, least
        keeper.start()
        keeper.stop()
        assert memory("LEA-9").recall(NOW).nodes == pytest.approx(WARM, abs=0.1)
        assert memory("bench.test").recall(NOW).nodes == pytest.approx(np.maximum(WARM, least), abs=0.1)


def test_the_label_of_another_winding_is_refused():
    bench, devices, _ = benchfile.load("emulated")
    with pytest.raises(InputError, match=r"--actuator emulated\.load: is the label of another winding of bench"):
        Windings(bench, devices, "emulated.load")
    assert Windings(bench, devices, "emulated.test").keeper.further == {}
    assert set(Windings(bench, devices, "LEA-9").keeper.further) == {"test"}


def test_a_keeper_that_cannot_write_says_so_once_it_is_overdue(monkeypatch):
    monkeypatch.setattr(thermal_memory, "WRITING_INTERVAL_S", 3600.0)  # no writing but the first and the last
    clock = [NOW]
    with keeping({"test": WARM}, clock) as (keeper, _memories):
        assert keeper.fault() == ""
        clock[0] = at(OVERDUE_S)
        assert keeper.fault() == ""
        clock[0] = at(OVERDUE_S + 1.0)
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
    completed = leactl("thermal", "state", "--bench", "bench.yaml", "--json")
    [test, _load] = json.loads(completed.stdout)["windings"]
    assert test["known"].startswith("its last run ended without a word after ")
    assert 100.0 < test["hottest_phase_degC"] <= 130.0
