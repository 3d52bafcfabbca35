"""Errata of the print on efficiency: each shown by the printed parameters and, where it is one, by the analysis."""

import math

import numpy as np
import pytest

from leactl.analysis.experiments.efficiency import analyze
from leactl.model.motor import load_motor
from leactl.protocol import protocolfile
from tests.protocol.writing import segments

from .coupled import CoupledBench, Truth
from .synthetic import analyzed

LEA = load_motor("lea")[0]
SPEEDS, CURRENTS = np.arange(1, 13) * 2.6183, np.arange(1, 21) * 1.2
CEILING = 29.6 / math.sqrt(2.0)
HOT = LEA.phase_resistance * (1.0 + LEA.resistance_coefficient * (130.0 - 25.0))


def voltages(resistance):
    w, i = np.meshgrid(SPEEDS, CURRENTS, indexing="ij")
    own, taken, _ = Truth(r=resistance).driving(w, i)
    return taken / own


def beyond(resistance):
    """Which points take more than the bus gives, the winding's inductance counted."""
    w, i = np.meshgrid(SPEEDS, CURRENTS, indexing="ij")
    own = Truth(r=resistance).driving(w, i)[0]
    return np.hypot(voltages(resistance), LEA.pole_pairs * w * LEA.phase_inductance * own) > CEILING


def test_above_75_percent_is_out_of_reach(tmp_path):
    plus, _ = Truth().efficiencies(np.linspace(0.5, 31.42, 200), np.linspace(0.1, 24.0, 200))
    assert plus.max() == pytest.approx(0.695, abs=0.001)
    path = CoupledBench(tmp_path).run(speeds=(20.0, 25.0, 31.42), currents=(4.8, 6.0, 7.2, 8.4), noise=0.1)
    assert analyzed(analyze, path).find("driving_efficiency_highest").high < 0.70


@pytest.mark.parametrize(("resistance", "slope"), [(LEA.phase_resistance, 0.93), (HOT, 0.66)])
def test_negative_efficiency_begins_at_a_slope_of_0_93_cold_and_0_66_hot_not_0_5(tmp_path, resistance, slope):
    assert LEA.torque_constant**2 / resistance + LEA.viscous_damping == pytest.approx(slope, abs=0.01)
    model = f"phase_resistance: {resistance}\nback_emf_constant: 0.49\n"
    speeds, currents = tuple(np.linspace(2.0, 12.0, 6)), tuple(np.linspace(2.0, 24.0, 12))
    path = CoupledBench(tmp_path).run(Truth(r=resistance), speeds=speeds, currents=currents, noise=0.0, model=model)
    [zero] = [line for line in analyzed(analyze, path).plots[0].lines if line.label == "0%"]
    result = np.polyfit(-np.array(zero.x), zero.y, 1)  # driven speeds are to the left
    assert result[0] == pytest.approx(slope, abs=0.03)  # straight between 2 A


def test_the_corner_of_the_grid_takes_23_to_26_volts_and_10_to_30_points_are_out_of_reach():
    assert 22.5 < voltages(LEA.phase_resistance)[-1, -1] < 23.5
    assert 25.0 < voltages(HOT)[-1, -1] < 26.5
    assert pytest.approx(20.9, abs=0.05) == CEILING
    assert 10 <= beyond(LEA.phase_resistance).sum() <= beyond(HOT).sum() <= 30


def warmest(parts):
    """Hottest winding [degC] by the two-node network, over (duration [s], current of the one that drives [A])."""
    net, step = LEA.thermal, 0.1  # s, a 65th of the winding's time constant
    winding = housing = most = 0.0
    for duration, own in parts:
        for _ in range(round(duration / step)):
            across = (winding - housing) / net.winding_housing_resistance
            heat = LEA.phase_resistance * (1.0 + LEA.resistance_coefficient * winding) * own**2
            winding += step * (heat - winding / net.winding_ambient_resistance - across) / net.winding_capacitance
            housing += step * (across - housing / net.housing_ambient_resistance) / net.housing_capacitance
            most = max(most, winding)
    return 25.0 + most


def test_without_rests_the_winding_passes_its_limit():
    shipped = []
    for segment in segments(protocolfile.load("efficiency")):
        if segment.name == "hold":
            point = segment.parameters["velocity_rad_s"], -segment.parameters["current_A"]
            shipped.append((segment.duration_s, Truth().driving(*point)[0]))
        elif segment.name == "rest":
            shipped.append((segment.duration_s, 0.0))
    assert warmest(shipped) < 110.0
    assert warmest([part for part in shipped if part[1]]) > 140.0
    assert warmest([(3.5, Truth().driving(w, i)[0]) for w in SPEEDS for i in CURRENTS]) > 190.0  # in the paper's order


def test_the_printed_means_lie_within_the_model_s_cold_and_hot_ones():
    """53.5 % of the print is between the grid's mean cold and hot, over the points that the bus can hold."""
    means = []
    for resistance in (LEA.phase_resistance, HOT):
        plus, _ = Truth(r=resistance).efficiencies(SPEEDS, CURRENTS)
        means.append(plus[~beyond(resistance)].mean())
    assert means[1] < 0.535 < means[0]
