"""Motor files: what the LEA's says, and what is refused where."""

import pytest

from leactl.errors import InputError
from leactl.model.motor import load_motor, motor_names


def test_the_lea_ships_with_the_papers_figures():
    assert "lea" in motor_names()
    motor, document = load_motor("lea")
    assert motor.motor_constant == pytest.approx(0.95, abs=0.005)
    assert motor.resistance(130.0) == pytest.approx(0.264 * 1.42)
    assert "phase_resistance: 0.264 " in document.text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("pole_pairs: 41", "pole_pairs: 41.5", "lea.yaml:3:13  pole_pairs: 41.5"),
        ("torque_constant: 0.49 ", "torque_constant: -1 ", "torque_constant: -1: input should be greater than 0"),
        ("winding: wye", "winding: star", "'star': input should be 'wye' or 'delta'"),
        ("  winding_capacitance: 22.9 ", "  winding_capacity: 22.9 ", "thermal.winding_capacity: unknown key"),
        ("rotor_inertia: 0.0024 ", "rotor_inertia: .nan ", "a finite number was expected"),
        ("  phase_resistance: 0.1\n", "  phase_resistance: -0.1\n", "tolerances.phase_resistance: -0.1: "),
        ("  winding_capacitance: 0.1\n", "  winding_capacitance: 0.51\n", "tolerances.winding_capacitance: 0.51: "),
        ("  coulomb_friction: 0.1\n", "  coulomb_friction: .nan\n", "tolerances.coulomb_friction"),
        ("  housing_capacitance: 0.1\n", "", "tolerances.housing_capacitance"),
        (
            "rotor_inertia: 0.0024 ",
            "rotor_inertia: 2.4 ",
            "rotor_inertia: 2.4 is more than all of the body's mass has at its rim, 0.0074",
        ),
        (
            "inner_diameter: 0.138",
            "inner_diameter: 0.238",
            "inner_diameter 0.238 m is not below outer_diameter 0.182",
        ),
        ("  ambient_K: 3.0", "  ambient_K: 298", "tolerances.ambient_K: 298: "),
        (
            "phase_resistance: 0.264 ",
            "phase_resistance: true ",
            "phase_resistance: True: input should be a valid number",
        ),
        ("pole_pairs: 41", "pole_pairs: true", "pole_pairs: True: input should be a valid integer"),
        (
            "rotor_inertia: 0.0024 ",
            "rotor_inertia: '0.0024' ",
            "rotor_inertia: '0.0024': input should be a valid number",
        ),
    ],
)
def test_faults_name_their_place(tmp_path, old, new, message):
    _motor, document = load_motor("lea")
    assert old in document.text
    path = tmp_path / "lea.yaml"
    path.write_text(document.text.replace(old, new))
    with pytest.raises(InputError) as caught:
        load_motor(str(path))
    assert any(message in fault for fault in caught.value.faults), caught.value.faults


def test_an_unknown_motor_lists_the_known():
    with pytest.raises(InputError, match=r"known: .*lea"):
        load_motor("leaa")
