"""Scaling by air-gap radius against a machine put together magnet by magnet and coil by coil."""

import math

import pytest

from leactl.errors import InputError
from leactl.model.motor import load_sheet
from leactl.model.scaling import scaled_figures

LEA, U8 = load_sheet("lea")[0], load_sheet("u8-kv100")[0]
SLOT_WIDTH, THICKNESS, DENSITY = 2e-3, 12e-3, 5000.0


def machine(radius):
    """Coils of equal width around a circle, each with the same force at one ampere, resistance and mass."""
    coils = 2.0 * math.pi * radius / SLOT_WIDTH
    ring = DENSITY * SLOT_WIDTH * THICKNESS * 13e-3
    return {
        "torque_constant": coils * 0.05 * radius,
        "phase_resistance": coils * 1e-3,
        "rotor_inertia": coils * ring * radius**2,
        "mass": coils * ring,
        "motor_constant": coils * 0.05 * radius / math.sqrt(coils * 1e-3),
    }


def test_each_figure_goes_by_its_power_of_the_radius():
    small, large = machine(0.04), machine(0.0825)
    known = U8.model_copy(
        update={
            **{name: small[name] for name in ("torque_constant", "phase_resistance", "rotor_inertia")},
            "body": U8.body.model_copy(update={"mass": small["mass"]}),
        }
    )
    results = {item.name: item.scaled for item in scaled_figures(known, 0.0825, 0.04)}
    for name, value in large.items():
        assert results[name] == pytest.approx(value), name


def test_the_lea_comes_out_near_its_own_figures_when_frames_agree():
    """Mid radii of the printed diameters: the U8's torque between the leads scales to 93 % of what the LEA has."""
    results = {item.name: item for item in scaled_figures(U8, 0.0825, (0.085 + 0.054) / 4.0)}
    ours = math.sqrt(1.5) * LEA.torque_constant
    assert results["torque_per_line_ampere"].scaled / ours == pytest.approx(0.93, abs=0.01)
    assert results["motor_constant"].scaled / 0.95 == pytest.approx(1.02, abs=0.01)
    assert results["torque_constant"].scaled / LEA.torque_constant > 1.5  # delta's ampere against wye's


def test_what_is_not_known_is_not_scaled():
    results = {
        item.name: item.scaled
        for item in scaled_figures(LEA.model_copy(update={"continuous_current": None}), 0.1, 0.08)
    }
    assert results["continuous_torque"] is None
    assert results["torque_density"] is None


@pytest.mark.parametrize(
    ("radius", "known", "message"),
    [
        (0.08, None, "'u8-kv100' has no air_gap_radius"),
        (0.0, 0.04, "air-gap radius 0 mm"),
        (80e-6, 0.04, "air-gap radius 0.08 mm: a length of 1 to 10000 mm was expected"),
        (0.08, -1.0, "of u8-kv100"),
    ],
)
def test_a_radius_that_is_missing_or_none_is_refused(radius, known, message):
    with pytest.raises(InputError, match=message):
        scaled_figures(U8, radius, known)
