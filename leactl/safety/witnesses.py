"""A second sensor for a current: the torque or the voltage that goes with it, against what the drive reads.

A drive that takes one convention of current for another regulates what it misreads: reading and demand agree, and only
another sensor tells. Each sample of a torque or a voltage allows a current from so much to so much; the mean square of
the reading has to lie between theirs. Means of a window leave out noise and the moment at which either is sampled, and
cost the cycle little; squares are what heats, and do not cancel where a current swings.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import NamedTuple, Self

import numpy as np

from leactl.model.motor import Motor
from leactl.quantities import ChannelSpec
from leactl.safety.cross_checks import APART_CYCLES, TURNING_RAD_S
from leactl.safety.interlocks import Interlocks, TorqueDisagreement, VoltageDisagreement
from leactl.safety.thermal.box import Array, Box, Range
from leactl.safety.watching import Panel, Trip

WEAKER = 0.1  # of a torque constant, that hot magnets (0.1 %/K) and saturation take away
WINDOWS = 3  # in a row that have to contradict alike: a blow that falls into two of them is none of the current
LEAST_CYCLES = 4  # of a window
SENSED_ROLES = {"coupled": ("test", "load"), "locked": ("test",)}  # whose torques pass the sensor, by set-up
MOST_NAMED = 2  # conventions, of those that a contradiction allows the nearest
CONVENTIONS = {
    math.sqrt(1.5): "sqrt(3/2), as where a phase amplitude is taken for q-axis current",
    math.sqrt(2.0): "sqrt(2), as where an rms value is taken for an amplitude",
    1.5: "3/2, as where the factor of an amplitude-invariant transform is left out",
    math.sqrt(3.0): "sqrt(3), as where a phase rms is taken for q-axis current",
    1.0 / math.sqrt(1.5): "sqrt(2/3), as where q-axis current is taken for a phase amplitude",
    1.0 / math.sqrt(2.0): "1/sqrt(2), as where an amplitude is taken for an rms value",
    1.0 / 1.5: "2/3, as where the factor of an amplitude-invariant transform is put in twice",
    1.0 / math.sqrt(3.0): "1/sqrt(3), as where q-axis current is taken for a phase rms",
}


def conventions(least: float, ratio: float, most: float) -> str:
    """The conventions that a true current over its reading may tell of, the nearest first; empty where none is near."""
    near = [factor for factor in CONVENTIONS if least <= factor <= most]
    near.sort(key=lambda factor: abs(math.log(ratio / factor)))
    return ", or ".join(CONVENTIONS[factor] for factor in near[:MOST_NAMED])


class Currents(NamedTuple):
    """What a second sensor allows the magnitude of a current to be, sample by sample [A], and which way it flows."""

    way: Array
    low: Array
    likely: Array
    high: Array


class TorqueModel(NamedTuple):
    """What a motor file says of the torque that reaches the shaft, SI."""

    torque_constant: float
    coulomb_friction: Range
    viscous_damping: Range
    rotor_inertia: float

    @classmethod
    def of(cls, motor: Motor) -> Self:
        """Of a motor file with tolerances."""
        box = Box.of(motor)
        return cls(motor.torque_constant, box.coulomb_friction, box.viscous_damping, motor.rotor_inertia)


class ByTorque:
    """Currents by the torque sensor between the actuators: what a rotor gives the shaft, its friction and inertia.

    A rotor that turns has friction against its motion; one that rests or turns back may have any up to the highest.
    """

    label = "test torque"

    def __init__(self, settings: TorqueDisagreement, model: TorqueModel, sense: float) -> None:
        """`sense` is 1 for the actuator whose torque the sensor shows, -1 for the one that takes it."""
        self._settings, self._model, self._sense = settings, model, sense

    def currents(self, torque: Array, velocity: Array, before: float, period: float) -> Currents:
        """By the torques [N*m] and velocities [rad/s] of cycles that last `period`, and the velocity before them."""
        settings, model = self._settings, self._model
        coulomb, viscous = model.coulomb_friction, model.viscous_damping
        given, speed = self._sense * torque, np.abs(velocity)
        least, most = coulomb.low + viscous.low * speed, coulomb.high + viscous.high * speed
        if speed.min() > TURNING_RAD_S and abs(np.sign(velocity).sum()) == len(velocity):
            given = given + 0.5 * (least + most) * np.sign(velocity)
            either = 0.5 * (most - least)
        else:
            either = most
        acceleration = np.diff(velocity, prepend=before) / period
        either = either + model.rotor_inertia * np.abs(acceleration) + settings.tolerance_Nm
        share, magnitude = 0.01 * settings.share_percent, np.abs(given)
        return Currents(
            np.sign(given),
            np.maximum(magnitude * (1.0 - share) - either, 0.0) / model.torque_constant,
            magnitude / model.torque_constant,
            (magnitude * (1.0 + share) + either) / (model.torque_constant * (1.0 - WEAKER)),
        )


class ByVoltage:
    """Currents by the q-axis voltage at a drive's terminals: what back-EMF leaves of it, over the resistance."""

    def __init__(
        self, label: str, settings: VoltageDisagreement, back_emf_constant: float, resistances: Callable[[], Range]
    ) -> None:
        self.label = label
        self._settings, self._back_emf_constant, self._resistances = settings, back_emf_constant, resistances

    def currents(self, voltage: Array, velocity: Array, _before: float, _period: float) -> Currents:
        """By the voltages [V] and velocities [rad/s] of some cycles."""
        share, resistance = 0.01 * self._settings.share_percent, self._resistances()
        back_emf = self._back_emf_constant * velocity
        driving = voltage - back_emf
        across = np.abs(driving)
        either = share * (np.abs(voltage) + np.abs(back_emf)) + self._settings.tolerance_V
        return Currents(
            np.sign(driving),
            np.maximum(across - either, 0.0) / resistance.high,
            across / math.sqrt(resistance.low * resistance.high),
            (across + either) / resistance.low,
        )


