"""Readings that contradict each other: swapped signs, and a torque sensor that drifts or is off by a factor."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leactl.analysis.efficiency.operating_points import OTHER_ROLE, OperatingPoints
from leactl.analysis.efficiency.power_balance import TORQUE_SIGN, PowerCalibration
from leactl.analysis.estimate import Noted
from leactl.analysis.quality.sign_checks import SIGN_SWAPPED
from leactl.analysis.statistics.regression import least_squares
from leactl.errors import InputError, NotIdentifiable
from leactl.runfile.read.reader import Run

MOST_CONTRADICTING_SHARE = 0.5  # of the points; if the signs of more contradict the roles, a sign is swapped
FEWEST_DRIFT_POINTS = 12  # in a run; fewer do not distinguish a drift from the effects of speed and torque
LEAST_UNEXPLAINED_TIME = 0.5  # of the standard deviation of time; speed and torque must leave as much unexplained
LEAST_STANDARD_ERRORS = 4.0  # of a drift or a gain error; a smaller value may be chance
LEAST_NOTED_DRIFT = 0.005  # of the largest torque; a smaller drift does not count
MOST_GAIN_DIFFERENCE = 0.02  # relative, between torque sensor and currents; a note names a larger difference


def refuse_swapped_signs(points: OperatingPoints, error_prefix: str) -> None:
    """Raise InputError if the signs of most readings contradict the roles of the driving and the driven actuator.

    The message names the channels; `error_prefix` opens it.
    """
    driving = np.array([grid_hold.driving for grid_hold in points.holds])
    faults = []
    for role in OTHER_ROLE:
        expected_sign = np.where(driving == role, 1.0, -1.0)
        speed = points.value.get(("velocity", role), points.value.get(("velocity", OTHER_ROLE[role])))
        current = points.value.get(("q_axis_current", role))
        if current is not None and speed is not None and _mostly_negative(expected_sign * current * speed):
            faults.append(f"current and velocity of the {role} actuator")
        voltage = points.value.get(("q_axis_voltage", role))
        if current is not None and voltage is not None and _mostly_negative((voltage * current)[driving == role]):
            faults.append(f"voltage and current of the {role} actuator")
        elif current is not None and voltage is not None and speed is not None:
            is_low_current = np.abs(current) <= np.nanmedian(np.abs(current))  # where back-EMF is most of the voltage
            if _mostly_negative((voltage * speed)[is_low_current]):
                faults.append(f"voltage and velocity of the {role} actuator")
    velocity = next(points.value["velocity", role] for role in OTHER_ROLE if ("velocity", role) in points.value)
    if _mostly_negative(np.where(driving == "test", 1.0, -1.0) * points.value["torque", "test"] * velocity):
        faults.append("torque and velocity")
    if faults:
        raise InputError(
            f"{error_prefix}: {' and '.join(faults)} have the signs of the other role in most points; {SIGN_SWAPPED}"
        )


def _mostly_negative(products: np.ndarray) -> bool:
    """Return whether more than `MOST_CONTRADICTING_SHARE` of the finite products are negative."""
    finite = products[np.isfinite(products)]
    return bool(len(finite)) and float(np.mean(finite < 0.0)) > MOST_CONTRADICTING_SHARE


def with_drift(points: OperatingPoints, runs: Sequence[Run], calibration: PowerCalibration) -> Noted[OperatingPoints]:
    """Return the points with the uncertainty of the torque sensor's zero widened by its drift; notes name the runs.

    Each actuator's friction is Kt i minus the torque that it gives. In the sum of both frictions the torque reading
    cancels; their difference is twice the error of the torque, plus the difference between the actuators, which depends
    on the speed.
    """
    has_both_currents = all(("q_axis_current", role) in points.value for role in OTHER_ROLE)
    if not has_both_currents or not np.isfinite(calibration.back_emf_constant):
        return Noted(points)
    notes = []
    zero_std = points.zero_std.copy()
    for number, run in enumerate(runs):
        run_points = points.where(points.run == number)
        torque = run_points.value["torque", "test"]
        signed_currents = sum(TORQUE_SIGN[role] * run_points.value["q_axis_current", role] for role in OTHER_ROLE)
        torque_of_currents = signed_currents * calibration.back_emf_constant / 2.0
        speed = np.array([grid_hold.speed for grid_hold in run_points.holds])
        time = np.array([grid_hold.hold.start for grid_hold in run_points.holds])
        is_complete = np.isfinite(torque) & np.isfinite(torque_of_currents)
        if is_complete.sum() < FEWEST_DRIFT_POINTS:
            continue
        run_time = (time - time[is_complete].mean()) / max(float(np.ptp(time[is_complete])), 1e-9)
        torque_and_speed = np.column_stack([torque, speed, np.ones_like(run_time)])[is_complete]
        explained_time = torque_and_speed @ np.linalg.lstsq(torque_and_speed, run_time[is_complete], rcond=None)[0]
        unexplained_time = run_time[is_complete] - explained_time
        if np.std(unexplained_time) < LEAST_UNEXPLAINED_TIME * np.std(run_time[is_complete]):
            notes.append(
                f"{run.path}: points were visited in the order of their speed or torque: a drift of torque sensor or"
                " currents cannot be told from them, and is in no interval"
            )
            continue
        design = np.column_stack([run_time[is_complete], torque_and_speed])
        try:
            fit = least_squares(design, (torque - torque_of_currents)[is_complete], design, str(run.path))
        except NotIdentifiable:  # a grid of one level leaves nothing to compare
            continue
        drift, standard_error = fit.combination(np.eye(design.shape[1])[0])
        if abs(drift) > LEAST_STANDARD_ERRORS * standard_error and abs(drift) > LEAST_NOTED_DRIFT * float(
            np.max(np.abs(torque[is_complete]))
        ):
            notes.append(
                f"{run.path}: torque drifts by {drift:.2g} N*m over the run against the currents; its zero is taken as"
                " uncertain as that"
            )
            # the root mean square of a straight drift from zero
            zero_std[number] = np.hypot(zero_std[number], abs(drift) / np.sqrt(3.0))
        gain_difference, standard_error = fit.combination(np.eye(design.shape[1])[1])
        if (
            abs(gain_difference) > MOST_GAIN_DIFFERENCE
            and abs(gain_difference) > LEAST_STANDARD_ERRORS * standard_error
        ):
            notes.append(
                f"{run.path}: torque is {gain_difference:+.1%} off the torque of the currents by the torque constant;"
                " the sensor's calibration or the current's convention may be wrong"
            )
    return Noted(replace(points, zero_std=zero_std), tuple(notes))
