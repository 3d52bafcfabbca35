"""Cogging: torque that depends on the angle alone, from whole turns of an unpowered rotor at a low speed, both ways.

Friction changes sign with the direction and cogging does not, so the mean over both directions at each angle is cogging
plus the sensor's zero. Cogging makes the speed ripple; the torque that inertia and damping take up with this ripple is
added to the reading. The torque of each turn is decomposed into harmonics of the turn; a harmonic counts where its mean
over the turns is more than noise.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import NAN, Estimate, Noted, Plot, Series
from leactl.analysis.run_model import rotor_inertia_of_model
from leactl.analysis.statistics.regression import Array
from leactl.analysis.statistics.trial_means import TrialLabel, mean_of
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel, Run

Amplitudes = npt.NDArray[np.complex128]

TURN = "turn"
FULL_TURN = 2.0 * math.pi  # rad
ORDER_COUNT = 600  # orders that are computed: the highest number of periods a turn, plus one
FEWEST_READINGS_PER_PERIOD = 4  # of a harmonic that is computed
CORRECTION_STD = 0.1  # relative standard uncertainty of the correction for inertia, which may be from a drawing
FEWEST_READINGS = 256  # of the torque in a turn
SHAPE_ANGLES = 4096  # angles in a turn at which a peak to peak is taken
FALSE_ALARM_PROBABILITY = 1e-3  # probability that noise makes any of the harmonics significant
PLOTTED_ANGLES = 512  # angles in the plot


@dataclass(frozen=True, eq=False)
class Turn:
    """Harmonics of the torque over one turn, shape (orders,): element n has n periods a turn."""

    trial: TrialLabel
    corrected: Amplitudes  # N*m, complex, corrected for inertia and damping
    uncorrected: Amplitudes  # N*m, complex, of the sensor's readings


@dataclass(frozen=True)
class RotorDynamics:
    """Inertia and damping by which a rippling speed changes the torque."""

    inertia: float  # kg*m^2
    damping: float  # N*m*s/rad

    def torque_of_ripple(self, speed: float, ripple: Amplitudes) -> Amplitudes:
        """Return the torque of inertia and damping [N*m] for a ripple of the speed [rad/s], shape (orders,) both."""
        return (self.damping + 1j * np.arange(len(ripple)) * speed * self.inertia) * ripple


def turns_of(run: Run, number: int, torque: Channel, damping: float) -> Noted[list[Turn]]:
    """Return the steps `turn` of a run that cover a whole turn, and a note on each step that does not.

    Parameters
    ----------
    number : of the run among all runs.
    torque : of the sensor [N*m], NaN for readings that must not count.
    damping : viscous damping of the rotor [N*m*s/rad].
    """
    angle, velocity = run.channel("angle"), run.channel("velocity")
    finite_angle, finite_velocity = np.isfinite(angle.values), np.isfinite(velocity.values)
    if not (finite_angle.any() and finite_velocity.any()):
        return Noted([], (f"{run.path}: no reading of its angle, or of its velocity: it shows no cogging",))
    inertia = inertia_of(run)
    rotor = RotorDynamics(inertia.value, damping)
    turns, notes = [], [*inertia.notes]
    for step in (step for step in run.steps if step.name == TURN):
        in_turn = (torque.time >= step.start + step.settle) & (torque.time < step.stop) & np.isfinite(torque.values)
        time = torque.time[in_turn]
        angles = np.interp(time, angle.time[finite_angle], angle.values[finite_angle])
        if len(time) < FEWEST_READINGS or np.ptp(angles) < FULL_TURN:
            angle_range = float(np.ptp(angles)) if len(angles) else 0.0
            notes.append(
                f"{run.path} at {step.start:.1f} s: {angle_range:.2f} rad are no whole turn; it shows no cogging"
            )
            continue
        direction = 1 if angles[-1] > angles[0] else -1
        in_first_turn = np.abs(angles - angles[0]) < FULL_TURN
        speed = np.interp(time[in_first_turn], velocity.time[finite_velocity], velocity.values[finite_velocity])
        uncorrected, ripple = harmonics_over_turn(
            angles[in_first_turn], np.abs(speed), np.stack([torque.values[in_turn][in_first_turn], speed])
        )
        corrected = uncorrected + rotor.torque_of_ripple(float(speed.mean()), ripple)
        turns.append(Turn(TrialLabel(number, direction), corrected, uncorrected))
    return Noted(turns, tuple(notes))


def inertia_of(run: Run) -> Noted[float]:
    """Return the rotor inertia in a run's model [kg*m^2]; zero and a note if the model has none."""
    inertia = rotor_inertia_of_model(run)
    if math.isfinite(inertia):
        return Noted(inertia)
    return Noted(
        0.0, (f"{run.path}: no rotor_inertia in its model: the cogging is not corrected for the torque of the inertia",)
    )


