"""Errata of the print on motors, windings, the thermal network and the flexures: each shown by its own numbers.

The network is solved here by closed form and by an integrator, not by the code that guards windings.
"""

import math

import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from leactl.model.derived_quantities import continuous_torques, electrical, motor_constant, network_current
from leactl.model.flexures import bearings_of, disagreement, readings
from leactl.model.motor import load_motor, load_sheet
from leactl.report.motor_comparison import OperatingConditions, compared_motor, comparison_json

LEA, U8, MAXON = (load_sheet(name)[0] for name in ("lea", "u8-kv100", "ec-4pole-30"))
AMBIENT, LIMIT = 25.0, 130.0


def outwards(thermal):
    """Resistance from winding to ambient at the end [K/W]; a path that is not printed is not there."""
    straight = thermal.winding_ambient_resistance
    conductance = 1.0 / (thermal.winding_housing_resistance + thermal.housing_ambient_resistance)
    return 1.0 / (conductance + (1.0 / straight if straight else 0.0))


def continuous(motor, cold, coefficient):
    """Current that takes the winding to 130 degC for ever [A]."""
    hot = cold * (1.0 + coefficient * (LIMIT - AMBIENT))
    return math.sqrt((LIMIT - AMBIENT) / (outwards(motor.thermal) * hot))


def for_20_s(motor, coefficient):
    """Current that takes the winding from ambient to 130 degC in 20 s [A], all phases alike."""
    net = motor.thermal

    def last(current):
        def rates(_, rise):
            across = (rise[0] - rise[1]) / net.winding_housing_resistance
            heat = motor.phase_resistance * (1.0 + coefficient * rise[0]) * current**2
            winding = heat - rise[0] / net.winding_ambient_resistance - across
            housing = across - rise[1] / net.housing_ambient_resistance
            return [winding / net.winding_capacitance, housing / net.housing_capacitance]

        return solve_ivp(rates, (0.0, 20.0), [0.0, 0.0], rtol=1e-8).y[0, -1]

    return brentq(lambda current: last(current) - (LIMIT - AMBIENT), 5.0, 60.0)


def test_alpha_is_4e_3_per_kelvin_not_4e_4_per_second():
    assert continuous(LEA, LEA.phase_resistance, 4e-3) == pytest.approx(13.8, abs=0.05)
    assert continuous(LEA, LEA.phase_resistance, 4e-4) == pytest.approx(16.1, abs=0.05)
    assert LEA.continuous_current == 13.7
    assert (LEA.resistance_coefficient, LEA.printed.resistance_coefficient) == (4e-3, 4e-4)
    assert network_current(LEA, AMBIENT) == pytest.approx(continuous(LEA, LEA.phase_resistance, 4e-3))


def test_20_s_torque_by_the_network_is_15_7_and_not_16_3():
    """Both printed torques are 1.036 to 1.04 times what the network and the torque constant give."""
    peak = LEA.torque_constant * for_20_s(LEA, 4e-3)
    assert peak == pytest.approx(15.7, abs=0.1)
    carried = compared_motor("lea", OperatingConditions()).currents
    assert LEA.torque_constant * carried.peaks[0] == pytest.approx(peak, rel=0.01)
    assert carried.standing_peaks[0] < 0.75 * carried.peaks[0]  # one phase takes two thirds of the heat
    assert LEA.printed.peak_torque_20_s / peak == pytest.approx(1.036, abs=0.005)
    nominal = LEA.torque_constant * continuous(LEA, LEA.phase_resistance, 4e-3)
    assert LEA.printed.nominal_torque / nominal == pytest.approx(1.036, abs=0.005)


def test_torque_density_is_7_51_by_the_printed_current():
    assert continuous_torques(LEA, AMBIENT).stated_density == pytest.approx(13.7 * 0.49 / 0.894)
    assert continuous_torques(LEA, AMBIENT).stated_density == pytest.approx(7.51, abs=0.005)
    better = continuous_torques(LEA, AMBIENT).stated_density / continuous_torques(U8, AMBIENT).stated_density
    assert better == pytest.approx(1.705, abs=0.015)  # the printed 70.5 %


def test_rotor_inertia_of_the_u8_is_0_12_g_m2_for_20_fold():
    assert LEA.rotor_inertia / U8.rotor_inertia == pytest.approx(20.0)
    assert LEA.rotor_inertia / U8.printed.rotor_inertia == pytest.approx(200.0)


def test_u8_row_is_in_the_deltas_own_frame():
    """186 mohm between the leads are 3/2 of it in the delta's frame: motor constant and 7.6 A as printed."""
    meter = electrical(U8).line_to_line()
    assert meter.resistance == pytest.approx(0.186)
    assert meter.inductance == pytest.approx(138e-6)
    assert motor_constant(U8) == pytest.approx(U8.printed.motor_constant, abs=0.006)
    assert U8.torque_constant / math.sqrt(0.186 / 2.0) == pytest.approx(0.46, abs=0.005)
    assert continuous(U8, U8.phase_resistance, 4e-3) == pytest.approx(U8.continuous_current, abs=0.02)
    assert continuous(U8, 0.186 / 2.0, 4e-3) > 13.0


