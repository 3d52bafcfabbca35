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
from leactl.runfile.reader import Channel, Run

Parts = npt.NDArray[np.complex128]

TURN = "turn"
WHOLE = 2.0 * math.pi
ORDERS = 600  # periods a turn that are looked for
PER_PERIOD = 4  # readings that a period must have
PUT_BACK_STD = 0.1  # relative standard uncertainty of what is put back: an inertia may be one of a drawing
FEWEST = 256  # readings of a turn
GRID = 4096  # angles at which a shape is looked at
CHANCE = 1e-3  # that noise makes any of the periods count
SHOWN = 512  # angles in the figure


@dataclass(frozen=True, eq=False)
class Turn:
    """Torque over one whole turn, taken apart: element n belongs to n periods a turn."""

    trial: TrialLabel
    parts: Parts  # N*m, amplitudes
    read: Parts  # N*m, as the sensor has them, without what inertia and damping take


@dataclass(frozen=True)
class RotorDynamics:
    """What a rotor takes of the torque when its speed ripples."""

    inertia: float  # kg*m^2
    damping: float  # N*m*s/rad

    def taken(self, speed: float, ripple: Parts) -> Parts:
        """Torque [N*m] by periods a turn, from the ripple of the speed [rad/s] by periods a turn."""
        return (self.damping + 1j * np.arange(len(ripple)) * speed * self.inertia) * ripple


def turns_of(run: Run, number: int, torque: Channel, damping: float) -> Noted[list[Turn]]:
    """Return the steps `turn` of run `number` that cover a whole turn, and a note on each that does not.

    Parameters
    ----------
    torque : of the sensor [N*m], NaN for readings that must not count.
    damping : viscous damping of the rotor [N*m*s/rad].
    """
    angle, velocity = run.channel("angle"), run.channel("velocity")
    seen, known = np.isfinite(angle.values), np.isfinite(velocity.values)
    inertia = inertia_of(run)
    rotor = RotorDynamics(inertia.value, damping)
    turns, notes = [], [*inertia.notes]
    for step in (step for step in run.steps if step.name == TURN):
        part = (torque.time >= step.start + step.settle) & (torque.time < step.stop) & np.isfinite(torque.values)
        time = torque.time[part]
        way = np.interp(time, angle.time[seen], angle.values[seen])
        if len(time) < FEWEST or np.ptp(way) < WHOLE:
            turned = float(np.ptp(way)) if len(way) else 0.0
            notes.append(f"{run.path} at {step.start:.1f} s: {turned:.2f} rad are no whole turn; it tells no cogging")
            continue
        side = 1 if way[-1] > way[0] else -1
        whole = np.abs(way - way[0]) < WHOLE
        speed = np.interp(time[whole], velocity.time[known], velocity.values[known])
        read, ripple = taken_apart(way[whole], np.abs(speed), np.stack([torque.values[part][whole], speed]))
        turns.append(Turn(TrialLabel(number, side), read + rotor.taken(float(speed.mean()), ripple), read))
    return Noted(turns, tuple(notes))


def inertia_of(run: Run) -> Noted[float]:
    """Return the rotor inertia in the model that a run carries [kg*m^2]; zero and a note where there is none."""
    inertia = rotor_inertia_of_model(run)
    if math.isfinite(inertia):
        return Noted(inertia)
    return Noted(0.0, (f"{run.path}: no rotor_inertia in its model: what it takes of the cogging is not put back",))


def taken_apart(angle: Array, speed: Array, signals: Array) -> Parts:
    """Amplitudes of each signal by periods a turn, from readings evenly spaced in time over one whole turn.

    An integral over the angle; the way between two readings is the speed times their time, since an encoder's counts
    are coarse against it. Periods that have too few readings stay zero.
    """
    share = speed / speed.sum()
    level = signals - (signals @ share)[:, np.newaxis]
    most = min(ORDERS, len(angle) // PER_PERIOD)
    waves = np.exp(-1j * np.outer(angle, np.arange(most)))
    found = np.zeros((len(signals), ORDERS), np.complex128)
    found[:, :most] = 2.0 * (level * share) @ waves
    return found


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
    parts = np.array([turn.parts for turn in turns])
    weights = np.array([0.5 / sum(other.trial.side == turn.trial.side for other in turns) for turn in turns])
    mean = weights @ parts
    error = spread(turns, parts, weights)
    counts = counting(mean, error)
    trials = [turn.trial for turn in turns]
    if not counts.any():
        bound = float(np.max((np.abs(mean) + 2.0 * error)[1:]))
        bounds = [
            Estimate("cogging_order", NAN, NAN, NAN, NAN, "1"),
            Estimate("cogging_amplitude", NAN, NAN, 0.0, bound, "N*m"),
            Estimate("cogging_peak_to_peak", NAN, NAN, 0.0, 2.0 * bound, "N*m"),
        ]
        note = f"no part of the torque goes with the angle by more than noise: cogging is below {bound:.2g} N*m"
        return Noted((bounds, None), (note,))
    largest = int(np.argmax(np.where(counts, np.abs(mean), 0.0)))
    amplitudes, raw_amplitudes = (
        np.real(np.array([getattr(turn, name) for turn in turns])[:, largest] * np.exp(-1j * np.angle(mean[largest])))
        for name in ("parts", "read")
    )
    orders = np.flatnonzero(counts)
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
    harmonics = ", ".join(f"{order} ({abs(mean[order]):.2g} N*m)" for order in largest_first)
    drawn = angles[:: GRID // SHOWN]
    line = Series("cogging", tuple(drawn.tolist()), tuple(shape(mean, orders, drawn).tolist()))
    plot = Plot("angle [rad]", "torque that goes with the angle [N*m]", (), (line,))
    return Noted((results, plot), (f"cogging, by periods a turn: {harmonics}",))


def put_back(mended: Array, unmended: Array) -> float:
    """Relative standard uncertainty of figures by that of what was put back into them."""
    return PUT_BACK_STD * abs(float(np.mean(mended - unmended)) / float(np.mean(mended)))


def spread(turns: Sequence[Turn], parts: Parts, weights: Array) -> Array:
    """Standard error of each part's mean, by the scatter of the turns within their direction."""
    rest = np.zeros(parts.shape[1])
    dof = 0
    for side in (1, -1):
        own = parts[[turn.trial.side == side for turn in turns]]
        rest += np.sum(np.abs(own - own.mean(axis=0)) ** 2, axis=0)
        dof += len(own) - 1
    noise = rest / dof
    floor = np.full_like(noise, np.median(noise[1:][noise[1:] > 0.0]) if (noise[1:] > 0.0).any() else 0.0)
    found: Array = np.sqrt(np.maximum(noise, floor) * np.sum(weights**2))
    return found


def counting(mean: Parts, error: Array) -> npt.NDArray[np.bool_]:
    """Parts that noise makes, any of them, in no more than `CHANCE` of all cases; |mean|^2 of noise is exponential."""
    own = np.where(error > 0.0, error, np.inf)
    looked_at = max(int(np.count_nonzero(error[1:] > 0.0)), 1)
    least = math.log(looked_at / CHANCE)
    counts: npt.NDArray[np.bool_] = np.abs(mean) ** 2 > least * own**2
    counts[0] = False
    return counts


def shape(parts: Parts, orders: npt.NDArray[np.int64], angles: Array) -> Array:
    """The torque over the angle that some parts make together."""
    found: Array = np.real(parts[orders] @ np.exp(1j * orders[:, np.newaxis] * angles))
    return found
