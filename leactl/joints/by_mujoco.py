"""Simulate joints with MuJoCo: it simulates rotor, friction and elastic load; drive and effects are stepped here.

It shares no equation with `stepped`. MuJoCo comes with `pip install 'leactl[mujoco]'` (Apache-2.0).
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from leactl.errors import InputError
from leactl.joints.programs import SERVO_CORNER_HZ, SERVO_HZ
from leactl.joints.run import STEPS_PER_SAMPLE, JointRun, JointSignals

# the hardest dry friction of MuJoCo's solver, since a sticking bearing creeps with its default
HARD_FRICTION = 'solreffriction="{stiff:.9g} 1" solimpfriction="0.999 0.9999 0.001"'
JOINT = """\
<mujoco><compiler boundmass="0" boundinertia="0"/>
<option timestep="{step:.12g}" gravity="0 0 0" integrator="implicitfast"/>
<worldbody><body><joint name="rotor" type="hinge" axis="0 0 1" armature="{rotor:.9g}" damping="{damping:.9g}"
 frictionloss="{friction:.9g}" {hard}/><geom size=".01" mass="1e-9" contype="0" conaffinity="0"/>{load}</body>
{geared}</worldbody>{play}</mujoco>"""
LOAD = """<body><joint name="load" type="hinge" axis="0 0 1" stiffness="{stiffness:.9g}" damping="{damping:.9g}"/>
<inertial pos="0 0 0" mass="{inertia:.9g}" diaginertia="{inertia:.9g} {inertia:.9g} {inertia:.9g}"/></body>"""
GEARED = """<body><joint name="load" type="hinge" axis="0 0 1" armature="{inertia:.9g}" damping="0"
 frictionloss="0" {hard}/><geom size=".01" mass="1e-9" contype="0" conaffinity="0"/></body>"""
PLAY = """<tendon><fixed limited="true" range="-{half:.9g} {half:.9g}" solreflimit="{stiff:.9g} 1"
 solimplimit="0.999 0.9999 0.001"><joint joint="rotor" coef="1"/><joint joint="load" coef="-1"/></fixed></tendon>"""
BURST_SHARE = 0.6  # share of a sine's amplitude above which a burst of friction acts
MESH_STEPS = 2.0  # steps, time constant of the contact of teeth, the stiffest that MuJoCo allows
MUJOCO_MISSING = "simulator 'mujoco' needs MuJoCo: pip install 'leactl[mujoco]'"


def simulate(runs: Sequence[JointRun]) -> list[JointSignals]:
    """Return the signals of runs, simulated one after the other.

    Raises
    ------
    InputError : MuJoCo is not installed.
    """
    try:
        import mujoco
    except ImportError as fault:
        raise InputError(MUJOCO_MISSING) from fault
    return [_simulate(mujoco, run) for run in runs]


def model_text(run: JointRun) -> str:
    """Return the joint as the text of an MJCF model."""
    specimen, load, geared, play = run.specimen, "", "", ""
    load_share, rotor = run.parameter("joint_elasticity", "share"), specimen.rotor_inertia
    if load_share:
        angular_frequency = 2.0 * math.pi * run.parameter("joint_elasticity", "frequency")
        twice_damping_ratio = 2.0 * run.parameter("joint_elasticity", "damping_ratio")
        load_inertia = rotor * load_share
        load = LOAD.format(
            stiffness=load_inertia * angular_frequency**2,
            damping=twice_damping_ratio * load_inertia * angular_frequency,
            inertia=load_inertia,
        )
    step = 1.0 / specimen.machine.rate / STEPS_PER_SAMPLE
    hard = HARD_FRICTION.format(stiff=4.0 * step)
    if play_width := run.parameter("gear_backlash", "play"):
        load_share = run.parameter("gear_backlash", "share")
        geared = GEARED.format(inertia=rotor * load_share, hard=hard)
        play = PLAY.format(half=0.5 * play_width, stiff=MESH_STEPS * step)
    return JOINT.format(
        step=step,
        rotor=rotor * (1.0 - load_share),
        damping=specimen.viscous_damping,
        friction=0.0 if run.parameter("presliding", "displacement") else specimen.coulomb_friction,
        hard=hard,
        load=load,
        geared=geared,
        play=play,
    )


def _simulate(mujoco: Any, run: JointRun) -> JointSignals:
    """Return the signals of one run."""
    model = mujoco.MjModel.from_xml_string(model_text(run))
    state, drive, effects = mujoco.MjData(model), _Drive(run), _Effects(run)
    state.qpos[0] = run.angle
    has_gear, motor_share = effects.has_gear, 1.0 - effects.load_friction
    if has_gear:
        state.qpos[1] = run.angle
    rows = np.zeros((4, len(run.reference_or_zeros(None))))
    for index, (current, velocity) in enumerate(
        zip(
            run.reference_or_zeros(run.program.current).tolist(),
            run.reference_or_zeros(run.program.velocity).tolist(),
            strict=True,
        )
    ):
        reference = drive.reference(current, velocity)
        for substep in range(STEPS_PER_SAMPLE):
            drive_current = drive.step(reference, substep, state.qvel[0])
            angle, speed = state.qpos[0], state.qvel[0]
            damping = effects.damping(state.time)
            model.dof_frictionloss[0] = motor_share * effects.friction(angle, speed, state.time)
            model.dof_damping[0] = motor_share * damping
            state.qfrc_applied[0] = effects.torque(drive_current, angle, speed, state.time)
            if has_gear:
                model.dof_frictionloss[1] = effects.load_friction * effects.sliding_friction(angle, speed, state.time)
                model.dof_damping[1] = effects.load_friction * damping
                state.qfrc_applied[1] = -effects.load_torque(state.qpos[1])
            mujoco.mj_step(model, state)
            drive.read(state.qvel[0] * effects.encoder_slope(state.qpos[0]), substep)
        drive.previous_reference = reference
        rows[:, index] = reference, drive.mean_current, drive.logged_velocity, effects.encoder(state.qpos[0])
    return JointSignals(*rows)


class _Drive:
    """Velocity servo, current loop and velocity filter of one drive."""

    def __init__(self, run: JointRun) -> None:
        machine, step = run.specimen.machine, 1.0 / run.specimen.machine.rate / STEPS_PER_SAMPLE
        self._log, self._servo = run.log, run.program.velocity is not None
        self._proportional_gain = 2.0 * math.pi * SERVO_HZ * machine.rotor_inertia / machine.torque_constant
        self._integral_gain = 2.0 * math.pi * SERVO_CORNER_HZ / machine.rate
        self._peak_current = machine.current
        self._loop_gain = 1.0 - math.exp(-2.0 * math.pi * machine.loop * step)
        self._filter_gain = 1.0 - math.exp(-2.0 * math.pi * machine.filter * step)
        lag = run.parameter("velocity_filter_lag", "time_constant")
        self._lag_gain = 1.0 - math.exp(-step / lag) if lag else 1.0
        self._offset = run.parameter("current_sensor_offset", "offset")
        self._largest_change = run.parameter("command_slew_limit", "rate", math.inf) * step
        self._current_limit = run.parameter("torque_limit", "current", math.inf)
        self._stall_current = run.parameter("voltage_limit", "stall_current", math.inf)
        self._no_load_speed = run.parameter("voltage_limit", "no_load_speed", math.inf)
        self._power_limit = run.parameter("power_foldback", "power", math.inf) / run.specimen.torque_constant
        delay_steps = round(run.parameter("transport_delay", "delay") / step)
        self._delayed = deque([0.0] * delay_steps)
        self._commanded = self._current = self._velocity = self._lagged_velocity = self._current_sum = (
            self._integral
        ) = 0.0
        self.previous_reference = self.mean_current = self.logged_velocity = 0.0

    def reference(self, current: float, velocity: float) -> float:
        """Return the current reference for the next sample [A], of the velocity servo if it drives the run."""
        if not self._servo:
            return current
        error = velocity - self._lagged_velocity
        unlimited = self._proportional_gain * (error * (1.0 + self._integral_gain) + self._integral)
        if abs(unlimited) > self._peak_current:
            return math.copysign(self._peak_current, unlimited)
        self._integral += self._integral_gain * error
        return unlimited

    def step(self, reference: float, substep: int, speed: float) -> float:
        """Return the current [A] that flows in a step, after all limits of the command and the current loop."""
        if not self._log.holds:
            reference = (
                self.previous_reference + (reference - self.previous_reference) * (substep + 1) / STEPS_PER_SAMPLE
            )
        self._delayed.append(reference)
        command = self._delayed.popleft()
        largest_current = min(self._current_limit, self._power_limit / abs(speed)) if speed else self._current_limit
        command = max(min(command, largest_current), -largest_current)
        back_emf_share = speed / self._no_load_speed
        highest, lowest = (self._stall_current * (sign - back_emf_share) for sign in (1.0, -1.0))
        command = max(min(command, highest), lowest)
        self._commanded += max(min(command - self._commanded, self._largest_change), -self._largest_change)
        self._current += self._loop_gain * (self._commanded - (self._current + self._offset))
        self._current_sum += self._current + self._offset
        if substep == STEPS_PER_SAMPLE - 1 - self._log.current_late:
            self.mean_current, self._current_sum = self._current_sum / STEPS_PER_SAMPLE, 0.0
        return self._current

    def read(self, velocity: float, substep: int) -> None:
        """Filter the encoder's velocity [rad/s], and log it at the substep of the log."""
        self._velocity += self._filter_gain * (velocity - self._velocity)
        self._lagged_velocity += self._lag_gain * (self._velocity - self._lagged_velocity)
        if substep == STEPS_PER_SAMPLE - 1 - self._log.velocity_late:
            self.logged_velocity = self._lagged_velocity