def harmonics_over_turn(angle: Array, speed: Array, signals: Array) -> Amplitudes:
    """Return the harmonics of each signal over one turn, shape (signals, orders).

    Readings are evenly spaced in time; `angle` [rad] and `speed` [rad/s] have shape (readings,). In the integral
    over the angle, a step is speed times time between two readings, since the encoder's counts are coarser than that.
    Orders with fewer than `FEWEST_READINGS_PER_PERIOD` stay zero.
    """
    weights = speed / speed.sum()
    deviation = signals - (signals @ weights)[:, np.newaxis]
    orders = min(ORDER_COUNT, len(angle) // FEWEST_READINGS_PER_PERIOD)
    waves = np.exp(-1j * np.outer(angle, np.arange(orders)))
    amplitudes = np.zeros((len(signals), ORDER_COUNT), np.complex128)
    amplitudes[:, :orders] = 2.0 * (deviation * weights) @ waves
    return amplitudes


def cogging_of(turns: Sequence[Turn], gain_std: float) -> Noted[tuple[list[Estimate], Plot | None]]:
    """Estimate order and amplitude of the largest harmonic, and the peak to peak of all significant harmonics.

    `gain_std` is the relative standard uncertainty of the torque's calibration. If no harmonic is significant, the
    plot is None and the results are upper bounds.

    Raises
    ------
    NotIdentifiable : turns in one direction only, or fewer than three turns.
    """
    directions = [turn.trial.side for turn in turns]
    if len(set(directions)) < 2 or len(turns) < 3:
        raise NotIdentifiable(
            f"{len(turns)} whole turns in {len(set(directions))} directions show no cogging: one in each and a repeat"
            " are needed"
        )
    harmonics = np.array([turn.corrected for turn in turns])
    weights = np.array([0.5 / directions.count(direction) for direction in directions])
    mean = weights @ harmonics
    standard_error = standard_errors(turns, harmonics, weights)
    is_significant = significant_harmonics(mean, standard_error)
    trials = [turn.trial for turn in turns]
    if not is_significant.any():
        upper_bound = float(np.max((np.abs(mean) + 2.0 * standard_error)[1:]))
        upper_bounds = [
            Estimate("cogging_order", NAN, NAN, NAN, NAN, "1"),
            Estimate("cogging_amplitude", NAN, NAN, 0.0, upper_bound, "N*m"),
            Estimate("cogging_peak_to_peak", NAN, NAN, 0.0, 2.0 * upper_bound, "N*m"),
        ]
        note = (
            f"no part of the torque repeats with the angle by more than noise: cogging is below {upper_bound:.2g} N*m"
        )
        return Noted((upper_bounds, None), (note,))
    largest = int(np.argmax(np.where(is_significant, np.abs(mean), 0.0)))
    amplitudes, raw_amplitudes = (
        np.real(np.array([getattr(turn, name) for turn in turns])[:, largest] * np.exp(-1j * np.angle(mean[largest])))
        for name in ("corrected", "uncorrected")
    )
    orders = np.flatnonzero(is_significant)
    angles = np.linspace(0.0, FULL_TURN, SHAPE_ANGLES, endpoint=False)
    peak_to_peaks, raw_peak_to_peaks = (
        np.array([np.ptp(shape(getattr(turn, name), orders, angles)) for turn in turns])
        for name in ("corrected", "uncorrected")
    )
    results = [
        Estimate("cogging_order", float(largest), NAN, NAN, NAN, "1"),
        mean_of(
            amplitudes.tolist(),
            trials,
            "cogging_amplitude",
            "N*m",
            math.hypot(gain_std, correction_std(amplitudes, raw_amplitudes)),
        ),
        mean_of(
            peak_to_peaks.tolist(),
            trials,
            "cogging_peak_to_peak",
            "N*m",
            math.hypot(gain_std, correction_std(peak_to_peaks, raw_peak_to_peaks)),
        ),
    ]
    largest_first = orders[np.argsort(-np.abs(mean[orders]))][:6]
    listed_orders = ", ".join(f"{order} ({abs(mean[order]):.2g} N*m)" for order in largest_first)
    plotted_angles = angles[:: SHAPE_ANGLES // PLOTTED_ANGLES]
    line = Series("cogging", tuple(plotted_angles.tolist()), tuple(shape(mean, orders, plotted_angles).tolist()))
    plot = Plot("angle [rad]", "cogging torque [N*m]", (), (line,))
    return Noted((results, plot), (f"cogging, by periods a turn: {listed_orders}",))


def correction_std(corrected: Array, uncorrected: Array) -> float:
    """Return the relative standard uncertainty of a result by the correction for inertia and damping.

    The arguments are its values with and without the correction, shape (turns,) each.
    """
    return CORRECTION_STD * abs(float(np.mean(corrected - uncorrected)) / float(np.mean(corrected)))


def standard_errors(turns: Sequence[Turn], harmonics: Amplitudes, weights: Array) -> Array:
    """Return the standard error of each harmonic's mean, by the scatter of turns in one direction, shape (orders,).

    `harmonics` has shape (turns, orders), and `weights`, those of the turns in the mean, (turns,).
    """
    squares = np.zeros(harmonics.shape[1])
    dof = 0
    for direction in (1, -1):
        same_direction = harmonics[[turn.trial.side == direction for turn in turns]]
        squares += np.sum(np.abs(same_direction - same_direction.mean(axis=0)) ** 2, axis=0)
        dof += len(same_direction) - 1
    noise = squares / dof
    noise_floor = np.full_like(noise, np.median(noise[1:][noise[1:] > 0.0]) if (noise[1:] > 0.0).any() else 0.0)
    errors: Array = np.sqrt(np.maximum(noise, noise_floor) * np.sum(weights**2))
    return errors


def significant_harmonics(mean: Amplitudes, standard_error: Array) -> npt.NDArray[np.bool_]:
    """Return the mask of the significant harmonics, shape (orders,).

    `FALSE_ALARM_PROBABILITY` is the probability that noise makes at least one of them significant.
    """
    noise_of_mean = np.where(standard_error > 0.0, standard_error, np.inf)
    tested_count = max(int(np.count_nonzero(standard_error[1:] > 0.0)), 1)
    threshold = math.log(tested_count / FALSE_ALARM_PROBABILITY)
    is_significant: npt.NDArray[np.bool_] = np.abs(mean) ** 2 > threshold * noise_of_mean**2
    is_significant[0] = False
    return is_significant


def shape(harmonics: Amplitudes, orders: npt.NDArray[np.int64], angles: Array) -> Array:
    """Return the torque of the harmonics `orders` at the angles [rad], shape (angles,)."""
    torque: Array = np.real(harmonics[orders] @ np.exp(1j * orders[:, np.newaxis] * angles))
    return torque
