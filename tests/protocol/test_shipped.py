"""The protocols that ship: what they ask of the bench, and that the physics they were written for holds."""

import math

import pytest

from leactl.driver.contract import Mode
from leactl.protocol import protocolfile, shipped
from leactl.protocol.plan import Engage, Ramp, SetSupply, Tare
from tests.protocol.writing import levels, segments

KT = 0.49  # N*m/A
PRELOADS = {"unloaded": (0.0182, 0.2419), "design": (0.0238, 0.208), "loaded": (0.0255, 0.3037)}  # b, f


@pytest.mark.parametrize("name", shipped.names())
def test_every_shipped_protocol_is_in_order(name):
    loaded = protocolfile.load(name)
    assert loaded.name == name
    assert loaded.title
    assert loaded.analysis or loaded.separates  # the latter's runs go to `leactl gap diagnose`
    modes, outputs = {}, {}
    for action in loaded.actions:
        if isinstance(action, Engage):
            modes |= action.modes
        if isinstance(action, SetSupply):
            outputs |= action.outputs
    assert modes or outputs
    assert set(modes.values()) <= {Mode.OFF}
    assert set(outputs.values()) <= {None}


def test_torque_constant():
    loaded = protocolfile.load("torque-constant")
    assert loaded.setup == "coupled"
    assert isinstance(loaded.actions[0], Tare)
    assert loaded.actions[1] == Engage({"test": Mode.CURRENT, "load": Mode.ANGLE})
    holds = [s for s in segments(loaded) if s.name == "hold"]
    for level in (4.9, 9.8, 14.7, 19.6, 24.5):
        for direction in ("rising", "falling"):
            asked = {"current_A": level, "direction": direction, "role": "test"}
            visits = [s.parameters["repeat"] for s in holds if asked.items() <= s.parameters.items()]
            assert visits == [1, 2, 3, 4, 5, 6]
    assert {(s.duration_s, s.settle_s) for s in holds} == {(1.0, 0.5)}
    assert [s.duration_s for s in segments(loaded) if s.name == "rest"] == [15] * 30
    assert loaded.peaks() == {("test", "q_axis_current_reference"): 28.5}
    assert segments(loaded)[-1].setpoints["test"].at(math.inf) == 0
    assert [(limit.result, limit.low, limit.unit) for limit in loaded.acceptance] == [("r_squared", 0.99, "1")]


def test_torque_constant_moves_the_current_at_one_rate_only():
    loaded = protocolfile.load("torque-constant", {"rate_A_s": "5"})
    at = 0.0
    for segment in segments(loaded):
        profile = segment.setpoints["test"]
        assert profile.at(0) == at
        if isinstance(profile, Ramp):
            assert abs(profile.stop - profile.start) == pytest.approx(5 * segment.duration_s)
        at = profile.at(segment.duration_s)


def test_torque_constant_turns_further_than_sticking_hides():
    loaded = protocolfile.load("torque-constant")
    # two rotors in series, each hiding up to f/Kt on either side
    hidden = max(4 * friction / KT for _damping, friction in PRELOADS.values())
    assert 4.9 - min(levels(loaded, "turn")) > hidden
    assert max(levels(loaded, "turn")) - 24.5 > hidden


@pytest.mark.parametrize(("condition", "ends"), [("", (0.6, 0.74)), ("design", (0.6, 0.74)), ("loaded", (0.76, 0.89))])
def test_friction(condition, ends):
    loaded = protocolfile.load("friction", condition=condition)
    assert loaded.setup == "free"
    assert not loaded.acceptance
    held = levels(loaded)
    assert sorted({abs(level) for level in held}) == pytest.approx(
        [ends[0] + n * (ends[1] - ends[0]) / 4 for n in range(5)]
    )
    assert all(held.count(level) == 5 for level in held)
    assert {-level for level in held} == set(held)
    assert {(s.duration_s, s.settle_s) for s in segments(loaded) if s.name == "hold"} == {(10, 5)}


def test_friction_comes_to_every_level_from_a_shaft_that_turns_faster():
    before = 0.0
    for segment in segments(protocolfile.load("friction")):
        level = segment.setpoints["test"].at(0)
        if segment.name == "hold":
            assert abs(level) < abs(before)
            assert level * before > 0
        before = level


@pytest.mark.parametrize(("preload", "condition"), [("unloaded", ""), ("design", ""), ("loaded", "loaded")])
def test_friction_breaks_loose_turns_at_every_level_and_keeps_below_the_limit(preload, condition):
    damping, friction = PRELOADS[preload]
    loaded = protocolfile.load("friction", condition=condition)
    speeds = [(KT * abs(level) - friction) / damping for level in levels(loaded) + levels(loaded, "start")]
    assert min(speeds) > 2
    assert max(speeds) < 40
    assert all(KT * abs(level) > 1.5 * friction for level in levels(loaded, "start"))


def test_thermal():
    loaded = protocolfile.load("thermal", {"current_A": "9"})
    assert loaded.setup == "heated"
    assert [action.outputs for action in loaded.actions if isinstance(action, SetSupply)] == [
        {"test": (8.0, 9.0)},
        {"test": None},
    ]
    lasting = {segment.name: segment.duration_s for segment in segments(loaded)}
    assert (lasting["heating"], lasting["cooling"]) == (75 * 60, 75 * 60)
    assert loaded.rate_Hz == 30
    # the voltage lets 9 A flow through 0.528 ohm at the winding's limit, 105 K warmer
    assert 9 * 0.528 * (1 + 0.004 * 105) < 8.0


