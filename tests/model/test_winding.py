"""Wye and delta against three phases: networks solved node by node, voltages and currents summed instant by instant."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.model.winding import FRAMES, Electrical, LineToLine, voltage_ceiling

TURN = 2.0 * np.pi * np.arange(360) / 360
SHIFTS = (0.0, -2.0 * np.pi / 3.0, 2.0 * np.pi / 3.0)
SPEED = 3.0  # rad/s, mechanical
sizes = st.floats(1e-4, 1e3)


def between_leads(winding, ohm):
    """Resistance between two of the three leads, by Kirchhoff's current law at every node."""
    nodes = 4 if winding == "wye" else 3
    branches = [(0, 3), (1, 3), (2, 3)] if winding == "wye" else [(0, 1), (1, 2), (2, 0)]
    conductance = np.zeros((nodes, nodes))
    for i, k in branches:
        conductance[[i, k], [i, k]] += 1.0 / ohm
        conductance[[i, k], [k, i]] -= 1.0 / ohm
    current = np.zeros(nodes)
    current[0], current[1] = 1.0, -1.0
    volts = np.linalg.pinv(conductance) @ current
    return volts[0] - volts[1]


def phases(winding, emf_amplitude, line_amplitude):
    """Back-EMF and current of each phase, in phase with each other, and the line-to-line voltage's amplitude."""
    emf = np.array([emf_amplitude * np.cos(TURN + shift) for shift in SHIFTS])
    if winding == "wye":
        current = np.array([line_amplitude * np.cos(TURN + shift) for shift in SHIFTS])
        return emf, current, np.abs(emf[0] - emf[1]).max()
    # what flows in a lead is the difference of the two phases that meet there
    unit = np.array([np.cos(TURN + shift) for shift in SHIFTS])
    current = unit * line_amplitude / np.abs(unit[0] - unit[1]).max()
    assert np.abs(current[0] - current[1]).max() == pytest.approx(line_amplitude)
    return emf, current, np.abs(emf[0]).max()


@pytest.mark.parametrize("winding", FRAMES)
def test_the_phase_resistance_follows_from_what_a_meter_reads(winding):
    meter = LineToLine(between_leads(winding, 0.264), None, None)
    assert meter.q_axis(winding).resistance == pytest.approx(0.264)


@pytest.mark.parametrize("winding", FRAMES)
def test_torque_and_heat_are_those_of_three_phases(winding):
    emf, current, line_to_line = phases(winding, 1.7, 9.0)
    q = LineToLine(between_leads(winding, 0.3), None, line_to_line / SPEED).q_axis(winding)
    i = FRAMES[winding].current * 9.0
    torque = np.mean(np.sum(emf * current, axis=0)) / SPEED
    assert q.torque_constant * i == pytest.approx(torque, rel=1e-4)
    assert q.per_line_amplitude() * 9.0 == pytest.approx(torque, rel=1e-4)
    assert q.resistance * i**2 == pytest.approx(np.mean(np.sum(0.3 * current**2, axis=0)), rel=1e-4)


@pytest.mark.parametrize("winding", FRAMES)
def test_the_bus_is_what_two_leads_can_differ_by(winding):
    emf, current, line_to_line = phases(winding, 29.6 if winding == "delta" else 29.6 / math.sqrt(3.0), 2.0)
    assert line_to_line == pytest.approx(29.6, rel=1e-4)
    power = np.mean(np.sum(emf * current, axis=0))
    assert voltage_ceiling(29.6, winding) * FRAMES[winding].current * 2.0 == pytest.approx(power, rel=1e-4)


@given(
    winding=st.sampled_from(sorted(FRAMES)), other=st.sampled_from(sorted(FRAMES)), r=sizes, inductance=sizes, kt=sizes
)
def test_what_is_seen_at_the_leads_is_the_same_in_every_frame(winding, other, r, inductance, kt):
    own = Electrical(winding, r, inductance, kt)
    seen = own.seen_as(other)
    assert seen.torque_constant / math.sqrt(seen.resistance) == pytest.approx(kt / math.sqrt(r))
    assert seen.resistance / seen.inductance == pytest.approx(r / inductance)
    assert seen.per_line_amplitude() == pytest.approx(own.per_line_amplitude())
    back = seen.seen_as(winding)
    assert (back.resistance, back.torque_constant) == (pytest.approx(r), pytest.approx(kt))


def test_what_is_not_known_stays_so():
    assert Electrical("delta", None, None, 0.14).seen_as("wye") == Electrical(
        "wye", None, None, pytest.approx(0.14 / math.sqrt(3.0))
    )
