"""What joints have and benches do not is named on drawn machines, whose simulators share no equation with it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from leactl.gap.diagnose import Case, diagnose
from leactl.gap.equations import equations
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.parameters import calibrated_parameters
from leactl.joints.machine import draw_machine
from leactl.joints.make import draw_runs
from tests.gap.drawn_machines import case_of, write_cases

ANGLE, VELOCITY = ("angle", "test"), ("velocity", "test")
LOGGED = ("current", "angle", "current_reference", "velocity")
JOINTS = [  # an effect, and the kind of machine that has it
    ("joint_elasticity", "exoskeleton"),
    ("gear_backlash", "geared_joint"),
    ("gear_backlash", "heavy_axis"),
    ("torque_limit", "geared_joint"),
    ("power_foldback", "wheel_motor"),
    ("position_spring", "spindle"),
    ("voltage_limit", "drone_motor"),
]
ONE_WAY = [6, 3]  # seeds
SHARES = [  # effect, parameter, what of the model it goes with, kind of machine, seed, and how near it is to the truth
    ("asymmetric_friction", "asymmetry", "coulomb_friction", "gimbal_motor", 4, 0.03),
    ("position_dependent_friction", "amplitude", "coulomb_friction", "exoskeleton", 4, 0.05),
    ("friction_run_in", "excess", "coulomb_friction", "spindle", 4, 0.1),
    ("joint_elasticity", "share", "rotor_inertia", "wheel_motor", 11, 0.03),
    ("gear_backlash", "share", "rotor_inertia", "geared_joint", 16, 0.05),
    ("encoder_eccentricity", "amplitude", "rotor_inertia", "gimbal_motor", 7, 0.01),
]
COARSE = {"rate": 1000.0, "count": 2.0 * np.pi / 16384}  # which hides a slow acceleration in its steps at that rate
QUICK = {"spindle": 21, "heavy_axis": 22}  # seeds of machines that turn back within a few samples of a slow log
PUSHED = [32, 42, 47]  # of which the search makes a saturation, a joint elasticity, and nothing
SLOW = {"seconds": 10.0, "count": 2.0 * np.pi / 8192}
COARSEST = {"rate": 250.0, "count": 2.0 * np.pi / 4096}
COARSER = {"rate": 1000.0, "count": 2.0 * np.pi / 8192}
DRAWN = {  # kind of machine, effects, seed, strength and what else is changed, by what a test calls the case
    **{f"{name} of {kind}": (kind, [name], 3, "plain", {}) for name, kind in JOINTS},
    **{f"one way {seed}": ("heavy_axis", ["asymmetric_friction"], seed, "faint", {}) for seed in ONE_WAY},
    **{f"share of {name}": (kind, [name], seed, "plain", {}) for name, _, _, kind, seed, _ in SHARES},
    "lightly damped": ("drone_motor", ["joint_elasticity"], 5, "plain", {}),
    "far from zero": ("gimbal_motor", ["position_spring"], 5, "plain", {}),
    "gear": ("geared_joint", [], 5, "plain", {}),
    "sound": ("drone_motor", [], 8, "plain", {}),
    "coarser with presliding": ("heavy_axis", ["presliding"], 6, "strong", COARSER),
    "coarser with gear_backlash": ("heavy_axis", ["gear_backlash"], 6, "strong", COARSER),
    **{f"pushed {seed}": ("heavy_axis", ["push_in_time"], seed, "strong", COARSEST) for seed in PUSHED},
    "coarse": ("heavy_axis", [], 6, "plain", COARSE),
    "coarse with presliding": ("heavy_axis", ["presliding"], 6, "strong", COARSE),
    **{f"quick {kind}": (kind, ["presliding"], seed, "plain", SLOW) for kind, seed in QUICK.items()},
    "between two values": ("drone_motor", ["power_foldback"], 6, "plain", {"rate": 250.0}),
}
SELDOM = {  # cases of long tests
    "gear_backlash of geared_joint",
    "voltage_limit of drone_motor",
    "one way 6",
    "pushed 47",
    "share of encoder_eccentricity",
    "joint_elasticity of exoskeleton",
    "torque_limit of geared_joint",
    "power_foldback of wheel_motor",
    "share of asymmetric_friction",
    "quick heavy_axis",
    "gear_backlash of heavy_axis",
    "lightly damped",
    "between two values",
    "one way 3",
    "share of position_dependent_friction",
    "share of friction_run_in",
    "share of joint_elasticity",
    "share of gear_backlash",
    "coarser with gear_backlash",
    "coarse with presliding",
    "coarser with presliding",
    "pushed 32",
    "pushed 42",
}
NUMBERS = {  # a parameter of each effect, and how near it is to the truth
    "joint_elasticity": ("frequency", 0.15),
    "gear_backlash": ("play", 0.2),
    "torque_limit": ("current", 0.05),
    "power_foldback": ("power", 0.1),
    "position_spring": ("stiffness", 0.3),
    "voltage_limit": ("no_load_speed", 0.05),
}


def drawn(kind, effects, seed, strength, changes):
    """A drawn machine with the channels that show an effect of its drive, and its runs."""
    machine = draw_machine(np.random.default_rng([seed, 0]), kind)
    machine = replace(machine, **{"channels": LOGGED, "sampling": True, "rate": 500.0, "seconds": 12.0, **changes})
    return machine, draw_runs(np.random.default_rng([seed, 1]), machine, effects, strength)


def often(by_name):
    """Parameters of a test by the case that it asks for; those of a case for long tests are long."""
    return [pytest.param(*words, marks=[pytest.mark.long] if name in SELDOM else []) for name, words in by_name.items()]


@pytest.fixture(scope="module")
def drawn_case(tmp_path_factory):
    """Gives the case of a name, and a run that has what is true of it."""
    made = {}

    def case(name):
        if name not in made:  # all that are asked for as often are simulated side by side
            folder = tmp_path_factory.mktemp("drawn")
            cases = {other: drawn(*words) for other, words in DRAWN.items() if (other in SELDOM) == (name in SELDOM)}
            write_cases(folder, cases)
            made.update({other: (case_of(folder / other), own[1][0]) for other, own in cases.items()})
        return made[name]

    return case


def named(found):
    return [cause.effect for cause in found.causes if cause.probability >= 0.5]


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("exoskeleton", 2),
        *(pytest.param(*drawn, marks=pytest.mark.long) for drawn in (("gimbal_motor", 2), ("drone_motor", 1))),
    ],
)
def test_a_limit_of_the_current_is_no_end_of_the_voltage(tmp_path, kind, seed):
    machine, runs = drawn(kind, ["torque_limit"], seed, "plain", {})
    write_cases(tmp_path, {"limited": (machine, runs)})
    diagnosis = diagnose(case_of(tmp_path / "limited"))
    assert named(diagnosis) == ["torque_limit"], "a voltage that ends far above every speed of the runs cuts off alike"
    assert diagnosis.causes[0].parameters[0].value == pytest.approx(
        runs[0].parameter("torque_limit", "current"), rel=0.01
    )


@pytest.mark.parametrize(("name", "kind"), often({f"{name} of {kind}": (name, kind) for name, kind in JOINTS}))
def test_what_a_joint_has_is_named_with_its_size(drawn_case, name, kind):
    case, run = drawn_case(f"{name} of {kind}")
    diagnosis = diagnose(case)
    assert named(diagnosis) == [name]
    parameter, near = NUMBERS[name]
    told = {item.name: item for item in diagnosis.causes[0].parameters}
    assert told[parameter].value == pytest.approx(run.parameter(name, parameter), rel=near)
    assert told[parameter].std > 0.0


@pytest.mark.parametrize("kind", often({f"quick {kind}": (kind,) for kind in QUICK}))
def test_friction_that_builds_up_over_an_angle_shows_where_a_reversal_is_over_within_a_row(drawn_case, kind):
    case, run = drawn_case(f"quick {kind}")
    diagnosis = diagnose(case)
    assert named(diagnosis) == ["presliding"]
    (displacement,) = diagnosis.causes[0].parameters
    assert displacement.value == pytest.approx(run.parameter("presliding", "displacement"), rel=0.4)


@pytest.mark.long
def test_a_limit_between_two_values_of_the_grid_is_not_taken_for_one_that_is_near_its_value(drawn_case):
    case, run = drawn_case("between two values")
    diagnosis = diagnose(case)
    assert named(diagnosis) == ["power_foldback"]  # a `torque_limit` is nearer as long as only the winner is refined
    (power,) = [item.value for item in diagnosis.causes[0].parameters if item.name == "power"]
    assert power == pytest.approx(run.parameter("power_foldback", "power"), rel=0.1)


@pytest.mark.parametrize("seed", often({f"one way {seed}": (seed,) for seed in ONE_WAY}))
def test_a_torque_that_pulls_one_way_is_no_spring_whose_rest_no_run_comes_by(drawn_case, seed):
    case, _ = drawn_case(f"one way {seed}")
    classes = [{cause.effect, *cause.indistinguishable_from} for cause in diagnose(case).causes]
    assert classes
    for of_one in classes:
        assert of_one == {"asymmetric_friction", "current_sensor_offset"} or "asymmetric_friction" not in of_one


def test_a_gear_s_error_is_told_at_its_order(drawn_case):
    case, _ = drawn_case("gear")
    ratio, amplitude = 18.0, 0.004
    filtered = case.model.bench.velocity_filter_bandwidth
    wrong = [uneven(record, ratio, amplitude, filtered) for record in (*case.fitted, *case.held_out)]
    model = case.model.model_copy(update={"gear_ratio": ratio})
    diagnosis = diagnose(Case(model, wrong[: len(case.fitted)], wrong[len(case.fitted) :]))
    assert named(diagnosis)[0] == "transmission_error"
    told = {item.name: item.value for item in diagnosis.causes[0].parameters}
    assert told["order"] == ratio
    assert told["amplitude"] == pytest.approx(amplitude, rel=0.1)


def uneven(record, order, amplitude, bandwidth):
    """A record whose joint turns by a wave over its angle more than its motor; its velocity passes a filter [Hz]."""
    angle, speed, interval = record.fast.values[ANGLE], record.fast.values[VELOCITY], record.fast.interval
    wave = amplitude * np.sin(order * angle)
    steps = 2.0 * np.pi * bandwidth * interval
    decay, mean = np.exp(-steps), (1.0 - np.exp(-steps)) / steps  # of the filter over a sample; the wave goes straight
    lagged = lfilter([1.0 - mean, mean - decay], [1.0, -decay], np.gradient(wave, interval))
    changed = {ANGLE: angle + wave, VELOCITY: speed + lagged}
    return replace(record, fast=replace(record.fast, values=record.fast.values | changed))


def test_a_sound_machine_has_none_of_them(drawn_case):
    case, _ = drawn_case("sound")
    diagnosis = diagnose(case)
    assert diagnosis.verdict in ("none", "calibration")
    assert named(diagnosis) == []
    assert any("go by the model's torque_constant, which these runs cannot tell" in note for note in diagnosis.notes)


def test_a_spring_is_told_about_where_it_rests(drawn_case):
    case, run = drawn_case("far from zero")
    told = {item.name: item.value for item in diagnose(case).causes[0].parameters}
    rest = run.parameter("position_spring", "rest_angle")
    assert abs(rest) > 2.0
    assert told["rest_angle"] == pytest.approx(rest, abs=0.02)
    assert told["stiffness"] == pytest.approx(run.parameter("position_spring", "stiffness"), rel=0.03)


@pytest.mark.parametrize(
    ("name", "parameter", "base", "kind", "seed", "near"), often({f"share of {words[0]}": words for words in SHARES})
)
def test_what_goes_with_a_parameter_is_told_of_what_was_fitted(drawn_case, name, parameter, base, kind, seed, near):
    case, run = drawn_case(f"share of {name}")
    fitted_over_nominal = getattr(run.specimen, base) / getattr(case.model, base)
    assert abs(fitted_over_nominal - 1.0) > 2.0 * near, "the model file has to be off by more than what is asked for"
    cause = next(cause for cause in diagnose(case).causes if cause.effect == name)
    told = {item.name: item.value for item in cause.parameters}
    assert told[parameter] == pytest.approx(run.parameter(name, parameter), rel=near)


@pytest.mark.long
def test_a_load_that_swings_within_less_than_the_grid_of_frequencies_is_told_by_its_swing(drawn_case):
    case, run = drawn_case("lightly damped")
    cause = diagnose(case).causes[0]
    assert cause.effect == "joint_elasticity"
    fitted = {item.name: item.value for item in cause.parameters}
    for parameter, near in (("frequency", 0.003), ("damping_ratio", 0.05), ("share", 0.02)):
        assert fitted[parameter] == pytest.approx(run.parameter(cause.effect, parameter), rel=near)
    uncertainties = {item.name: item.std / item.value for item in cause.parameters}
    assert all(1e-5 < relative < 0.05 for relative in uncertainties.values())


def test_an_inertia_is_told_by_an_encoder_whose_steps_hide_the_acceleration(drawn_case):
    case, run = drawn_case("coarse")
    evidence = Evidence(case.fitted, case.model)
    told = {item.parameter: item.fitted for item in calibrated_parameters(evidence, evidence.settle([]))}
    ratio = run.specimen.rotor_inertia / run.specimen.torque_constant
    assert told["rotor_inertia"] / told["torque_constant"] == pytest.approx(ratio, rel=0.01)


@pytest.mark.parametrize(
    "how",
    often({how: (how,) for how in ("coarse with presliding", "coarser with presliding", "coarser with gear_backlash")}),
)
def test_an_effect_is_named_beside_such_an_encoder(drawn_case, how):
    case, _ = drawn_case(how)
    assert named(diagnose(case)) == [how.rpartition(" ")[2]]


@pytest.mark.parametrize("seed", often({f"pushed {seed}": (seed,) for seed in PUSHED}))
def test_a_push_in_time_beside_such_an_encoder_is_unknown(drawn_case, seed):
    case, _ = drawn_case(f"pushed {seed}")
    diagnosis = diagnose(case)
    assert (diagnosis.verdict, named(diagnosis)) == ("unknown", [])


@pytest.mark.parametrize("how", often({"coarser with presliding": ("coarser with presliding",)}))
def test_such_an_encoder_is_looked_at_at_a_lower_rate_and_the_current_at_its_own(drawn_case, how):
    case, _ = drawn_case(how)
    intervals = {
        equation.name: equation.signals.interval
        for equation in equations(case.fitted[0], case.model)
        if equation.name in ("current", "free_torque")
    }
    assert intervals["current"] == pytest.approx(1e-3)
    assert intervals["free_torque"] == pytest.approx(4e-3)
