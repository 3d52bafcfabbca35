"""Comparison of a drive's current reading with a second sensor: shaft torque, or voltage at the winding.

A drive that mistakes one convention of current for another controls the misread current: reading and demand agree, and
only another sensor shows the error. Each sample of a torque or a voltage allows a current between two bounds; the mean
square of the reading has to lie between the mean squares of these bounds. Means over a window suppress noise and the
difference of sampling times, and cost little in each cycle; squares measure heat, and do not cancel where a current
swings.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from leactl.model.motor import Motor
from leactl.quantities import ChannelSpec
from leactl.safety.cross_checks import MOST_CYCLES_APART, TURNING_RAD_S
from leactl.safety.interlocks import Interlocks, TorqueDisagreement, VoltageDisagreement
from leactl.safety.thermal.box import Array, Box, Range
from leactl.safety.watching import Panel, Trip

TORQUE_CONSTANT_LOSS = 0.1  # by hot magnets (0.1 %/K) and saturation, at the most
CONTRADICTING_WINDOWS = 3  # in a row, that trip: a blow to the shaft may fall into two of them
LEAST_WINDOW_CYCLES = 4
STEADY_SHARE = 0.1  # share of the mean square by which a steady current may swing, or change between two windows
GLANCE_CYCLES = 4  # every fourth cycle of a long window is checked first: if these agree plainly, the rest is skipped
SENSED_ROLES = {"coupled": ("test", "load"), "locked": ("test",)}  # whose torques pass the sensor, by set-up
MOST_NAMED = 2  # conventions in a message, the nearest of those that a contradiction allows
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
    """Return the conventions whose factor lies in a range of true current over reading, the nearest first, as text."""
    near = [factor for factor in CONVENTIONS if least <= factor <= most]
    near.sort(key=lambda factor: abs(math.log(ratio / factor)))
    return ", or ".join(CONVENTIONS[factor] for factor in near[:MOST_NAMED])


Ends = tuple[float, float]


def _magnitudes(low: float, high: float) -> Ends:
    """Return the smallest and the largest magnitude between two ends."""
    if low > 0.0 or high < 0.0:
        return (low, high) if low > 0.0 else (-high, -low)
    return 0.0, max(-low, high)


class Currents(NamedTuple):
    """Bounds of a current's magnitude by a second sensor, sample by sample [A], and its sign."""

    direction: Array
    low: Array
    likely: Array
    high: Array


class TorqueModel(NamedTuple):
    """Parameters of a motor file for the torque that reaches the shaft, SI."""

    torque_constant: float
    coulomb_friction: Range
    viscous_damping: Range
    rotor_inertia: float

    @classmethod
    def of(cls, motor: Motor) -> Self:
        """Return the torque model of a motor file with tolerances."""
        box = Box.of(motor)
        return cls(motor.torque_constant, box.coulomb_friction, box.viscous_damping, motor.rotor_inertia)


class ByTorque:
    """Bounds of a current by the torque sensor between the actuators, and by friction and inertia of the rotor.

    The friction of a rotor that turns acts against its motion. A rotor that rests or turns back may have any friction
    up to the highest, in either direction.
    """

    label = "test torque"

    def __init__(self, settings: TorqueDisagreement, model: TorqueModel, sense: float) -> None:
        """`sense` is 1 for the actuator whose torque the sensor shows, -1 for the one that takes it."""
        self._settings, self._model, self._sense = settings, model, sense
        # gathered once: `extremes` is computed for every window
        self._coulomb, self._viscous = model.coulomb_friction, model.viscous_damping
        self._less, self._more = 1.0 - 0.01 * settings.share_percent, 1.0 + 0.01 * settings.share_percent
        self._weakest = model.torque_constant * (1.0 - TORQUE_CONSTANT_LOSS)

    def currents(self, torque: Array, velocity: Array, before: float, period: float) -> Currents:
        """Return bounds by torques [N*m] and velocities [rad/s], of cycles of `period` [s].

        `before` is the velocity at the end of the cycle before them [rad/s].
        """
        model, coulomb, viscous = self._model, self._coulomb, self._viscous
        torques, speed = self._sense * torque, np.abs(velocity)
        least, most = coulomb.low + viscous.low * speed, coulomb.high + viscous.high * speed
        if speed.min() > TURNING_RAD_S and abs(np.sign(velocity).sum()) == len(velocity):
            torques = torques + 0.5 * (least + most) * np.sign(velocity)
            uncertainty = 0.5 * (most - least)
        else:
            uncertainty = most
        acceleration = np.diff(velocity, prepend=before) / period
        uncertainty = uncertainty + model.rotor_inertia * np.abs(acceleration) + self._settings.tolerance_Nm
        magnitude = np.abs(torques)
        return Currents(
            np.sign(torques),
            np.maximum(magnitude * self._less - uncertainty, 0.0) / model.torque_constant,
            magnitude / model.torque_constant,
            (magnitude * self._more + uncertainty) / self._weakest,
        )

    def direction(self, torque: float, _velocity: float) -> float:
        """Return a number that is positive where this torque [N*m] belongs to a positive current."""
        return self._sense * torque

    def extremes(self, torques: Ends, velocities: Ends) -> Ends:
        """Return an upper bound of every `low` and a lower bound of every `high` of `currents` between these ends.

        The torque of acceleration is left out: it widens the bounds of `currents`.
        """
        coulomb, viscous = self._coulomb, self._viscous
        slowest, fastest = _magnitudes(*velocities)
        most = coulomb.high + viscous.high * slowest
        low, high = torques if self._sense > 0.0 else (-torques[1], -torques[0])
        if slowest > TURNING_RAD_S:
            least_friction, most_friction = coulomb.low + viscous.low * slowest, coulomb.high + viscous.high * fastest
            friction = (least_friction, most_friction) if velocities[0] > 0.0 else (-most_friction, -least_friction)
            low, high, uncertainty = low + friction[0], high + friction[1], 0.5 * (most - least_friction)
        else:
            uncertainty = most
        uncertainty += self._settings.tolerance_Nm
        smallest, largest = _magnitudes(low, high)
        least_torque = largest * self._less - uncertainty
        return (
            least_torque / self._model.torque_constant if least_torque > 0.0 else 0.0,
            (smallest * self._more + uncertainty) / self._weakest,
        )


