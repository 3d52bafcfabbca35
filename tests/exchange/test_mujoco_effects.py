"""Callbacks against the effect library: the same torque, friction and current at the same state."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from leactl.effects.plant import Moment
from leactl.exchange.destinations import ACTS_ON, CURRENT
from leactl.gap.replay.bench_of_model import plant_of
from leactl.gap.replay.drive import response_over_steps
from leactl.model.nominal import Model
from leactl.vocabulary.effect import effect_definition, effect_names
from tests.exchange.robots import MOTOR, chain, leg

mujoco = pytest.importorskip("mujoco", reason="callbacks are MuJoCo's")
effects_of_a_joint = pytest.importorskip("leactl.exchange.mujoco_effects")

FRICTION, DAMPING, CONSTANT, STEP = 0.2, 0.05, 1.8, 0.0005
PARAMETERS = {
    "asymmetric_friction": {"asymmetry": 0.3},
    "cogging": {"amplitude": 0.3, "order": 7.0, "phase": 0.4},
    "command_slew_limit": {"rate": 60.0},
    "current_sensor_gain": {"gain": 1.1},
    "current_sensor_offset": {"offset": 0.2},
    "friction_run_in": {"excess": 0.5, "time_constant": 0.3},
    "gravity_load": {"amplitude": 0.7, "phase": 0.3},
    "load_dependent_friction": {"coefficient": 0.1},
    "position_dependent_friction": {"amplitude": 0.4, "order": 3.0, "phase": -0.7},
    "position_spring": {"stiffness": 0.8, "rest_angle": 0.2, "reach": 0.9},
    "power_foldback": {"power": 4.0},
    "quadratic_drag": {"coefficient": 0.02},
    "saturation": {"loss": 0.2, "exponent": 2.0, "current": 4.0},
    "stribeck": {"breakaway_ratio": 0.6, "stribeck_velocity": 0.4, "shape": 2.0},
    "torque_limit": {"current": 1.5},
    "torque_ripple": {"amplitude": 0.1, "order": 6.0, "phase": 1.0},
    "transport_delay": {"delay": 0.0037},
    "unbalance": {"amplitude": 0.5, "phase": -0.2},
    "voltage_limit": {"stall_current": 3.0, "no_load_speed": 3.0},
}
IN_MOTION = ("dead_time", "presliding", "reference_rate_limit", "servo_dead_band")  # see test_round_trip
READINGS = ("encoder_eccentricity", "transmission_error")


def test_every_effect_that_callbacks_hold_is_held_against_the_library():
    assert set(ACTS_ON) == {*PARAMETERS, *IN_MOTION, *READINGS}
    assert set(ACTS_ON) <= set(effect_names())
    for name, values in PARAMETERS.items():
        assert set(values) <= set(effect_definition(name).parameters)


@pytest.fixture
def joint(tmp_path):
    return mujoco.MjModel.from_xml_path(str(leg(tmp_path, MOTOR)))


def acting(joint, *names, loop=0.0, **drive):
    at = {"gear": CONSTANT, "per_ctrl": 1.0, "torque_constant": CONSTANT, "loop_bandwidth": loop, "limits_itself": True}
    entries = [{"effect": name, "parameters": PARAMETERS[name]} for name in names]
    figures = {"coulomb_friction": FRICTION, "viscous_damping": DAMPING, "gear_ratio": 9.0, "effects": entries}
    return effects_of_a_joint.JointEffects(joint, {"joint": "knee", "drive": at | drive, **figures})


def library(*names):
    entries = [{"effect": name, "parameters": PARAMETERS[name]} for name in names]
    return plant_of(
        Model(name="knee", torque_constant=CONSTANT, gear_ratio=9.0, coulomb_friction=FRICTION, effects=entries)
    )


def stepped(effects, joint, angle, speed, asked, time=0.0):
    """Torque beside the motor's, friction, and torque of the motor, at a state."""
    state = mujoco.MjData(joint)
    state.qpos[0], state.qvel[0], state.ctrl[0], state.time = angle, speed, asked, time
    effects.step(state)
    return float(state.qfrc_passive[0]), effects.friction, effects.drive_torque


OF_A_MOMENT = [name for name in PARAMETERS if ACTS_ON[name] == "joint"] + ["torque_ripple", "load_dependent_friction"]


