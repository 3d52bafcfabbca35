"""Motor files that leave things out: what they are good for, and what refuses them."""

import pytest

from leactl import yamlfile
from leactl.bench import benchfile
from leactl.errors import InputError
from leactl.model.derived_quantities import continuous_torques, motor_constant, network_current, no_load_speed
from leactl.model.motor import load_motor, load_sheet, motor_names
from leactl.model.motor_schema import MotorSheet
from leactl.model.nominal import Model
from leactl.runner.thermal_admission import Windings

SPARSE = "name: mine\nwinding: delta\ntorque_constant: 0.1\n"


def test_what_the_print_leaves_out_is_missing():
    maxon = load_sheet("ec-4pole-30")[0]
    assert maxon.missing("coulomb_friction", "resistance_coefficient", "torque_constant") == [
        "coulomb_friction",
        "resistance_coefficient",
    ]
    assert maxon.thermal.winding_ambient_resistance is None
    assert maxon.limits.winding_temperature is None
    assert network_current(maxon, 25.0) is None
    assert load_sheet("u8-kv100")[0].tolerances is None


def test_a_motor_that_lacks_figures_is_not_moved_and_every_one_is_named():
    with pytest.raises(InputError) as caught:
        load_motor("ec-4pole-30")
    lacking = " ".join(caught.value.faults)
    for name in ("coulomb_friction", "resistance_coefficient", "thermal.winding_ambient_resistance", "limits"):
        assert name in lacking
    assert all("is required and missing" in fault for fault in caught.value.faults)


@pytest.mark.parametrize(
    ("motor", "message"), [("ec-4pole-30", "is required and missing"), ("u8-kv100", "no `tolerances:`")]
)
def test_the_guard_refuses_a_bench_with_such_a_motor(motor, message):
    file, devices, _ = benchfile.load("emulated")
    with pytest.raises(InputError, match=message):
        Windings(file.model_copy(update={"motors": {"test": motor}}), devices)


@pytest.mark.parametrize("name", motor_names())
def test_a_shipped_motor_can_be_read_as_a_sheet(name):
    sheet, document = load_sheet(name)
    assert sheet.name == name
    assert yamlfile.parse(document.text).validate(MotorSheet) == sheet


def test_the_bench_file_still_tells_a_nominal_model():
    file, _, _ = benchfile.load("emulated")
    model = yamlfile.parse(benchfile.nominal_model(file)).validate(Model)
    assert (model.body.mass, model.bench.bus_voltage) == (0.894, 29.6)


def test_little_is_enough_for_a_sheet(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(SPARSE)
    sheet = load_sheet(str(path))[0]
    assert motor_constant(sheet) is None
    assert continuous_torques(sheet, 25.0).stated is None


def test_the_no_load_speed_is_that_of_a_motor_that_carries_its_own_friction():
    lea, u8, maxon = (load_sheet(name)[0] for name in ("lea", "u8-kv100", "ec-4pole-30"))
    # wye: 29.6 / sqrt(2) V; (20.930 - 0.264 * 0.208 / 0.49) / (0.49 + 0.264 * 0.0238 / 0.49) rad/s
    assert no_load_speed(lea, 29.6) == pytest.approx(41.403, abs=1e-3)
    # delta: 29.6 * sqrt(3/2) V; (36.252 - 0.279 * 0.017 / 0.14) / (0.14 + 0.279 * 0.0002 / 0.14) rad/s
    assert no_load_speed(u8, 29.6) == pytest.approx(257.97, abs=1e-2)
    # the same in the frame of its wye: a third of R, sqrt(3) less Kt, the same friction and speed
    seen = {"winding": "wye", "phase_resistance": 0.279 / 3, "torque_constant": 0.14 / 3**0.5}
    as_wye = u8.model_copy(update=seen | {"back_emf_constant": 0.14 / 3**0.5})
    assert no_load_speed(as_wye, 29.6) == pytest.approx(no_load_speed(u8, 29.6))
    # its Coulomb friction is not known: 29.6 / sqrt(2) V over 0.02 V*s/rad
    assert no_load_speed(maxon, 29.6) == pytest.approx(1046.5, abs=0.1)
    assert no_load_speed(lea, 0.1) == 0.0  # 0.14 A do not break 0.208 N*m loose


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SPARSE + "body: {mass: -1}\n", "body.mass: -1: "),
        (SPARSE + "body: {mass: 894, outer_diameter: 0.182, length: 0.04}\n", "mass 894 in the room of its diameter"),
        (
            SPARSE + "body: {outer_diameter: 182}\n",
            "body.outer_diameter: 182: at most ",
        ),
        ("name: ''\nwinding: wye\n", "name: '': "),
        (SPARSE + "body: {weight: 1}\n", "body.weight: 1: unknown key; one of mass"),
        (SPARSE + "thermal: {winding_capacitance: 0}\n", "thermal.winding_capacitance: 0: "),
        (SPARSE + "encoder_lines: 0.5\n", "encoder_lines: 0.5: "),
        (SPARSE + "bearings: {each_side: 12}\n", "bearings.static_radial_load: is required and missing"),
        ("name: mine\n", "winding: is required and missing"),
    ],
)
def test_faults_of_a_sheet_name_their_place(tmp_path, text, message):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_sheet(str(path))
    assert any(message in fault and fault.startswith(str(path)) for fault in caught.value.faults), caught.value.faults