AGREES, LESS, MORE, TURNED = range(4)  # what is read beside what flows; turned: it flows the other way


@dataclass
class Account:
    """One current and what else tells of it, as columns of what is logged every cycle."""

    label: str
    witness: ByTorque | ByVoltage
    evidence: int
    current: int
    velocity: int
    side: int = 0  # of the last window: one of the constants below
    windows: int = 0  # in a row to that side


class Witnesses:
    """Trips on a current that a second sensor contradicts for `WINDOWS` windows in a row."""

    def __init__(self, for_s: float, trip: Trip) -> None:
        self._for_s, self._trip = for_s, trip
        self._sources: list[tuple[Panel, Callable[[Sequence[float]], Sequence[float]]]] = []
        self._accounts: list[Account] = []
        self._log: list[float] = []
        self._width, self._window, self._due = 0, math.inf, math.inf
        self._began, self._kept = 0.0, 0  # rows that the last window has left

    def log(self, panel: Panel, *places: int) -> int:
        """Have these values of a panel logged every cycle; the column of the first."""
        column, self._width = self._width, self._width + len(places)
        get = itemgetter(*places) if len(places) > 1 else itemgetter(slice(places[0], places[0] + 1))
        self._sources.append((panel, get))
        return column

    def hold(self, account: Account) -> None:
        """Judge a current from now on."""
        self._accounts.append(account)

    def begin(self, period: float, now: float) -> None:
        """The loop begins with cycles of this length."""
        self._window = max(self._for_s / WINDOWS, LEAST_CYCLES * period)
        self._log.clear()
        self._kept = 0
        self._began, self._due = now, now + self._window

    def look(self, now: float) -> None:
        """Log the exchange that has just ended, and judge the window where it ends with it.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        log = self._log
        for panel, get in self._sources:
            log += get(panel.values)
        if now >= self._due:
            self._judge(now)

    def _judge(self, now: float) -> None:
        rows = np.reshape(self._log, (-1, self._width))
        fresh = rows[self._kept :]
        for account in self._accounts:
            self._hold_against(account, fresh, rows, (now - self._began) / len(fresh))
        self._kept = min(APART_CYCLES, len(rows))
        del self._log[: (len(rows) - self._kept) * self._width]
        self._began, self._due = now, now + self._window

    def _hold_against(self, account: Account, fresh: Array, rows: Array, period: float) -> None:
        """Judge one window; what cannot be told, a reading that is no number among it, contradicts nothing."""
        squares = rows[:, account.current] ** 2
        read = float(squares[-len(fresh) :].mean())
        # the two are not sampled at the same moment: a current that changes may be read some cycles apart
        apart = min(1.0, APART_CYCLES / len(fresh)) * float(squares.max() - squares.min())
        velocity = fresh[:, account.velocity]
        before = float(rows[-len(fresh) - 1, account.velocity]) if len(rows) > len(fresh) else float(velocity[0])
        found = account.witness.currents(fresh[:, account.evidence], velocity, before, period)
        low, likely, high = (float(each @ each) / len(fresh) for each in (found.low, found.likely, found.high))
        with_it = float((found.way * found.low) @ fresh[:, account.current]) / len(fresh)
        side = TURNED if with_it < -apart else LESS if low > read + apart else MORE if read > high + apart else AGREES
        account.windows = account.windows + 1 if side == account.side != AGREES else int(side != AGREES)
        account.side = side
        if account.windows >= WINDOWS:
            self._contradict(account, *(math.sqrt(square) for square in (read, low, likely, high)))

    def _contradict(self, account: Account, read: float, low: float, likely: float, high: float) -> None:
        named = conventions(low / read, likely / read, high / read) if read and likely else ""
        bound = f"no more than {high:.4g} A" if account.side == MORE else f"no less than {low:.4g} A"
        ratio = f"{likely / read:.3g} times as much{f', near {named}' if named else ''}; " if read else ""
        if account.side == TURNED:
            bound, ratio = f"{bound} and the other way", "is a sign turned, "
        self._trip(
            f"{account.label} of {read:.4g} A contradicts {account.witness.label}, by which {likely:.4g} A flow,"
            f" {bound}, for {WINDOWS * self._window:.3g} s: {ratio}is current_convention right, are both sensors whole?"
        )


def lone_sensors(
    interlocks: Interlocks, channels: Iterable[ChannelSpec], setup: str, currents: Mapping[str, str]
) -> list[str]:
    """One line for each winding whose bound rests on one sensor, for nothing is held against its current.

    Parameters
    ----------
    currents : of each role that a plan heats, the quantity that tells its current.
    """
    measured = {(channel.quantity, channel.role) for channel in channels}
    lines = []
    for role, quantity in currents.items():
        if quantity == "line_current":
            seconds = [("line_voltage", role, True, "its supply's voltage")]
        else:
            sensed = role in SENSED_ROLES.get(setup, ())
            by_torque, by_voltage = interlocks.torque_disagreement, interlocks.voltage_disagreement
            seconds = [("torque", "test", by_torque is not None, "torque_disagreement")] if sensed else []
            seconds.append(("q_axis_voltage", role, by_voltage is not None, "voltage_disagreement"))
        there = [(watched, key) for second, whose, watched, key in seconds if (second, whose) in measured]
        if any(watched for watched, _key in there):
            continue
        more = f"; interlocks.{there[0][1]} would hold a second one against it" if there else ""
        lines.append(
            f"the bound of the {role} winding rests on one sensor, {quantity}: in set-up '{setup}' nothing else shows"
            f" a current that is misread{more}"
        )
    return lines
