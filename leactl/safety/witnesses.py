"""A second sensor for a current: the torque or the voltage that goes with it, against what the drive reads.

A drive that takes one convention of current for another regulates what it misreads: reading and demand agree, and only
another sensor tells. Each sample of a torque or a voltage allows a current from so much to so much; the mean square of
the reading has to lie between theirs. Means of a window leave out noise and the moment at which either is sampled, and
cost the cycle little; squares are what heats, and do not cancel where a current swings.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
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
STEADY = 0.1  # of a mean square, by which a steady current may swing, or change from one window to the next
GLANCE = (
    4  # every so many cycles of a long window are looked at first: where these agree plainly, nothing is worked out
)
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


Ends = tuple[float, float]


def _magnitudes(low: float, high: float) -> Ends:
    """The smallest and the largest magnitude between two ends."""
    if low > 0.0 or high < 0.0:
        return (low, high) if low > 0.0 else (-high, -low)
    return 0.0, max(-low, high)


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
        # by names of their own: `extremes` is asked for every window
        self._coulomb, self._viscous = model.coulomb_friction, model.viscous_damping
        self._less, self._more = 1.0 - 0.01 * settings.share_percent, 1.0 + 0.01 * settings.share_percent
        self._weakest = model.torque_constant * (1.0 - WEAKER)

    def currents(self, torque: Array, velocity: Array, before: float, period: float) -> Currents:
        """By the torques [N*m] and velocities [rad/s] of cycles that last `period`, and the velocity before them."""
        model, coulomb, viscous = self._model, self._coulomb, self._viscous
        given, speed = self._sense * torque, np.abs(velocity)
        least, most = coulomb.low + viscous.low * speed, coulomb.high + viscous.high * speed
        if speed.min() > TURNING_RAD_S and abs(np.sign(velocity).sum()) == len(velocity):
            given = given + 0.5 * (least + most) * np.sign(velocity)
            either = 0.5 * (most - least)
        else:
            either = most
        acceleration = np.diff(velocity, prepend=before) / period
        either = either + model.rotor_inertia * np.abs(acceleration) + self._settings.tolerance_Nm
        magnitude = np.abs(given)
        return Currents(
            np.sign(given),
            np.maximum(magnitude * self._less - either, 0.0) / model.torque_constant,
            magnitude / model.torque_constant,
            (magnitude * self._more + either) / self._weakest,
        )

    def way(self, torque: float, _velocity: float) -> float:
        """Positive where such a torque is of a positive current."""
        return self._sense * torque

    def extremes(self, torques: Ends, velocities: Ends) -> Ends:
        """No `low` of `currents` is above the first, and no `high` below the second, for what lies between these ends.

        What acceleration explains is left out: it makes either less.
        """
        coulomb, viscous = self._coulomb, self._viscous
        slowest, fastest = _magnitudes(*velocities)
        most = coulomb.high + viscous.high * slowest
        low, high = torques if self._sense > 0.0 else (-torques[1], -torques[0])
        if slowest > TURNING_RAD_S:
            least, most_of_all = coulomb.low + viscous.low * slowest, coulomb.high + viscous.high * fastest
            helped = (least, most_of_all) if velocities[0] > 0.0 else (-most_of_all, -least)
            low, high, either = low + helped[0], high + helped[1], 0.5 * (most - least)
        else:
            either = most
        either += self._settings.tolerance_Nm
        smallest, largest = _magnitudes(low, high)
        flows = largest * self._less - either
        return (
            flows / self._model.torque_constant if flows > 0.0 else 0.0,
            (smallest * self._more + either) / self._weakest,
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

    def way(self, voltage: float, velocity: float) -> float:
        """Positive where such a voltage drives a positive current."""
        return voltage - self._back_emf_constant * velocity

    def extremes(self, voltages: Ends, velocities: Ends) -> Ends:
        """No `low` of `currents` is above the first, and no `high` below the second, for what lies between these ends.

        What grows with the voltage is left out of the tolerance: it makes either less.
        """
        resistance, (slow, fast) = self._resistances(), sorted(self._back_emf_constant * each for each in velocities)
        smallest, largest = _magnitudes(voltages[0] - fast, voltages[1] - slow)
        tolerance = self._settings.tolerance_V
        return max(largest - tolerance, 0.0) / resistance.high, (smallest + tolerance) / resistance.low


AGREES, LESS, MORE, TURNED = range(4)  # what is read beside what flows; turned: it flows the other way


@dataclass
class Account:
    """One drive's current, and what else tells of it."""

    label: str
    witness: ByTorque | ByVoltage
    panel: Panel
    current: int  # where they stand among the panel's values
    velocity: int
    side: int = AGREES  # of the last window
    read: float = math.nan  # A^2, mean of the last window that was worked out
    windows: int = 0  # in a row to that side


EVIDENCE, VELOCITY, CURRENTS = range(3)  # columns of what is logged; the second drive's current comes last
Logged = tuple[float, float, float, float]  # of one cycle