@pytest.mark.parametrize("name", [*OF_A_MOMENT, "all"])
def test_torques_and_friction_are_the_library_s(joint, name):
    names = OF_A_MOMENT if name == "all" else [name]
    plant, random = library(*names), np.random.default_rng(5)
    for _ in range(50):
        angle, speed, asked = random.uniform(-2.0, 2.0), random.uniform(-1.0, 1.0), random.uniform(-4.0, 4.0)
        time = random.uniform(0.0, 1.0)
        beside, friction, drive = stepped(acting(joint, *names), joint, angle, speed, asked, time)
        one = (np.array([value]) for value in (angle, speed, drive, drive))
        moment = Moment(*one)
        course = SimpleNamespace(time=np.array([time]))
        more = math.prod(float(share(course)[0]) for share in plant.friction_share)
        expected = sum(drive * float(ripple(moment)[0]) for ripple in plant.ripple)
        expected += sum(float(torque(moment)[0]) for torque in plant.rotor_torque)
        expected -= sum(float(drag(moment)[0]) for drag in plant.drag) + (more - 1.0) * DAMPING * speed
        level = FRICTION * more + sum(float(added(moment)[0]) for added in plant.coulomb_added)
        level *= math.prod(float(share(moment)[0]) for share in plant.coulomb_share)
        assert drive == pytest.approx(CONSTANT * asked)
        assert beside == pytest.approx(expected, abs=1e-12)
        assert friction == pytest.approx(level)


OF_A_CURRENT = [name for name in ACTS_ON if ACTS_ON[name] == CURRENT] + ["saturation", "transport_delay"]


@pytest.mark.parametrize("names", [*([name] for name in OF_A_CURRENT), OF_A_CURRENT], ids=str)
@pytest.mark.parametrize("loop", [0.0, 90.0])
def test_the_torque_of_a_current_is_what_a_replay_makes_of_its_reference(joint, names, loop):
    plant, random = library(*names), np.random.default_rng(7)
    asked = np.clip(np.repeat(np.cumsum(random.normal(0.0, 1.0, 40)), 10), -4.0, 4.0)
    speeds = 2.0 * np.sin(0.02 * np.arange(len(asked)))
    effects = acting(joint, *names, loop=loop)
    made = [
        stepped(effects, joint, 0.0, speed, value, index * STEP)[2]
        for index, (value, speed) in enumerate(zip(asked, speeds, strict=True))
    ]
    over = asked.copy()
    for becomes in plant.command:
        over = becomes(over, STEP)
    for becomes_at in plant.command_at_speed:
        over = becomes_at(over, speeds)
    _, flowing = response_over_steps(over, over[0], loop, STEP)
    for becomes in plant.loop_answer:
        flowing = becomes(flowing, STEP)
    flowing = (flowing - plant.current_offset) / plant.current_gain
    expected = CONSTANT * flowing * math.prod(share(flowing) for share in plant.torque_share)
    assert made == pytest.approx(expected.tolist(), abs=2e-3 * CONSTANT)


def test_an_instant_that_comes_twice_counts_once_and_a_clock_that_goes_back_begins_anew(joint):
    once, twice = (acting(joint, "command_slew_limit", "transport_delay") for _ in range(2))
    torques = []
    for index in range(40):
        torques.append(stepped(once, joint, 0.0, 0.0, 3.0 * (index > 3), index * STEP)[2])
        stepped(twice, joint, 0.0, 0.0, -4.0, index * STEP)  # as mj_forward before a step
        assert stepped(twice, joint, 0.0, 0.0, 3.0 * (index > 3), index * STEP)[2] == pytest.approx(torques[-1])
    assert torques[-1] > 1.0
    assert stepped(once, joint, 0.0, 0.0, 0.0, 0.0)[2] == 0.0


@pytest.mark.parametrize("name", READINGS)
def test_the_encoder_reads_with_its_errors(joint, name):
    values = {"amplitude": 0.02, "phase": 0.3} | ({"order": 4.0} if name == "transmission_error" else {})
    figures = {"coulomb_friction": 0.0, "viscous_damping": 0.0, "gear_ratio": 1.0, "drive": None, "joint": "knee"}
    effects = effects_of_a_joint.JointEffects(joint, figures | {"effects": [{"effect": name, "parameters": values}]})
    plant = plant_of(Model(name="knee", effects=[{"effect": name, "parameters": values}]))
    state = mujoco.MjData(joint)
    state.qpos[0] = 0.7
    angle = np.array([0.7])
    assert effects.angle_reading(state) == pytest.approx(0.7 + float(plant.angle_error[0](angle)[0]))


