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
CONTRADICTING_WINDOWS = 3  # so many in a row trip: a blow to the shaft may fall into two of them
LEAST_WINDOW_CYCLES = 4
STEADY_SHARE = 0.1  # share of the mean square by which a steady current may swing, or change between two windows
GLANCE_CYCLES = 4  # every fourth cycle of a long window is checked first: if they agree plainly, the others are skipped
SENSED_ROLES = {"coupled": ("test", "load"), "locked": ("test",)}  # whose torques pass the sensor, by set-up
MOST_NAMED_CONVENTIONS = 2  # in a message: the nearest of those that a contradiction allows
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


def conventions(lowest_ratio: float, ratio: float, highest_ratio: float) -> str:
    """Return the conventions whose factor lies between two ratios of true current to reading, the nearest first.

    ratio : the most likely one.
    """
    matching_factors = [factor for factor in CONVENTIONS if lowest_ratio <= factor <= highest_ratio]
    matching_factors.sort(key=lambda factor: abs(math.log(ratio / factor)))
    return ", or ".join(CONVENTIONS[factor] for factor in matching_factors[:MOST_NAMED_CONVENTIONS])


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
    """Bounds of a current by the torque sensor between the actuators and by friction and inertia of the rotor.

    The friction of a rotor that turns acts against its motion. A rotor that rests or turns back may have any friction
    up to the highest, in either direction.
    """

    label = "test torque"

    def __init__(self, settings: TorqueDisagreement, model: TorqueModel, sense: float) -> None:
        """`sense` is 1 for the actuator whose torque the sensor shows, -1 for the actuator that takes this torque."""
        self._settings, self._model, self._sense = settings, model, sense
        # gathered once: `extremes` is computed for every window
        self._coulomb, self._viscous = model.coulomb_friction, model.viscous_damping
        self._low_factor, self._high_factor = 1.0 - 0.01 * settings.share_percent, 1.0 + 0.01 * settings.share_percent
        self._lowest_torque_constant = model.torque_constant * (1.0 - TORQUE_CONSTANT_LOSS)

    def currents(self, torque: Array, velocity: Array, previous_velocity: float, period: float) -> Currents:
        """Return bounds by the torques [N*m] and velocities [rad/s] of some cycles of `period` [s].

        previous_velocity : velocity at the end of the cycle before them [rad/s].
        """
        model, coulomb, viscous = self._model, self._coulomb, self._viscous
        torques, speed = self._sense * torque, np.abs(velocity)
        least_friction, most_friction = coulomb.low + viscous.low * speed, coulomb.high + viscous.high * speed
        if speed.min() > TURNING_RAD_S and abs(np.sign(velocity).sum()) == len(velocity):
            torques = torques + 0.5 * (least_friction + most_friction) * np.sign(velocity)
            uncertainty = 0.5 * (most_friction - least_friction)
        else:
            uncertainty = most_friction
        acceleration = np.diff(velocity, prepend=previous_velocity) / period
        uncertainty = uncertainty + model.rotor_inertia * np.abs(acceleration) + self._settings.tolerance_Nm
        magnitude = np.abs(torques)
        return Currents(
            np.sign(torques),
            np.maximum(magnitude * self._low_factor - uncertainty, 0.0) / model.torque_constant,
            magnitude / model.torque_constant,
            (magnitude * self._high_factor + uncertainty) / self._lowest_torque_constant,
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
        most_at_slowest = coulomb.high + viscous.high * slowest
        low, high = torques if self._sense > 0.0 else (-torques[1], -torques[0])
        if slowest > TURNING_RAD_S:
            least_friction, most_friction = coulomb.low + viscous.low * slowest, coulomb.high + viscous.high * fastest
            friction = (least_friction, most_friction) if velocities[0] > 0.0 else (-most_friction, -least_friction)
            low, high, uncertainty = low + friction[0], high + friction[1], 0.5 * (most_at_slowest - least_friction)
        else:
            uncertainty = most_at_slowest
        uncertainty += self._settings.tolerance_Nm
        smallest, largest = _magnitudes(low, high)
        least_torque = largest * self._low_factor - uncertainty
        return (
            least_torque / self._model.torque_constant if least_torque > 0.0 else 0.0,
            (smallest * self._high_factor + uncertainty) / self._lowest_torque_constant,
        )


class ByVoltage:
    """Bounds of a current: the q-axis voltage at a drive's terminals less back-EMF, divided by the resistance."""

    def __init__(
        self, label: str, settings: VoltageDisagreement, back_emf_constant: float, resistances: Callable[[], Range]
    ) -> None:
        self.label = label
        self._settings, self._back_emf_constant, self._resistances = settings, back_emf_constant, resistances

    def currents(self, voltage: Array, velocity: Array, _previous_velocity: float, _period: float) -> Currents:
        """Return bounds by the voltages [V] and velocities [rad/s] of some cycles."""
        share, resistance = 0.01 * self._settings.share_percent, self._resistances()
        back_emf = self._back_emf_constant * velocity
        driving_voltage = voltage - back_emf
        driving_magnitude = np.abs(driving_voltage)
        uncertainty = share * (np.abs(voltage) + np.abs(back_emf)) + self._settings.tolerance_V
        return Currents(
            np.sign(driving_voltage),
            np.maximum(driving_magnitude - uncertainty, 0.0) / resistance.high,
            driving_magnitude / math.sqrt(resistance.low * resistance.high),
            (driving_magnitude + uncertainty) / resistance.low,
        )

    def direction(self, voltage: float, velocity: float) -> float:
        """Return a number that is positive where this voltage [V] drives a positive current at a velocity [rad/s]."""
        return voltage - self._back_emf_constant * velocity

    def extremes(self, voltages: Ends, velocities: Ends) -> Ends:
        """Return an upper bound of every `low` and a lower bound of every `high` of `currents` between these ends.

        The part of the tolerance that grows with the voltage is left out: it widens the bounds of `currents`.
        """
        resistance, (lowest_back_emf, highest_back_emf) = (
            self._resistances(),
            sorted(self._back_emf_constant * end for end in velocities),
        )
        smallest, largest = _magnitudes(voltages[0] - highest_back_emf, voltages[1] - lowest_back_emf)
        tolerance = self._settings.tolerance_V
        return max(largest - tolerance, 0.0) / resistance.high, (smallest + tolerance) / resistance.low


AGREES, LESS, MORE, TURNED = range(4)  # reading compared with the true current; TURNED: of the opposite sign


@dataclass
class Account:
    """One drive's current with its second sensor and the latest verdict."""

    label: str
    witness: ByTorque | ByVoltage
    panel: Panel
    current_index: int  # among the panel's values
    velocity_index: int  # among the panel's values
    verdict: int = AGREES  # verdict of the last window
    mean_square: float = math.nan  # A^2, mean square of the reading in the last window that was judged in full
    windows: int = 0  # in a row with that verdict


EVIDENCE, VELOCITY, CURRENTS = range(3)  # columns of a log; the second drive's current follows the first drive's
LoggedCycle = tuple[float, float, float, float]  # second sensor, velocity [rad/s] and two currents [A] in one cycle


class Witnesses:
    """Trips on the current of a drive that a second sensor contradicts in `CONTRADICTING_WINDOWS` in a row.

    Two drives that share the sensor share a shaft too, so that the velocity of the first serves both.
    """

    def __init__(self, for_s: float, evidence: Panel, index: int, accounts: Sequence[Account], trip: Trip) -> None:
        """`index` is the position of the second sensor's reading among the values of the panel `evidence`."""
        self._for_s, self._trip = for_s, trip
        self._accounts = accounts
        # the current of a single drive is logged twice, so that a log always has four columns
        first, second = accounts[0], accounts[-1]
        self._sources = (
            evidence,
            index,
            first.panel,
            first.velocity_index,
            first.current_index,
            second.panel,
            second.current_index,
        )
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
        """The log, to which each exchange adds a row, and the panels of its columns with the indices of the values."""
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
        glanced_rows = log[::GLANCE_CYCLES] if cycles >= GLANCE_CYCLES * GLANCE_CYCLES else log
        columns = list(zip(*glanced_rows, strict=True))
        column_extremes = [(min(column), max(column)) for column in columns]
        for current_column, account in enumerate(self._accounts, start=CURRENTS):
            if not self._plainly_agrees(account, current_column, columns, column_extremes):
                self._judge_window(
                    account, current_column, np.array(log), (now - self._began) / (cycles - self._carried_over)
                )
        self._carried_over = min(MOST_CYCLES_APART, cycles)
        del log[: -self._carried_over]
        self._began, self.due = now, now + self._window

    @staticmethod
    def _plainly_agrees(
        account: Account, current_column: int, columns: Sequence[Sequence[float]], column_extremes: Sequence[Ends]
    ) -> bool:
        """Return whether the extremes of the readings suffice to show that no current contradicts the second sensor.

        columns, column_extremes : values of each column of the log, and their extremes.
        """
        witness = account.witness
        low, high = witness.extremes(column_extremes[EVIDENCE], column_extremes[VELOCITY])
        smallest, largest = _magnitudes(*column_extremes[current_column])
        agrees = low <= smallest and largest <= high
        if agrees and low > 0.0:
            agrees = (
                witness.direction(sum(columns[EVIDENCE]), sum(columns[VELOCITY])) * sum(columns[current_column]) > 0.0
            )
        if agrees:
            account.verdict = account.windows = AGREES
        return agrees

    def _judge_window(self, account: Account, column: int, rows: Array, period: float) -> None:
        """Judge one window of cycles of `period` [s]; a window in which a reading is NaN contradicts nothing."""
        window, squares = rows[self._carried_over :], rows[:, column] ** 2
        square = float(squares[self._carried_over :].mean())
        # the sensors are not sampled at the same moment: a current that changes may be read some cycles apart, and a
        # sensor that is slower than the loop may miss every other sample of a swing
        sampling_spread = MOST_CYCLES_APART / len(window) * float(squares.max() - squares.min())
        slack = sampling_spread + (float(np.abs(np.diff(squares)).mean()) if len(squares) > 1 else 0.0)
        velocity = window[:, VELOCITY]
        previous_velocity = float(rows[self._carried_over - 1, VELOCITY]) if self._carried_over else float(velocity[0])
        currents = account.witness.currents(window[:, EVIDENCE], velocity, previous_velocity, period)
        low, likely, high = (
            float(bound @ bound) / len(window) for bound in (currents.low, currents.likely, currents.high)
        )
        product = float((currents.direction * currents.low) @ window[:, column]) / len(window)
        verdict = (
            TURNED if product < -slack else LESS if low > square + slack else MORE if square > high + slack else AGREES
        )
        has_changed = False
        if verdict == MORE:  # a slow second sensor shows too little of a current that swings or changes, never too much
            verdict = MORE if float(window[:, column].mean()) ** 2 >= (1.0 - STEADY_SHARE) * square else AGREES
            has_changed = abs(square - account.mean_square) > STEADY_SHARE * max(square, account.mean_square)
        account.mean_square = square
        is_repeated = verdict == account.verdict != AGREES and not has_changed
        account.windows = account.windows + 1 if is_repeated else int(verdict != AGREES)
        account.verdict = verdict
        if account.windows >= CONTRADICTING_WINDOWS:
            self._contradict(account, *(math.sqrt(mean) for mean in (square, low, likely, high)))

    def _contradict(self, account: Account, reading: float, low: float, likely: float, high: float) -> None:
        """Trip with a message that compares a reading with the currents by the second sensor [A], all rms values."""
        convention = conventions(low / reading, likely / reading, high / reading) if reading and likely else ""
        bound = f"no more than {high:.4g} A" if account.verdict == MORE else f"no less than {low:.4g} A"
        ratio = (
            f"{likely / reading:.3g} times as much{f', near {convention}' if convention else ''}; " if reading else ""
        )
        if account.verdict == TURNED:
            bound, ratio = f"{bound} and the other way", "is a sign turned, "
        self._trip(
            f"{account.label} of {reading:.4g} A contradicts {account.witness.label}, by which {likely:.4g} A flow,"
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
            second_sensors = [("line_voltage", role, True, "its supply's voltage")]
        else:
            # neither friction nor back-EMF is known without a velocity
            has_velocity = ("velocity", role) in measured
            torque_is_sensed = has_velocity and role in SENSED_ROLES.get(setup, ())
            by_torque, by_voltage = interlocks.torque_disagreement, interlocks.voltage_disagreement
            second_sensors = (
                [("torque", "test", by_torque is not None, "torque_disagreement")] if torque_is_sensed else []
            )
            second_sensors += (
                [("q_axis_voltage", role, by_voltage is not None, "voltage_disagreement")] if has_velocity else []
            )
        available = [
            (is_watched, key)
            for second_quantity, channel_role, is_watched, key in second_sensors
            if (second_quantity, channel_role) in measured
        ]
        if any(is_watched for is_watched, _key in available):
            continue
        hint = f"; interlocks.{available[0][1]} would hold a second one against it" if available else ""
        lines.append(
            f"the bound of the {role} winding rests on one sensor, {quantity}: in set-up '{setup}' nothing else shows"
            f" a current that is misread{hint}"
        )
    return lines