def test_delta_and_wye_torque_constants_are_not_to_be_compared():
    """Printed 3.5 fold; what an ampere in the leads makes is 6 fold."""
    assert LEA.torque_constant / U8.torque_constant == pytest.approx(3.5)
    assert electrical(LEA).per_line_amplitude() / electrical(U8).per_line_amplitude() == pytest.approx(6.06, abs=0.01)
    rows = {
        row["name"]: row
        for row in comparison_json(
            [compared_motor("lea", OperatingConditions()), compared_motor("u8-kv100", OperatingConditions())]
        )["rows"]
    }
    assert rows["torque_constant"]["depends_on_frame"]
    assert not rows["continuous_torque"]["depends_on_frame"]
    assert rows["continuous_torque"]["values"] == [pytest.approx(6.713), pytest.approx(1.064)]


def test_ec_4pole_motor_constant_needs_the_full_terminal_resistance():
    assert motor_constant(MAXON) == pytest.approx(0.062, abs=0.0005)
    whole = MAXON.torque_constant / math.sqrt(electrical(MAXON).line_to_line().resistance)
    assert whole == pytest.approx(MAXON.printed.motor_constant, abs=0.005)


def test_ec_4pole_network_carries_9_6_a_and_not_5_1():
    assert continuous(MAXON, MAXON.phase_resistance, 4e-3) == pytest.approx(9.6, abs=0.05)
    assert continuous(MAXON, 2.0 * MAXON.phase_resistance, 4e-3) == pytest.approx(6.8, abs=0.05)
    assert MAXON.continuous_current == 5.1
    told = MAXON.model_copy(
        update={
            "resistance_coefficient": 4e-3,
            "reference_temperature": AMBIENT,
            "limits": LEA.limits,
        }
    )
    assert network_current(told, AMBIENT) == pytest.approx(9.6, abs=0.05)


def test_two_capacitances_in_joule_per_kelvin():
    """A third is named where two exist, and they are printed in W/(K/s), and in s in the table.

    Taken as J/K the winding follows 9 A through two leads with a time constant of seconds and the housing with one of
    a quarter of an hour, which is why the paper's 75 minutes reach a steady state; taken as seconds neither would fit.
    """
    thermal = load_motor("lea")[0].thermal
    assert {name for name in type(thermal).model_fields if name.endswith("capacitance")} == {
        "winding_capacitance",
        "housing_capacitance",
    }
    assert thermal.winding_capacitance * thermal.winding_housing_resistance == pytest.approx(6.9, abs=0.05)
    slow = (thermal.winding_capacitance + thermal.housing_capacitance) * outwards(thermal)
    assert 5.0 < 75 * 60 / slow < 7.0  # after five time constants less than 1 % is left


def test_overshoot_is_8_3_percent_and_settling_90_ms():
    """The text lists rise, settling, overshoot and then 1 ms, 8.3 %, 90 ms; a percentage is no settling time."""
    step = LEA.control.current
    assert (step.rise_time, step.overshoot_percent, step.settling_time) == (0.001, 8.3, 0.090)


def test_138_n_at_0_75_mm_agrees_with_300_n_at_0_5_mm_only_beyond_a_gap_of_0_5_mm():
    bearings = bearings_of(LEA)
    off = disagreement(bearings, readings(bearings, 0.5e-3))
    for name, miss in off.items():
        assert (abs(miss) < 0.1) == ("beyond the gap at rest" in name), name
    assert abs(off["told preload, gap is deflection"]) > 0.6


def test_driving_efficiency_above_75_percent_is_out_of_reach():
    """Over the printed grid, cold and without any other loss, 69.5 % is the most: b w^2 and f w alone take the rest."""
    b, f, kt, r = LEA.viscous_damping, LEA.coulomb_friction, LEA.torque_constant, LEA.phase_resistance
    best = 0.0
    for n in range(1, 13):
        speed = 2.618 * n
        for k in range(1, 2000):
            load = 0.005 * k
            current = (load + b * speed + f) / kt
            best = max(best, load * speed / (r * current**2 + kt * current * speed))
    assert best == pytest.approx(0.695, abs=0.005)


def test_negative_efficiency_begins_at_a_slope_of_0_93_cold_and_0_66_hot():
    """Where the driven winding's heat takes all that comes in: Kt i w = R i^2, so torque over speed is Kt^2 / R + b."""
    slopes = [
        LEA.torque_constant**2 / (LEA.phase_resistance * (1.0 + 4e-3 * rise)) + LEA.viscous_damping
        for rise in (0.0, LIMIT - AMBIENT)
    ]
    assert slopes == [pytest.approx(0.93, abs=0.005), pytest.approx(0.66, abs=0.01)]
    assert min(slopes) > 0.5  # as printed
