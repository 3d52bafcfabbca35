"""Motor files: what the LEA's says, and what is refused where."""

import re

import pytest

from leactl.errors import InputError
from leactl.model.motor import load_motor, load_sheet, motor_names


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
        ("torque_constant: 0.49 ", "torque_constant: -1 ", "torque_constant: -1: more than 0 was expected"),
        ("winding: wye", "winding: star", "'star': 'wye' or 'delta'"),
        (
            "  winding_capacitance: 22.9 ",
            "  winding_capacity: 22.9 ",
            "thermal.winding_capacity: 22.9: unknown",
        ),
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
            "coulomb_friction: 0.208 ",
            "coulomb_friction: 208 ",
            "lea.yaml:12:19  coulomb_friction: 208 N*m is more than the most torque that the file's currents and"
            " printed torques give, 16.3 N*m; is it in N*m?",
        ),
        (
            "viscous_damping: 0.0238 ",
            "viscous_damping: 23.8 ",
            # 0.49^2 / 0.264
            "lea.yaml:11:18  viscous_damping: 23.8 N*m*s/rad is more than the shorted winding brakes with,"
            " 0.909 N*m*s/rad; is it in N*m*s/rad, and phase_resistance in ohm?",
        ),
        (
            "phase_inductance: 0.000128 ",
            "phase_inductance: 128 ",
            "phase_inductance: 128 H over 0.264 ohm is a time constant of 485 s, at most 1 s was expected; is it in H?",
        ),
        ("phase_resistance: 0.264 ", "phase_resistance: 2640 ", "phase_resistance: 2640 ohm: from 1e-05 to 1000"),
        ("phase_resistance: 0.264 ", "phase_resistance: 1e-6 ", "phase_resistance: 1e-06 ohm: from 1e-05 to 1000"),
        (
            "inner_diameter: 0.138",
            "inner_diameter: 0.238",
            "inner_diameter 0.238 m is not below outer_diameter 0.182",
        ),
        ("  ambient_K: 3.0", "  ambient_K: 298", "tolerances.ambient_K: 298: "),
        (
            "phase_resistance: 0.264 ",
            "phase_resistance: true ",
            "phase_resistance: true: a number was expected",
        ),
        ("pole_pairs: 41", "pole_pairs: true", "pole_pairs: true: a whole number was expected"),
        (
            "rotor_inertia: 0.0024 ",
            "rotor_inertia: '0.0024' ",
            "rotor_inertia: '0.0024': a number was expected",
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


@pytest.mark.parametrize(
    ("old", "new"),
    [("torque_constant: 0.49 ", "# "), ("continuous_current: 13.7 ", "# ")],
)
def test_friction_is_held_against_what_the_file_has(tmp_path, old, new):
    text = load_motor("lea")[1].text.replace("coulomb_friction: 0.208 ", "coulomb_friction: 208 ").replace(old, new)
    (tmp_path / "lea.yaml").write_text(text)
    with pytest.raises(InputError, match=r"coulomb_friction: 208 N\*m is more than"):
        load_sheet(str(tmp_path / "lea.yaml"))
    told = ("printed", "continuous_current", "limits", "  winding_temperature")
    bare = [line for line in text.splitlines() if not line.startswith(told)]
    (tmp_path / "lea.yaml").write_text("\n".join(bare))
    assert load_sheet(str(tmp_path / "lea.yaml"))[0].coulomb_friction == 208


@pytest.mark.parametrize("name", motor_names())
def test_the_figures_of_a_shipped_motor_in_milli_are_refused(tmp_path, name):
    """`motor show` prints friction in mN*m and mN*m*s/rad."""
    text = load_sheet(name)[1].text
    for key in ("viscous_damping", "coulomb_friction"):
        value = getattr(load_sheet(name)[0], key)
        if value is None:
            continue
        milli = re.sub(rf"^{key}: \S+", f"{key}: {1e3 * value:.6f}", text, flags=re.MULTILINE)
        (tmp_path / "milli.yaml").write_text(milli)
        with pytest.raises(InputError, match=f"{key}: {1e3 * value:g} .* is more than"):
            load_sheet(str(tmp_path / "milli.yaml"))
