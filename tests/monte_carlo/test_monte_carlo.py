"""The Monte Carlo itself: a few of its trials, and whether it finds a guard that is wrong."""

import json

import numpy as np
import pytest

from leactl.safety.thermal.guard import ThermalGuard
from leactl.safety.thermal.turning import FIELDS, HEAT
from tests.monte_carlo import __main__ as command
from tests.monte_carlo.direct import FAULTS, Fault
from tests.monte_carlo.plants import LEA, ROLES, drawn
from tests.monte_carlo.protocols import Protocol
from tests.monte_carlo.report import report, wilson
from tests.monte_carlo.supervised import run
from tests.monte_carlo.trial import LEA_START, Campaign, needless, tried, violations
from tests.monte_carlo.truth import History, hottest
from tests.protocol.writing import read

FEW = Campaign(count=20, over_wire=2, outside=4, seed=1)
HOT = """name: hot
setup: locked
rate_Hz: 50
steps:
  - mode: {test: current}
  - hold: {role: test, current_A: 22, duration_s: 60}
"""


@pytest.fixture(autouse=True)
def own_state(tmp_path, monkeypatch):
    """Latches and thermal states go to a directory of the test."""
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))


def plant_of(seed):
    """A plant inside the tolerances."""
    return drawn(np.random.default_rng(seed), "", 60.0)


def held_at(plant, guard_of, fault=None):
    """The hottest phase of a rotor that is held at 22 A."""
    course = run(read(HOT), plant, fault, LEA_START, 1, guard_of)
    return hottest([History(plant, [course])])[0][0], course


@pytest.mark.long
def test_few_trials_lose_no_winding_no_drive_and_no_file():
    told = tried(FEW, FEW.numbers)
    assert [item["number"] for item in told] == list(FEW.numbers)
    assert [item["kind"] for item in told].count("wire") == 2
    assert [item["kind"] for item in told].count("outside") == 4
    assert [violations(item) for item in told] == [[]] * len(told)
    assert 5 <= sum(bool(item["fault"]) for item in told) <= 15
    assert any(needless(item) is False for item in told)


class LimitRaised(ThermalGuard):
    """Stops 60 K too late."""

    def __init__(self, motors, settings, start):
        super().__init__(motors, type(settings)(**vars(settings) | {"limit": settings.limit + 60.0}), start)


class HeatHalved(ThermalGuard):
    """Sees half of the heat."""

    def _advance(self, now, duration):
        for log in self.logs:
            log[HEAT::FIELDS] = [0.5 * heat for heat in log[HEAT::FIELDS]]
        self.flowing = [0.5 * square for square in self.flowing]
        return super()._advance(now, duration)


class NeverAdvanced(ThermalGuard):
    """Is computed by nobody."""

    def check(self, now):
        return ""


PLANTS = range(4)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in PLANTS[1:])])
def test_the_guard_as_it_is_holds_this_plant(seed):
    assert held_at(plant_of(seed), ThermalGuard)[0] < 130.0


@pytest.mark.parametrize("guard_of", [pytest.param(LimitRaised, marks=pytest.mark.long), HeatHalved, NeverAdvanced])
def test_a_guard_that_is_wrong_is_found(guard_of):
    peaks = (held_at(plant_of(seed), guard_of)[0] for seed in PLANTS)
    told = ({"kind": "direct", "fault": "", "energised": [], "peak_degC": peak} for peak in peaks)
    result = next(filter(None, map(violations, told)))
    assert result[0].startswith("hottest phase at")


SELDOM = {"stuck velocity", "stuck angle", "noisy current"}  # long: seconds each


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.long] if kind in SELDOM else []) for kind in FAULTS]
)
def test_every_fault_leaves_drives_without_power_but_the_one_that_is_deaf(kind):
    fault = Fault(kind, 5.0, np.inf, "test", 0.3)
    peak, course = held_at(plant_of(3), ThermalGuard, fault)
    assert peak < 130.0
    assert course.energised == (["test"] if kind == "frozen drive" else [])


def test_a_killed_process_leaves_its_current_for_the_consumer_time():
    _, course = held_at(plant_of(3), ThermalGuard, Fault("process killed", 5.0, 0.0, "test", 0.0))
    flowing = np.flatnonzero(np.abs(course.currents[0]) > 1.0)
    assert course.status == "killed"
    assert flowing[-1] == pytest.approx(500 + 20, abs=3)  # ticks of 10 ms


@pytest.mark.parametrize("seed", range(30))
def test_protocols_stay_within_the_limits_of_the_bench(seed):
    protocol = Protocol(np.random.default_rng(seed), 60.0)
    plan = protocol.plan()
    peaks = plan.peaks()
    assert peaks.get(("test", "q_axis_current_reference"), 0.0) <= 30.0
    assert all(value <= 40.0 for (_, quantity), value in peaks.items() if quantity == "velocity_reference")
    assert plan.duration_s > 5.0


def test_plants_lie_inside_the_tolerances():
    for seed in range(50):
        plant = plant_of(seed)
        for role in ROLES:
            for name, width in LEA.tolerances.model_dump().items():
                if hasattr(LEA.thermal, name):
                    true, told = getattr(plant.actuators[role].thermal, name), getattr(LEA.thermal, name)
                elif hasattr(LEA, name):
                    true, told = getattr(plant.actuators[role], name), getattr(LEA, name)
                else:
                    continue
                assert abs(true / told - 1.0) <= width * (1 + 1e-12)
            assert abs(plant.factors[role] - 1.0) <= 0.02 * (1 + 1e-12)
        assert abs(plant.ambient - 25.0) <= 3.0


@pytest.mark.long
def test_the_command_goes_on_where_it_was_interrupted(tmp_path, monkeypatch, capsys):
    results = tmp_path / "results.jsonl"
    words = ["--count", "3", "--wire", "1", "--outside", "1", "--processes", "1", "--results", str(results)]
    monkeypatch.setattr("sys.argv", ["monte_carlo", *words])
    done = tried(Campaign(3, 1, 1, 1), [0, 2])
    results.write_text("".join(json.dumps(item) + "\n" for item in done))
    assert command.main() == 0
    told = [json.loads(line) for line in results.read_text().splitlines()]
    assert [item["number"] for item in told] == [0, 2, 1, 3]
    assert told[:2] == done
    assert "3 of 3 trials inside the tolerances, 1 of them over the wire" in capsys.readouterr().out


@pytest.mark.long
def test_a_violation_ends_with_status_one(tmp_path, monkeypatch, capsys):
    results = tmp_path / "results.jsonl"
    (bad,) = tried(Campaign(1, 0, 0, 1), [0])
    bad |= {"peak_degC": 130.01, "fault": ""}
    results.write_text(json.dumps(bad) + "\n")
    monkeypatch.setattr(
        "sys.argv", ["monte_carlo", "--count", "1", "--wire", "0", "--outside", "0", "--results", str(results)]
    )
    assert command.main() == 1
    assert "| hottest phase above 130 degC | 1 | 1 |" in capsys.readouterr().out


def test_wilson_interval_of_none_in_ten_thousand():
    low, high = wilson(0, 10_000)
    assert low == 0.0
    assert high == pytest.approx(3.84e-4, rel=0.01)  # z^2 / (n + z^2)
    assert report([], FEW).startswith("    .venv/bin/python -m tests.monte_carlo")