def test_the_text_is_kept_byte_for_byte(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_bytes(b"name: mine\r\nsetup: free\r\nrate_Hz: 50\r\nsteps: [{hold: {duration_s: 1}}]  # \xc3\xa9\r\n")
    assert protocolfile.load(str(path)).text.encode() == path.read_bytes()


def test_a_trajectory_lies_beside_its_protocol(tmp_path):
    (tmp_path / "walk.csv").write_text("time_s,current_A\n0,1\n1,2\n")
    (tmp_path / "walk.yaml").write_text(
        "name: walk\nsetup: free\nrate_Hz: 50\nsteps:\n"
        "  - mode: {test: current}\n  - signal: {role: test, kind: csv, path: walk.csv}\n"
    )
    assert protocolfile.load(str(tmp_path / "walk.yaml")).peaks() == {("test", "q_axis_current_reference"): 2.0}


@pytest.mark.parametrize(
    ("name", "setup", "levels_at", "reference_hz"),
    [
        ("current-step", "locked", (2.5, 5, 7.5), 900),
        ("position-step", "free", (math.pi / 4, math.pi / 2, 3 * math.pi / 4), 300),
        ("current-noise", "locked", (2.5, 5, 7.5), 900),
        ("position-noise", "free", (math.pi / 4, math.pi / 2, 3 * math.pi / 4), 300),
    ],
)
def test_control_loops_are_asked_as_in_the_paper(name, setup, levels_at, reference_hz):
    loaded = protocolfile.load(name)
    assert (loaded.setup, loaded.rate_Hz, loaded.record_Hz, loaded.analysis) == (setup, 1000, 1000, name)
    kind = name.partition("-")[2]
    asked = [segment for segment in segments(loaded) if segment.name == kind]
    level = {"step": "to", "noise": "offset"}[kind]
    key = next(key for key in asked[0].parameters if key.startswith(f"{level}_"))
    at = [segment.parameters[key] for segment in asked]
    assert sorted(set(at)) == pytest.approx(levels_at)
    trials = 25 if name == "current-noise" else 5
    assert [at.count(value) for value in sorted(set(at))] == [trials] * 3
    assert {segment.setpoints["test"].period for segment in asked} == {1 / reference_hz}
    kept = 2.0 if kind == "step" else 8.192
    assert {round(s.duration_s - (s.parameters.get("at_s") or s.settle_s), 6) for s in asked} == {kept}


@pytest.mark.parametrize(("name", "cutoff", "order"), [("current-noise", 218, 35), ("position-noise", 40, 10)])
def test_noise_reaches_as_far_as_in_the_paper_and_is_never_the_same(name, cutoff, order):
    asked = [segment for segment in segments(protocolfile.load(name)) if segment.name == "noise"]
    assert {(s.parameters["cutoff_Hz"], s.parameters["order"]) for s in asked} == {(cutoff, order)}
    assert len({segment.parameters["seed"] for segment in asked}) == len(asked)


def test_back_drive_lets_go_of_every_preload_with_its_drive_off():
    loaded = protocolfile.load("back-drive")
    assert all("test" not in action.modes for action in loaded.actions if isinstance(action, Engage))
    ramps = [segment for segment in segments(loaded) if segment.name == "breakaway"]
    assert len(ramps) == 6
    assert sorted({ramp.setpoints["load"].stop for ramp in ramps}) == [-1.3, 1.3]
    assert 2 * max(friction for _damping, friction in PRELOADS.values()) < 1.3 * KT


@pytest.mark.parametrize("preload", PRELOADS)
def test_coast_down_takes_long_enough_to_be_seen(preload):
    damping, friction = PRELOADS[preload]
    loaded = protocolfile.load("coast-down")
    coasts = [segment for segment in segments(loaded) if segment.name == "coast"]
    stands_after = 0.0024 / damping * math.log1p(damping * 30 / friction)
    assert stands_after * loaded.rate_Hz > 50
    assert all(not segment.setpoints for segment in coasts)
    assert coasts[0].duration_s > stands_after


@pytest.mark.parametrize(
    ("name", "driver", "driven"), [("efficiency", "test", "load"), ("efficiency-driven", "load", "test")]
)
def test_efficiency(name, driver, driven):
    loaded = protocolfile.load(name)
    assert loaded.setup == "coupled"
    assert loaded.analysis == "efficiency"
    assert Engage({driver: Mode.VELOCITY, driven: Mode.CURRENT}) in loaded.actions
    holds = [s for s in segments(loaded) if s.name == "hold"]
    points = {(s.parameters["velocity_rad_s"], s.parameters["current_A"]) for s in holds}
    assert len(holds) == len(points) == 240
    speeds, currents = ({point[k] for point in points} for k in (0, 1))
    assert sorted(speeds) == pytest.approx([2.6183 * n for n in range(1, 13)], abs=0.01)
    assert sorted(currents) == pytest.approx([-1.2 * n for n in range(20, 0, -1)])
    assert {s.parameters["role"] for s in holds} == {driven}
    assert {(s.duration_s, s.settle_s) for s in holds} == {(3.5, 1.5)}
    zero = next(s for s in segments(loaded) if s.name == "zero")
    assert loaded.actions.index(zero) < next(k for k, a in enumerate(loaded.actions) if isinstance(a, Engage))