class ByVoltage:
    """Bounds of a current by the q-axis voltage at a drive's terminals, less back-EMF, over the resistance."""

    def __init__(
        self, label: str, settings: VoltageDisagreement, back_emf_constant: float, resistances: Callable[[], Range]
    ) -> None:
        self.label = label
        self._settings, self._back_emf_constant, self._resistances = settings, back_emf_constant, resistances

    def currents(self, voltage: Array, velocity: Array, _before: float, _period: float) -> Currents:
        """Return bounds by the voltages [V] and velocities [rad/s] of some cycles."""
        share, resistance = 0.01 * self._settings.share_percent, self._resistances()
        back_emf = self._back_emf_constant * velocity
        driving = voltage - back_emf
        across = np.abs(driving)
        uncertainty = share * (np.abs(voltage) + np.abs(back_emf)) + self._settings.tolerance_V
        return Currents(
            np.sign(driving),
            np.maximum(across - uncertainty, 0.0) / resistance.high,
            across / math.sqrt(resistance.low * resistance.high),
            (across + uncertainty) / resistance.low,
        )

    def direction(self, voltage: float, velocity: float) -> float:
        """Return a number that is positive where this voltage [V] drives a positive current at a velocity [rad/s]."""
        return voltage - self._back_emf_constant * velocity

    def extremes(self, voltages: Ends, velocities: Ends) -> Ends:
        """Return an upper bound of every `low` and a lower bound of every `high` of `currents` between these ends.

        The part of the tolerance that grows with the voltage is left out: it widens the bounds of `currents`.
        """
        resistance, (slow, fast) = self._resistances(), sorted(self._back_emf_constant * end for end in velocities)
        smallest, largest = _magnitudes(voltages[0] - fast, voltages[1] - slow)
        tolerance = self._settings.tolerance_V
        return max(largest - tolerance, 0.0) / resistance.high, (smallest + tolerance) / resistance.low


AGREES, LESS, MORE, TURNED = range(4)  # reading against true current; turned: of the opposite sign


@dataclass
class Account:
    """One drive's current with its second sensor and the latest verdicts."""

    label: str
    witness: ByTorque | ByVoltage
    panel: Panel
    current: int  # index among the panel's values, as for the velocity
    velocity: int
    side: int = AGREES  # verdict of the last window
    read: float = math.nan  # A^2, mean square of the reading in the last window that was judged in full
    windows: int = 0  # in a row with that verdict


EVIDENCE, VELOCITY, CURRENTS = range(3)  # columns of a log; the second drive's current comes last
LoggedCycle = tuple[float, float, float, float]  # of one cycle


