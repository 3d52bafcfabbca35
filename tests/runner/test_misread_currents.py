"""Drives and supplies that misread their current by a convention's factor, in whole runs: found before they heat.

The drive regulates what it misreads, so that its reading and its demand agree; only a second sensor tells.
"""

import math

import pytest
import yaml
from leactl_plugins.bk1688b.driver import Bk1688b

from leactl.bench import benchfile
from leactl.emulation.bench.emulated_bench import observed
from leactl.runner.drill.power_watch import DrivePowerWatch

FACTORS = (2 / 3, math.sqrt(1.5), math.sqrt(2.0), 1.5, math.sqrt(3.0))  # true current over its reading
AMBIENT_DEGC, LIMIT_DEGC = 25.0, 130.0
FIFTH_DEGC = AMBIENT_DEGC + (LIMIT_DEGC - AMBIENT_DEGC) / 5  # of the heat that a cold winding has left
LOCKED = """
name: stall
setup: locked
rate_Hz: 100
steps:
  - mode: {test: current}
  - hold: {role: test, current_A: 12, duration_s: 30}
  - mode: {test: "off"}
"""
COUPLED = """
name: turning
setup: coupled
rate_Hz: 100
steps:
  - mode: {load: velocity, test: current}
  - hold: {role: load, velocity_rad_s: 5, duration_s: 0.5}
  - hold: {role: test, current_A: 10, duration_s: 30}
  - mode: {test: "off", load: "off"}
"""
VOLTS = {"index": 0x2F00, "type": "i16", "scale_V": 0.001}


@pytest.fixture
def misread(spin, tmp_path):
    """Run on an emulated bench where these roles' drives read 1/factor of their current: outcome, hottest phase."""

    def misread(text, roles, factor, change=lambda bench: None, name="emulated", **options):
        bench = yaml.safe_load((benchfile.SHIPPED / f"{name}.yaml").read_text())
        emulated = bench["emulated"]
        emulated["bench"] = emulated.get("bench", {}) | {"phase_resolved": True}
        emulated["effects"] = [{"name": "current_sensor_gain", "gain": 1 / factor, "role": role} for role in roles]
        change(bench)
        path = tmp_path / "misread.yaml"
        path.write_text(yaml.safe_dump(bench))
        plant = DrivePowerWatch()
        with observed(plant.see):
            outcome, _bench = spin(text, bench=str(path), condition="", **options)
        return outcome, max(plant.bench.rig.hottest_phase(role).highest for role in ("test", "load"))

    return misread


@pytest.mark.parametrize("factor", FACTORS)
@pytest.mark.parametrize(
    ("text", "roles"), [(LOCKED, ["test"]), (COUPLED, ["test"]), (COUPLED, ["load"]), (COUPLED, ["test", "load"])]
)
def test_a_torque_sensor_finds_it_before_a_fifth_of_the_heat_is_used(misread, text, roles, factor):
    outcome, hottest = misread(text, roles, factor)
    assert (outcome.status, hottest < FIFTH_DEGC) == ("tripped", True)
    assert " q_axis_current of " in outcome.reason
    assert outcome.duration_s < 2.0


def by_voltage(bench):
    """Drives that tell the voltage at their windings, and no torque sensor."""
    for role in ("test", "load"):
        bench["devices"][f"drive_{role}"]["settings"]["q_axis_voltage"] = dict(VOLTS)
    del bench["devices"]["torque_sensor"], bench["interlocks"]["torque"], bench["interlocks"]["torque_disagreement"]
    bench["interlocks"]["voltage_disagreement"] = {"tolerance_V": 0.1, "share_percent": 1.0}


@pytest.mark.parametrize("factor", FACTORS[1:])
def test_the_voltage_at_the_winding_finds_it_too(misread, factor):
    outcome, hottest = misread(LOCKED, ["test"], factor, by_voltage)
    assert (outcome.status, hottest < FIFTH_DEGC) == ("tripped", True)
    assert " contradicts test q_axis_voltage, by which " in outcome.reason


@pytest.mark.parametrize("change", [lambda bench: None, by_voltage])
@pytest.mark.parametrize("factor", [1 / 1.02, 1.02])  # the tolerance of `current` in the motor's file
def test_a_current_that_is_read_within_its_tolerance_is_left_alone(misread, change, factor):
    quick = COUPLED.replace("duration_s: 30", "duration_s: 3")
    assert misread(quick, ["test", "load"], factor, change)[0].status == "complete"


@pytest.mark.parametrize("condition", ["unloaded", "loaded"])
def test_friction_of_other_preloads_is_left_alone(misread, condition):
    quick = COUPLED.replace("duration_s: 30", "duration_s: 2")
    shipped = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())["emulated"]["conditions"][condition]

    def preloaded(bench):
        for role in ("test", "load"):
            bench["emulated"][role] = dict(shipped)

    assert misread(quick, [], 1.0, preloaded)[0].status == "complete"


HEATED = """
name: heated
setup: heated
rate_Hz: 20
steps:
  - supply: {test: {voltage_V: 10, current_A: 6}}
  - hold: {duration_s: 60}
  - supply: {test: off}
"""


@pytest.mark.parametrize("factor", FACTORS[1:])
def test_the_voltage_of_a_supply_tells_of_a_current_that_it_reads_too_low(misread, monkeypatch, factor):
    measured = Bk1688b.take

    def too_low(self):
        return [row._replace(values=(row.values[0], row.values[1] / factor)) for row in measured(self)]

    monkeypatch.setattr(Bk1688b, "take", too_low)
    outcome, hottest = misread(HEATED, [], 1.0, lambda bench: bench["emulated"].pop("effects"), name="emulated-heated")
    assert (outcome.status, hottest < FIFTH_DEGC) == ("tripped", True)
    assert outcome.reason.startswith("test winding is by its resistance at ")
