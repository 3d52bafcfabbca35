"""Efficiency on the emulated bench, against powers worked out from the model sheet and the bench's preloads."""

from importlib import resources

import numpy as np
import pytest
import yaml

from leactl.analysis.analyze import analyze_runs
from leactl.bench import benchfile
from leactl.model.motor import load_motor
from leactl.runfile.read.reader import Run

LEA = load_motor("lea")[0]
SPEEDS, CURRENTS = (2.62, 26.18, 13.09), (18.0, 1.2, 12.0, 6.0)
SHORT = (
    f"speeds_rad_s={list(SPEEDS)}",
    f"currents_A={[-i for i in CURRENTS]}",
    "rate_A_s=60",
    "hold_s=2.5",
    "rest_s=10",
)
PRELOADS = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())["emulated"]["conditions"]


def protocol(name="efficiency"):
    text = (resources.files("leactl_protocols") / f"{name}.yaml").read_text()
    return text.replace("rate_Hz: 1000", "rate_Hz: 50")  # of the record; what little heats here may stand


def powers(condition, resistance=LEA.phase_resistance):
    """Powers in and out [W] of the one that drives and of the one that is driven, over the grid."""
    b, f = PRELOADS[condition]["viscous_damping"], PRELOADS[condition]["coulomb_friction"]
    w, i = np.meshgrid(SPEEDS, CURRENTS, indexing="ij")
    drag = b * w + f
    shaft = LEA.torque_constant * i + drag
    own = (shaft + drag) / LEA.torque_constant
    taken = (resistance * own + LEA.back_emf_constant * w) * own
    back = (LEA.back_emf_constant * w - LEA.phase_resistance * i) * i
    return taken, shaft * w, back


@pytest.mark.parametrize(
    ("seed", "condition", "name"),
    [
        (1, "design", "efficiency"),
        (5, "loaded", "efficiency-driven"),
        *(
            pytest.param(*drawn, marks=pytest.mark.long)
            for drawn in (
                (2, "unloaded", "efficiency"),
                (3, "loaded", "efficiency"),
                (4, "design", "efficiency-driven"),
            )
        ),
    ],
)
def test_efficiency_within_2_points_and_losses_within_2_percent(spin, seed, condition, name):
    outcome, _ = spin(protocol(name), sets=(f"seed={seed}", *SHORT), condition=condition)
    assert outcome.status == "complete", outcome.reason
    result = analyze_runs([outcome.path])
    taken, shaft, back = powers(condition)
    drives, driven = ("load_", "") if name == "efficiency-driven" else ("", "load_")
    assert result.find(f"{drives}driving_efficiency").value == pytest.approx((shaft / taken).mean(), abs=0.02)
    assert result.find(f"{drives}driving_efficiency").value == pytest.approx((shaft / taken).mean(), abs=5e-4)
    assert result.find(f"{driven}driven_efficiency").value == pytest.approx((back / shaft).mean(), abs=0.02)
    assert result.find(f"{drives}driving_loss").value == pytest.approx((taken - shaft).mean(), rel=0.02)
    assert result.find(f"{driven}driven_loss").value == pytest.approx((shaft - back).mean(), rel=0.02)
    friction = PRELOADS[condition]["viscous_damping"] * np.square(SPEEDS).mean()
    friction += PRELOADS[condition]["coulomb_friction"] * np.mean(SPEEDS)
    for found in (f"{drives}driving_loss_friction", f"{driven}driven_loss_friction"):
        assert result.find(found).value == pytest.approx(friction, rel=0.02)


def warm_resistances(run):
    """Resistance of the driving winding in each hold [ohm], by the two-node network under the recorded current."""
    net, channel = LEA.thermal, run.channel("q_axis_current", "test")
    winding = housing = 0.0  # K above ambient, at which the resistance is that of the sheet
    result = np.empty(len(channel.time))
    for k, (current, dt) in enumerate(zip(channel.values, np.diff(channel.time, prepend=0.0), strict=True)):
        result[k] = LEA.phase_resistance * (1.0 + LEA.resistance_coefficient * winding)
        across = (winding - housing) / net.winding_housing_resistance
        heat = result[k] * np.nan_to_num(current) ** 2 - winding / net.winding_ambient_resistance - across
        winding += dt * heat / net.winding_capacitance
        housing += dt * (across - housing / net.housing_ambient_resistance) / net.housing_capacitance
    holds = [step for step in run.steps if step.name == "hold"]
    inside = [(channel.time >= step.start + step.settle) & (channel.time < step.stop) for step in holds]
    return np.array([result[item].mean() for item in inside]).reshape(len(SPEEDS), len(CURRENTS))


def test_drives_that_tell_their_voltage_show_the_losses_of_warm_windings(spin, tmp_path):
    text = (benchfile.SHIPPED / "emulated.yaml").read_text().replace("name: emulated", "name: mine", 1)
    told = "counts_per_turn: 40000, q_axis_voltage: {index: 12032, type: i16, scale_V: 0.001}"
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace("counts_per_turn: 40000", told))
    outcome, _ = spin(protocol(), sets=("seed=6", *SHORT), bench=str(path))
    assert outcome.status == "complete", outcome.reason
    result = analyze_runs([outcome.path])
    with Run.open(outcome.path) as run:
        taken, shaft, _ = powers("design", warm_resistances(run))
    assert result.find("driving_loss").value == pytest.approx((taken - shaft).mean(), rel=5e-3)
    assert result.find("driving_efficiency").value == pytest.approx((shaft / taken).mean(), abs=2e-3)
    cold, _, _ = powers("design")
    assert result.find("driving_loss").value > (cold - shaft).mean() * 1.02


def test_points_beyond_the_voltage_ceiling_stay_empty(spin):
    sets = ("speeds_rad_s=[13.09,31.42]", "currents_A=[-24,-6]", *SHORT[2:])
    result = analyze_runs([spin(protocol(), sets=("seed=7", *sets))[0].path])
    ceiling = 29.6 / np.sqrt(2.0)
    drag = LEA.viscous_damping * 31.42 + LEA.coulomb_friction
    needed = LEA.phase_resistance * (24.0 + 2 * drag / LEA.torque_constant) + LEA.back_emf_constant * 31.42
    assert needed > ceiling
    values = np.array(result.grids[0].values["efficiency_1"])
    np.testing.assert_array_equal(np.isnan(values), [[False, False], [True, False]])
    assert any("velocity was not reached (31.42 rad/s -24 A)" in note for note in result.notes)