class Witnesses:
    """Trips on the current of a drive that a second sensor contradicts for `CONTRADICTING_WINDOWS` in a row.

    Two drives that share the sensor share a shaft too, so that the velocity of the first serves both.
    """

    def __init__(self, for_s: float, evidence: Panel, index: int, accounts: Sequence[Account], trip: Trip) -> None:
        """`index` is the position of the second sensor's reading among the values of the panel `evidence`."""
        self._for_s, self._trip = for_s, trip
        self._accounts = accounts
        # one drive's current is logged twice
        first, second = accounts[0], accounts[-1]
        self._sources = evidence, index, first.panel, first.velocity, first.current, second.panel, second.current
        self._log: list[LoggedCycle] = []
        self._window = self.due = math.inf
        self._began, self._carried_over = 0.0, 0  # s, and rows of the last window that remain in the log

    def begin(self, period: float, now: float) -> None:
        """Begin with cycles of `period` [s] at the time `now` [s]."""
        self._window = max(self._for_s / CONTRADICTING_WINDOWS, LEAST_WINDOW_CYCLES * period)
        self._log.clear()
        self._carried_over = 0
        self._began, self.due = now, now + self._window

    @property
    def log_with_sources(self) -> tuple[list[LoggedCycle], Panel, int, Panel, int, int, Panel, int]:
        """The log for each exchange, and its sources: three panels, each with the indices of its values."""
        return self._log, *self._sources

    def look(self, now: float) -> None:
        """Judge the window if it ends with the exchange that has just been logged.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        if now >= self.due:
            self._judge(now)

    def _judge(self, now: float) -> None:
        """Judge every account over the window and begin the next one."""
        log = self._log
        cycles = len(log)
        glanced = log[::GLANCE_CYCLES] if cycles >= GLANCE_CYCLES * GLANCE_CYCLES else log
        columns = list(zip(*glanced, strict=True))
        ends = [(min(column), max(column)) for column in columns]
        for current, account in enumerate(self._accounts, start=CURRENTS):
            if not self._plainly_agrees(account, current, columns, ends):
                self._judge_window(account, current, np.array(log), (now - self._began) / (cycles - self._carried_over))
        self._carried_over = min(MOST_CYCLES_APART, cycles)
        del log[: -self._carried_over]
        self._began, self.due = now, now + self._window

    @staticmethod
    def _plainly_agrees(
        account: Account, current: int, columns: Sequence[Sequence[float]], ends: Sequence[Ends]
    ) -> bool:
        """Return whether the extremes of the readings show already that no sample contradicts another."""
        witness = account.witness
        low, high = witness.extremes(ends[EVIDENCE], ends[VELOCITY])
        smallest, largest = _magnitudes(*ends[current])
        agrees = low <= smallest and largest <= high
        if agrees and low > 0.0:
            agrees = witness.direction(sum(columns[EVIDENCE]), sum(columns[VELOCITY])) * sum(columns[current]) > 0.0
        if agrees:
            account.side = account.windows = AGREES
        return agrees

    def _judge_window(self, account: Account, current: int, rows: Array, period: float) -> None:
        """Judge one window; a window with a reading that is no number contradicts nothing."""
        window, squares = rows[self._carried_over :], rows[:, current] ** 2
        read = float(squares[self._carried_over :].mean())
        # the sensors are not sampled at one moment: a current that changes may be read some cycles apart, and a sensor
        # that is slower than the loop may catch every other sample of a swing
        spread = MOST_CYCLES_APART / len(window) * float(squares.max() - squares.min())
        apart = spread + (float(np.abs(np.diff(squares)).mean()) if len(squares) > 1 else 0.0)
        velocity = window[:, VELOCITY]
        before = float(rows[self._carried_over - 1, VELOCITY]) if self._carried_over else float(velocity[0])
        currents = account.witness.currents(window[:, EVIDENCE], velocity, before, period)
        low, likely, high = (
            float(each @ each) / len(window) for each in (currents.low, currents.likely, currents.high)
        )
        along = float((currents.direction * currents.low) @ window[:, current]) / len(window)
        side = TURNED if along < -apart else LESS if low > read + apart else MORE if read > high + apart else AGREES
        changed = False
        if side == MORE:  # a slow second sensor shows too little of a current that swings or changes, never too much
            side = MORE if float(window[:, current].mean()) ** 2 >= (1.0 - STEADY_SHARE) * read else AGREES
            changed = abs(read - account.read) > STEADY_SHARE * max(read, account.read)
        account.read = read
        goes_on = side == account.side != AGREES and not changed
        account.windows = account.windows + 1 if goes_on else int(side != AGREES)
        account.side = side
        if account.windows >= CONTRADICTING_WINDOWS:
            self._contradict(account, *(math.sqrt(square) for square in (read, low, likely, high)))

    def _contradict(self, account: Account, read: float, low: float, likely: float, high: float) -> None:
        named = conventions(low / read, likely / read, high / read) if read and likely else ""
        bound = f"no more than {high:.4g} A" if account.side == MORE else f"no less than {low:.4g} A"
        ratio = f"{likely / read:.3g} times as much{f', near {named}' if named else ''}; " if read else ""
        if account.side == TURNED:
            bound, ratio = f"{bound} and the other way", "is a sign turned, "
        self._trip(
            f"{account.label} of {read:.4g} A contradicts {account.witness.label}, by which {likely:.4g} A flow,"
            f" {bound}, for {CONTRADICTING_WINDOWS * self._window:.3g} s: {ratio}is current_convention right, are both"
            " sensors whole?"
        )


def lone_sensors(
    interlocks: Interlocks, channels: Iterable[ChannelSpec], setup: str, currents: Mapping[str, str]
) -> list[str]:
    """Return one line for each winding whose bound rests on one sensor: no other sensor checks its current.

    Parameters
    ----------
    currents : quantity that measures the current of each role that a plan heats.
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
        available = [(watched, key) for second, whose, watched, key in seconds if (second, whose) in measured]
        if any(watched for watched, _key in available):
            continue
        hint = f"; interlocks.{available[0][1]} would hold a second one against it" if available else ""
        lines.append(
            f"the bound of the {role} winding rests on one sensor, {quantity}: in set-up '{setup}' nothing else shows"
            f" a current that is misread{hint}"
        )
    return lines