def test_callbacks_of_several_joints_act_side_by_side_and_go_in_turn(joint):
    drag = {"effect": "quadratic_drag", "parameters": {"coefficient": 0.5}}
    figures = {"coulomb_friction": 0.1, "viscous_damping": 0.0, "gear_ratio": 1.0, "joint": "knee", "effects": [drag]}
    at = {"gear": 1.0, "per_ctrl": 1.0, "torque_constant": 2.0, "loop_bandwidth": 0.0, "limits_itself": True}
    state, other = mujoco.MjData(joint), mujoco.MjModel.from_xml_string("<mujoco/>")
    first = effects_of_a_joint.install(joint, figures | {"drive": None})
    second = effects_of_a_joint.install(joint, figures | {"drive": at})
    try:
        state.qvel[0], state.ctrl[0] = 1.0, 1.5
        mujoco.mj_forward(joint, state)
        assert float(state.qfrc_passive[0]) == pytest.approx(-2 * 0.5 - DAMPING)
        assert float(state.actuator_force[0]) == pytest.approx(3.0)
        mujoco.mj_step(other, mujoco.MjData(other))  # another model is left alone
    finally:
        second.remove()
        first.remove()
    mujoco.mj_forward(joint, state)
    assert float(state.qfrc_passive[0]) == pytest.approx(-DAMPING)
    assert float(state.actuator_force[0]) == pytest.approx(1.5)
    assert float(joint.dof_frictionloss[0]) == FRICTION
    assert mujoco.get_mjcb_passive() is None


def test_a_model_that_the_callbacks_do_not_fit_is_told_of(joint, tmp_path):
    figures = {"coulomb_friction": 0.0, "viscous_damping": 0.0, "gear_ratio": 1.0, "effects": []}
    with pytest.raises(ValueError, match="no joint 'ankle'"):
        effects_of_a_joint.JointEffects(joint, figures | {"joint": "ankle", "drive": None})
    bare = mujoco.MjModel.from_xml_path(str(leg(tmp_path, "", name="bare.xml")))
    with pytest.raises(ValueError, match="no actuator on joint 'knee'"):
        effects_of_a_joint.JointEffects(bare, figures | {"joint": "knee", "drive": {}})
    joint.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    with pytest.raises(ValueError, match="RK4"):
        effects_of_a_joint.JointEffects(joint, figures | {"joint": "knee", "drive": None})


def test_a_joint_of_a_floating_robot_is_found_by_its_own_addresses(tmp_path):
    more = '<actuator><motor joint="hip"/><motor joint="knee" gear="2"/></actuator>'
    robot = mujoco.MjModel.from_xml_path(str(chain(tmp_path, trunk="<freejoint/>", more=more)))
    spring = {"effect": "position_spring", "parameters": {"stiffness": 3.0, "rest_angle": 0.1, "reach": 5.0}}
    late = {"effect": "transport_delay", "parameters": {"delay": 0.01}}
    at = {"gear": 2.0, "per_ctrl": 1.0, "torque_constant": 2.0, "loop_bandwidth": 0.0, "limits_itself": False}
    figures = {"coulomb_friction": 0.3, "viscous_damping": 0.0, "gear_ratio": 1.0, "drive": at, "joint": "knee"}
    effects, state = effects_of_a_joint.install(robot, figures | {"effects": [spring, late]}), mujoco.MjData(robot)
    try:
        state.qpos[8], state.ctrl[:] = 0.1, (5.0, 7.0)  # seven numbers of the trunk, then hip and knee
        mujoco.mj_step(robot, state)
        assert np.flatnonzero(state.qfrc_passive).tolist() == []
        assert state.actuator_force.tolist() == [5.0, 7.0]  # what was asked for before a start counts as asked for long
        state.qpos[8], state.ctrl[1] = 1.1, 0.0
        mujoco.mj_step(robot, state)
        assert np.flatnonzero(state.qfrc_passive).tolist() == [7]
        assert state.actuator_force.tolist() == [5.0, 7.0]
        assert np.flatnonzero(robot.dof_frictionloss).tolist() == [7]
    finally:
        effects.remove()
    assert np.flatnonzero(robot.dof_frictionloss).tolist() == []
