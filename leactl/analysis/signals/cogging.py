"""Cogging: torque that goes with the angle alone, from whole turns of an unpowered rotor at a low speed, both ways.

Friction changes sign with the direction and cogging does not, so the mean over both directions, angle by angle, is
cogging and the sensor's zero. Cogging lets the speed ripple; what the rotor's inertia and damping take of that is put
back. Each turn is taken apart into periods a turn; one counts where it comes back in every turn by more than noise.
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

Parts = npt.NDArray[np.complex128]

TURN = "turn"
WHOLE = 2.0 * math.pi
ORDERS = 600  # periods a turn that are looked for
PER_PERIOD = 4  # readings that a period must have
PUT_BACK_STD = 0.1  # relative standard uncertainty of that correction: the inertia may be one of a drawing
FEWEST = 256  # readings of a turn
GRID = 4096  # angles at which a shape is looked at
CHANCE = 1e-3  # probability that noise makes any of the harmonics significant
SHOWN = 512  # angles in the figure


@dataclass(frozen=True, eq=False)
class Turn:
    """Harmonics of the torque over one turn, shape (orders,): element n has n periods a turn."""

    trial: TrialLabel
    parts: Parts  # N*m, complex amplitudes, corrected for inertia and damping
    read: Parts  # N*m, complex amplitudes of the sensor, without that correction


@dataclass(frozen=True)
class RotorDynamics:
    """Inertia and damping by which a rippling speed changes the torque."""

    inertia: float  # kg*m^2
    damping: float  # N*m*s/rad

    def taken(self, speed: float, ripple: Parts) -> Parts:
        """Torque of inertia and damping [N*m], from the ripple of the speed [rad/s], both by order, shape (orders,)."""
        return (self.damping + 1j * np.arange(len(ripple)) * speed * self.inertia) * ripple


def turns_of(run: Run, number: int, torque: Channel, damping: float) -> Noted[list[Turn]]:
    """Return the steps `turn` of run `number` that cover a whole turn, and a note on each that does not.

    Parameters
    ----------
    torque : of the sensor [N*m], NaN for readings that must not count.
    damping : viscous damping of the rotor [N*m*s/rad].
    """
    angle, velocity = run.channel("angle"), run.channel("velocity")
    angle_known, velocity_known = np.isfinite(angle.values), np.isfinite(velocity.values)
    inertia = inertia_of(run)
    rotor = RotorDynamics(inertia.value, damping)
    turns, notes = [], [*inertia.notes]
    for step in (step for step in run.steps if step.name == TURN):
        in_turn = (torque.time >= step.start + step.settle) & (torque.time < step.stop) & np.isfinite(torque.values)
        time = torque.time[in_turn]
        angles = np.interp(time, angle.time[angle_known], angle.values[angle_known])
        if len(time) < FEWEST or np.ptp(angles) < WHOLE:
            turned = float(np.ptp(angles)) if len(angles) else 0.0
            notes.append(f"{run.path} at {step.start:.1f} s: {turned:.2f} rad are no whole turn; it tells no cogging")
            continue
        side = 1 if angles[-1] > angles[0] else -1
        first_turn = np.abs(angles - angles[0]) < WHOLE
        speed = np.interp(time[first_turn], velocity.time[velocity_known], velocity.values[velocity_known])
        read, ripple = taken_apart(
            angles[first_turn], np.abs(speed), np.stack([torque.values[in_turn][first_turn], speed])
        )
        turns.append(Turn(TrialLabel(number, side), read + rotor.taken(float(speed.mean()), ripple), read))
    return Noted(turns, tuple(notes))


def inertia_of(run: Run) -> Noted[float]:
    """Return the rotor inertia in the model that a run carries [kg*m^2]; zero and a note where there is none."""
    inertia = rotor_inertia_of_model(run)
    if math.isfinite(inertia):
        return Noted(inertia)
    return Noted(0.0, (f"{run.path}: no rotor_inertia in its model: what it takes of the cogging is not put back",))


def taken_apart(angle: Array, speed: Array, signals: Array) -> Parts:
    """Return the harmonics of each signal over one turn, shape (signals, orders).

    Readings are evenly spaced in time; `angle` [rad] and `speed` [rad/s] have shape (readings,). The integral over the
    angle uses speed times time between two readings, since the counts of an encoder are coarse against it. Orders with
    too few readings a period stay zero.
    """
    weights = speed / speed.sum()
    deviation = signals - (signals @ weights)[:, np.newaxis]
    orders = min(ORDERS, len(angle) // PER_PERIOD)
    waves = np.exp(-1j * np.outer(angle, np.arange(orders)))
    amplitudes = np.zeros((len(signals), ORDERS), np.complex128)
    amplitudes[:, :orders] = 2.0 * (deviation * weights) @ waves
    return amplitudes


def cogging_of(turns: Sequence[Turn], gain_std: float) -> Noted[tuple[list[Estimate], Plot | None]]:
    """Estimate order and amplitude of the largest harmonic, and the peak to peak of all significant harmonics.

    `gain_std` is the relative standard uncertainty of the torque's calibration. There is no plot where no harmonic is
    significant.

    Raises
    ------
    NotIdentifiable : not two turns in one direction and one in the other.
    """
    sides = {turn.trial.side for turn in turns}
    if len(sides) < 2 or len(turns) < 3:
        raise NotIdentifiable(
            f"{len(turns)} whole turns in {len(sides)} directions tell no cogging: one in each and a repeat are needed"
        )
    harmonics = np.array([turn.parts for turn in turns])
    weights = np.array([0.5 / sum(other.trial.side == turn.trial.side for other in turns) for turn in turns])
    mean = weights @ harmonics
    errors = spread(turns, harmonics, weights)
    significant = counting(mean, errors)
    trials = [turn.trial for turn in turns]
    if not significant.any():
        bound = float(np.max((np.abs(mean) + 2.0 * errors)[1:]))
        bounds = [
            Estimate("cogging_order", NAN, NAN, NAN, NAN, "1"),
            Estimate("cogging_amplitude", NAN, NAN, 0.0, bound, "N*m"),
            Estimate("cogging_peak_to_peak", NAN, NAN, 0.0, 2.0 * bound, "N*m"),
        ]
        note = f"no part of the torque goes with the angle by more than noise: cogging is below {bound:.2g} N*m"
        return Noted((bounds, None), (note,))
    largest = int(np.argmax(np.where(significant, np.abs(mean), 0.0)))
    amplitudes, raw_amplitudes = (
        np.real(np.array([getattr(turn, name) for turn in turns])[:, largest] * np.exp(-1j * np.angle(mean[largest])))
        for name in ("parts", "read")
    )
    orders = np.flatnonzero(significant)
    angles = np.linspace(0.0, WHOLE, GRID, endpoint=False)
    peak_to_peaks, raw_peak_to_peaks = (
        np.array([np.ptp(shape(getattr(turn, name), orders, angles)) for turn in turns]) for name in ("parts", "read")
    )
    results = [
        Estimate("cogging_order", float(largest), NAN, NAN, NAN, "1"),
        mean_of(
            amplitudes.tolist(),
            trials,
            "cogging_amplitude",
            "N*m",
            math.hypot(gain_std, put_back(amplitudes, raw_amplitudes)),
        ),
        mean_of(
            peak_to_peaks.tolist(),
            trials,
            "cogging_peak_to_peak",
            "N*m",
            math.hypot(gain_std, put_back(peak_to_peaks, raw_peak_to_peaks)),
        ),
    ]
    largest_first = orders[np.argsort(-np.abs(mean[orders]))][:6]
    listed_orders = ", ".join(f"{order} ({abs(mean[order]):.2g} N*m)" for order in largest_first)
    drawn = angles[:: GRID // SHOWN]
    line = Series("cogging", tuple(drawn.tolist()), tuple(shape(mean, orders, drawn).tolist()))
    plot = Plot("angle [rad]", "torque that goes with the angle [N*m]", (), (line,))
    return Noted((results, plot), (f"cogging, by periods a turn: {listed_orders}",))


def put_back(mended: Array, unmended: Array) -> float:
    """Relative standard uncertainty that the correction for inertia and damping leaves in a figure."""
    return PUT_BACK_STD * abs(float(np.mean(mended - unmended)) / float(np.mean(mended)))


def spread(turns: Sequence[Turn], parts: Parts, weights: Array) -> Array:
    """Standard error of each harmonic's mean, by the scatter of the turns within their direction, shape (orders,)."""
    squares = np.zeros(parts.shape[1])
    dof = 0
    for side in (1, -1):
        side_parts = parts[[turn.trial.side == side for turn in turns]]
        squares += np.sum(np.abs(side_parts - side_parts.mean(axis=0)) ** 2, axis=0)
        dof += len(side_parts) - 1
    noise = squares / dof
    floor = np.full_like(noise, np.median(noise[1:][noise[1:] > 0.0]) if (noise[1:] > 0.0).any() else 0.0)
    error: Array = np.sqrt(np.maximum(noise, floor) * np.sum(weights**2))
    return error


def counting(mean: Parts, error: Array) -> npt.NDArray[np.bool_]:
    """Mark the harmonics that noise alone explains with a probability below `CHANCE` in all, shape (orders,)."""
    noise = np.where(error > 0.0, error, np.inf)
    tested = max(int(np.count_nonzero(error[1:] > 0.0)), 1)
    least = math.log(tested / CHANCE)
    counts: npt.NDArray[np.bool_] = np.abs(mean) ** 2 > least * noise**2
    counts[0] = False
    return counts


def shape(parts: Parts, orders: npt.NDArray[np.int64], angles: Array) -> Array:
    """Return the torque of some harmonics at the angles, shape (angles,)."""
    torque: Array = np.real(parts[orders] @ np.exp(1j * orders[:, np.newaxis] * angles))
    return torque