class Witnesses:
    """Trips on the current of a drive that a second sensor contradicts for `WINDOWS` windows in a row.

    Two drives that share the sensor share a shaft too, so that the velocity of the first serves both.
    """

    def __init__(self, for_s: float, evidence: Panel, place: int, accounts: Sequence[Account], trip: Trip) -> None:
        """`place` is where the second sensor's reading stands among the values of its panel."""
        self._for_s, self._trip = for_s, trip
        self._accounts = accounts
        # one drive's current is logged twice
        first, second = accounts[0], accounts[-1]
        self._sources = evidence, place, first.panel, first.velocity, first.current, second.panel, second.current
        self._log: list[Logged] = []
        self._window = self.due = math.inf
        self._began, self._kept = 0.0, 0  # rows that the last window has left

    def begin(self, period: float, now: float) -> None:
        """The loop begins with cycles of this length."""
        self._window = max(self._for_s / WINDOWS, LEAST_CYCLES * period)
        self._log.clear()
        self._kept = 0
        self._began, self.due = now, now + self._window

    @property
    def logged(self) -> tuple[list[Logged], Panel, int, Panel, int, int, Panel, int]:
        """Where each exchange is logged, and what: three panels, each with the places of its values."""
        return self._log, *self._sources

    def look(self, now: float) -> None:
        """Judge the window where it ends with the exchange that has just been logged.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        if now >= self.due:
            self._judge(now)

    def _judge(self, now: float) -> None:
        log = self._log
        cycles = len(log)
        glanced = log[::GLANCE] if cycles >= GLANCE * GLANCE else log
        columns = list(zip(*glanced, strict=True))
        ends = [(min(column), max(column)) for column in columns]
        for current, account in enumerate(self._accounts, start=CURRENTS):
            if not self._plainly_agrees(account, current, columns, ends):
                self._hold_against(account, current, np.array(log), (now - self._began) / (cycles - self._kept))
        self._kept = min(APART_CYCLES, cycles)
        del log[: -self._kept]
        self._began, self.due = now, now + self._window

    @staticmethod
    def _plainly_agrees(
        account: Account, current: int, columns: Sequence[Sequence[float]], ends: Sequence[Ends]
    ) -> bool:
        """Whether the ends of what was read tell already that no sample contradicts any other: most windows' work."""
        witness = account.witness
        low, high = witness.extremes(ends[EVIDENCE], ends[VELOCITY])
        smallest, largest = _magnitudes(*ends[current])
        agrees = low <= smallest and largest <= high
        if agrees and low > 0.0:
            agrees = witness.way(sum(columns[EVIDENCE]), sum(columns[VELOCITY])) * sum(columns[current]) > 0.0
        if agrees:
            account.side = account.windows = AGREES
        return agrees

    def _hold_against(self, account: Account, current: int, rows: Array, period: float) -> None:
        """Judge one window; what cannot be told, a reading that is no number among it, contradicts nothing."""
        fresh, squares = rows[self._kept :], rows[:, current] ** 2
        read = float(squares[self._kept :].mean())
        # the two are not sampled at the same moment: a current that changes may be read some cycles apart, and a sensor
        # that is slower than the loop may meet every other sample of a swing
        spread = APART_CYCLES / len(fresh) * float(squares.max() - squares.min())
        apart = spread + (float(np.abs(np.diff(squares)).mean()) if len(squares) > 1 else 0.0)
        velocity = fresh[:, VELOCITY]
        before = float(rows[self._kept - 1, VELOCITY]) if self._kept else float(velocity[0])
        currents = account.witness.currents(fresh[:, EVIDENCE], velocity, before, period)
        low, likely, high = (float(each @ each) / len(fresh) for each in (currents.low, currents.likely, currents.high))
        with_it = float((currents.way * currents.low) @ fresh[:, current]) / len(fresh)
        side = TURNED if with_it < -apart else LESS if low > read + apart else MORE if read > high + apart else AGREES
        changed = False
        if (
            side == MORE
        ):  # a second sensor that follows slowly shows too little of what swings or changes, never too much
            side = MORE if float(fresh[:, current].mean()) ** 2 >= (1.0 - STEADY) * read else AGREES
            changed = abs(read - account.read) > STEADY * max(read, account.read)
        account.read = read
        goes_on = side == account.side != AGREES and not changed
        account.windows = account.windows + 1 if goes_on else int(side != AGREES)
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
            turns = ("velocity", role) in measured  # without which neither friction nor back-EMF is known
            sensed = turns and role in SENSED_ROLES.get(setup, ())
            by_torque, by_voltage = interlocks.torque_disagreement, interlocks.voltage_disagreement
            seconds = [("torque", "test", by_torque is not None, "torque_disagreement")] if sensed else []
            seconds += [("q_axis_voltage", role, by_voltage is not None, "voltage_disagreement")] if turns else []
        there = [(watched, key) for second, whose, watched, key in seconds if (second, whose) in measured]
        if any(watched for watched, _key in there):
            continue
        more = f"; interlocks.{there[0][1]} would hold a second one against it" if there else ""
        lines.append(
            f"the bound of the {role} winding rests on one sensor, {quantity}: in set-up '{setup}' nothing else shows"
            f" a current that is misread{more}"
        )
    return lines