class _Effects:
    """Torques and frictions in addition to MuJoCo's own."""

    def __init__(self, run: JointRun) -> None:
        self._run = run
        self._parameters = {drawn.name: drawn.parameters for drawn in run.effects}
        self.has_gear = "gear_backlash" in self._parameters
        self.load_friction = run.parameter("gear_backlash", "friction")
        self._bristle = 0.0  # rad, deflection of friction before it slides
        self._step = 1.0 / run.specimen.machine.rate / STEPS_PER_SAMPLE

    def torque(self, current: float, angle: float, speed: float, time: float) -> float:
        """Return the torque on the rotor [N*m]."""
        torque = self._run.specimen.torque_constant * current
        for name, parameters in self._parameters.items():
            if name == "saturation":
                torque *= 1.0 - parameters["loss"] * (current / parameters["current"]) ** 2
            elif name == "torque_ripple":
                torque *= 1.0 + parameters["amplitude"] * math.sin(parameters["order"] * angle + parameters["phase"])
        for name, parameters in self._parameters.items():
            if name == "cogging":
                torque += parameters["amplitude"] * math.sin(parameters["order"] * angle + parameters["phase"])
            elif name == "unbalance":
                torque += parameters["amplitude"] * math.sin(angle + parameters["phase"])
            elif name == "quadratic_drag":
                torque -= parameters["coefficient"] * speed * abs(speed)
            elif name == "push_in_time":
                torque += parameters["amplitude"] * math.sin(
                    2.0 * math.pi * parameters["frequency"] * time + parameters["phase"]
                )
            elif name == "presliding":
                reach = parameters["displacement"]
                self._bristle = max(min(self._bristle + speed * self._step, reach), -reach)
                torque -= (1.0 - self.load_friction) * self.sliding_friction(angle, speed, time) * self._bristle / reach
        return torque if self.has_gear else torque - self.load_torque(angle)

    def load_torque(self, angle: float) -> float:
        """Return the load torque [N*m] that opposes the joint at an angle, without friction."""
        torque = 0.0
        for name, parameters in self._parameters.items():
            if name == "gravity_load":
                torque += parameters["amplitude"] * math.cos(angle + parameters["phase"])
            elif name == "position_spring":
                torque += (
                    parameters["stiffness"]
                    * parameters["reach"]
                    * math.tanh((angle - parameters["rest_angle"]) / parameters["reach"])
                )
        return torque

    def friction(self, angle: float, speed: float, time: float) -> float:
        """Return the dry friction of MuJoCo's joint [N*m]; zero with presliding, whose friction is part of `torque`."""
        return 0.0 if "presliding" in self._parameters else self.sliding_friction(angle, speed, time)

    def damping(self, time: float) -> float:
        """Return the viscous damping of MuJoCo's joint [N*m*s/rad]."""
        return self._run.specimen.viscous_damping * self._run_in_factor(time)

    def _run_in_factor(self, time: float) -> float:
        """Return the factor on friction and damping at a time [s] of the run."""
        parameters = self._parameters.get("friction_run_in")
        return 1.0 if parameters is None else 1.0 + parameters["excess"] * math.exp(-time / parameters["time_constant"])

    def sliding_friction(self, angle: float, speed: float, time: float) -> float:
        """Return the friction of the sliding joint [N*m] with all effects that change it."""
        sliding_friction = self._run.specimen.coulomb_friction * self._run_in_factor(time)
        for name, parameters in self._parameters.items():
            if name == "stribeck":
                sliding_friction *= 1.0 + parameters["breakaway_ratio"] * math.exp(
                    -abs(speed) / parameters["stribeck_velocity"]
                )
            elif name == "asymmetric_friction":
                sliding_friction *= 1.0 + parameters["asymmetry"] * math.copysign(1.0, speed)
            elif name == "position_dependent_friction":
                sliding_friction *= 1.0 + parameters["amplitude"] * math.cos(
                    parameters["order"] * angle + parameters["phase"]
                )
            elif name == "rubbing_bursts":
                is_rubbing = math.sin(2.0 * math.pi * time / parameters["period"] + parameters["phase"]) > BURST_SHARE
                sliding_friction *= 1.0 + parameters["excess"] * is_rubbing
        return sliding_friction

    def encoder(self, angle: float) -> float:
        """Return the encoder's reading of an angle [rad]."""
        parameters = self._parameters.get("encoder_eccentricity")
        return angle if parameters is None else angle + parameters["amplitude"] * math.sin(angle + parameters["phase"])

    def encoder_slope(self, angle: float) -> float:
        """Return the ratio of the encoder's velocity to the rotor's."""
        parameters = self._parameters.get("encoder_eccentricity")
        return 1.0 if parameters is None else 1.0 + parameters["amplitude"] * math.cos(angle + parameters["phase"])
