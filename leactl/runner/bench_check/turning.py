"""Check a bench by a small current: direction of the shaft, agreement of channels with each other and the motor file.

Each relation is a slope over the whole move, with a standard error that takes the autocorrelation of its residuals into
account. Torque on the shaft is T = T0 + Kt i - c sign(w) - b w - J dw/dt of the test actuator, and the negative of it
for the load actuator, whether a drive is on or off: turning the shaft by the other drive shows friction and inertia
alone, so that the slope over the current is Kt.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.analysis.signals.levels import standard_error
from leactl.gap.setup.conventions import UNIT_FACTORS, convention, whole_number
from leactl.runfile.read.reader import Run
from leactl.runner.bench_check.silence import silences
from leactl.runner.bench_check.statement import DEVIATION_STDS, Statement, StatementVerdict, ratio, setting
from leactl.runner.drill.emulated import drives
from leactl.runner.request import Request
from leactl.runner.thermal_admission import motors_of
from leactl.safety.cross_checks import TURNING_RAD_S
from leactl.safety.witnesses import SENSED_ROLES, TORQUE_CONSTANT_LOSS, conventions

Array = npt.NDArray[np.float64]

INERTIA_FACTOR = 3.0  # to the motor files' inertia, at most, by couplings and sensors; wrong counts give a factor of 4
SLOW_SHARE = 0.2  # of the highest speed; below, friction may change its sign between two samples
FEWEST_SAMPLES = 20  # of a slope
WINDOW_SAMPLES = 5  # the change of the angle is compared with the velocity over as many samples
TURNED_RAD = 0.02  # least travel of a shaft that has turned, far above its torsion and the counts of an encoder
LAG_ERROR = 0.01  # of a ratio of two channels of motion, by the lag of a filter
LOOP_ERROR = 0.1  # relative, of a current whose demand swings at 2 Hz
SAME_FACTOR = 0.1  # largest relative difference of the factors of both drives if the torque sensor is the cause
ENDED_EARLY = "the move ended early"
SENSES = {"test": 1.0, "load": -1.0}  # sign of a role's torque at the sensor
COUNT_SETTINGS = ("counts_per_turn",)
CONSTANT, INERTIA = 0, 3  # indices into the coefficients of a torque


class Slope(NamedTuple):
    """A coefficient with its standard error."""

    value: float
    std: float


class DriveMotion(NamedTuple):
    """One drive's channels, all at the stamps of the loop."""

    time: Array
    demand: Array  # A
    current: Array  # A
    velocity: Array  # rad/s
    angle: Array  # rad
    on: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, run: Run, role: str) -> "DriveMotion":
        """Read the channels of the drive in a role."""
        current = run.channel("q_axis_current", role)
        quantities = ("q_axis_current_reference", "velocity", "angle", "drive_enabled")
        demand, velocity, angle, enabled = (run.channel(name, role).values for name in quantities)
        return cls(current.time, demand, current.values, velocity, angle, enabled == 1.0)

    def travels(self) -> tuple[Array, Array]:
        """Return the integral of the velocity and the change of the angle from sample to sample [rad].

        Both have the shape (samples - 1,).
        """
        return 0.5 * (self.velocity[1:] + self.velocity[:-1]) * np.diff(self.time), np.diff(self.angle)


def slopes(columns: Array, response: Array) -> list[Slope]:
    """Fit a response by a linear combination of columns; return no slopes if the samples do not determine them.

    Parameters
    ----------
    columns : shape (samples, columns).
    response : shape (samples,); samples that are not finite are left out.
    """
    finite = np.isfinite(columns).all(axis=1) & np.isfinite(response)
    design, values = columns[finite], response[finite]
    lengths = np.sqrt(np.sum(design**2, axis=0))
    if len(values) < FEWEST_SAMPLES or not lengths.all() or np.linalg.cond(design / lengths) > 1e6:
        return []
    inverse = np.linalg.inv(design.T @ design)
    coefficients = inverse @ design.T @ values
    influence = len(values) * (design * (values - design @ coefficients)[:, np.newaxis]) @ inverse
    return [
        Slope(float(value), standard_error(column_influence))
        for value, column_influence in zip(coefficients, influence.T, strict=True)
    ]


def is_of_size_one(slope: Slope) -> bool:
    """Return whether a ratio of two channels of motion may be 1 or -1."""
    size = abs(slope.value)
    return abs(math.log(size)) < LAG_ERROR + DEVIATION_STDS * slope.std / size


def factor_of_a_turn(slope: Slope, pole_pairs: int) -> str:
    """Return the probable cause of a factor between two angles or velocities, as text; empty if none is known."""
    size, sign_text = abs(slope.value), "turned" if slope.value < 0.0 else ""
    error = DEVIATION_STDS * slope.std / size
    if is_of_size_one(slope):
        return f"turned, by {size:.3g}" if sign_text and abs(math.log(size)) > LAG_ERROR else sign_text
    name, number = convention(size, error), whole_number(size, error)
    if name in UNIT_FACTORS and number is None:
        return " and ".join(filter(None, (sign_text, f"near {name}: another unit")))
    if number is None:
        return f"turned, and by {size:.4g}, which is no usual factor" if sign_text else ""
    inverse = "1/" if size < 1.0 else ""
    cause = (
        "pole pairs" if number == pole_pairs else "lines for counts" if number in (2, 4) else "a gear, or pole pairs"
    )
    return " and ".join(filter(None, (sign_text, f"near {inverse}{number}: {cause}")))


class Turning:
    """The checks of one moving run, which may have ended early."""

    def __init__(self, run: Run, request: Request) -> None:
        self._run, self._request = run, request
        names = drives(request.devices)
        self._drives = {names[device.name]: device for device in request.devices if device.name in names}
        self._motions = {role: DriveMotion.of(run, role) for role in self._drives}
        self._silences = silences(run, request.bench.limits, 1.0 / request.plan.rate_Hz)
        self._motors = motors_of(request.bench)

    def statements(self) -> Iterator[Statement]:
        """Yield the statements on each drive, on the shaft between them, and on the torque sensor."""
        for (quantity, role), silence in self._silences.items():
            why = f"{silence}: is its cable, or its bus, loose?"
            yield Statement(silence.device, f"{quantity} of {role}", StatementVerdict.WRONG, why=why)
        for role in self._drives:
            yield from self._drive_statements(role)
        torques = self._torques()
        if self._request.plan.setup == "coupled" and len(self._drives) == 2:
            yield self._shaft_statement(torques)
        if self._run.has("torque"):
            yield from self._torque_statements(torques)

    def _drive_statements(self, role: str) -> Iterator[Statement]:
        """Yield the statements on a drive's current, its direction, and the agreement of its velocity and angle."""
        motion, name = self._motions[role], self._drives[role].name
        demanded = motion.on & (motion.demand != 0.0)
        if fitted := slopes(motion.demand[demanded, np.newaxis], motion.current[demanded]):
            statement = ratio(name, "current over its demand", *fitted[0], LOOP_ERROR)
            no_current = "no current is read while one is demanded: is the motor connected?"
            yield statement if fitted[0].value else replace(statement, why=no_current)
        else:
            why = self._silence_of(role, "q_axis_current", "drive_enabled") or ENDED_EARLY
            yield Statement(name, "current over its demand", StatementVerdict.UNDECIDED, why=why)
        yield self._direction_statement(role)
        yield self._angle_over_velocity(role, *motion.travels())

    def _silence_of(self, role: str, *quantities: str) -> str:
        """Return as text which of these channels of a role fell silent, and since when; empty if none did."""
        silent = [(name, self._silences[name, role]) for name in quantities if (name, role) in self._silences]
        return "; ".join(f"{name} of {role}: {silence}" for name, silence in silent)

    def _direction_statement(self, role: str) -> Statement:
        """State whether a positive current accelerates the shaft forwards, by the sign of the fitted inertia."""
        motion, name, about = self._motions[role], self._drives[role].name, "inertia that its current turns"
        moving = motion.on & (np.abs(motion.velocity) > TURNING_RAD_S)
        rate = np.gradient(motion.velocity, motion.time) if len(motion.time) > 1 else motion.velocity
        terms = np.column_stack([rate, motion.velocity, np.sign(motion.velocity)])[moving]
        fitted = slopes(terms, self._motors[role].torque_constant * motion.current[moving])
        if not fitted or not abs(fitted[0].value) > DEVIATION_STDS * fitted[0].std:
            silent = self._silence_of(role, "velocity", "q_axis_current", "drive_enabled")
            why = silent or "the shaft has hardly turned: is it free, is --current enough?"
            return Statement(name, about, StatementVerdict.UNDECIDED, why=why)
        motors = self._motors.values() if self._request.plan.setup == "coupled" else [self._motors[role]]
        rotor_inertia = sum(motor.rotor_inertia for motor in motors)
        low, high, (value, std) = rotor_inertia / INERTIA_FACTOR, rotor_inertia * INERTIA_FACTOR, fitted[0]
        verdict, why, change = StatementVerdict.OK, "", ""
        if value < 0.0:
            verdict, why = (
                StatementVerdict.WRONG,
                "a current turns it backwards: commutation or encoder direction of the drive",
            )
        elif not low <= value <= high:
            verdict = StatementVerdict.UNDECIDED
            why = f"as if a turn had {rotor_inertia / value:.2g} times the counts, or as if more turned than the rotors"
            change = setting(self._request, self._drives[role], COUNT_SETTINGS, "does the encoder have as many?")
        return Statement(name, about, verdict, value, std, "kg*m^2", low, high, why, change)

    def _angle_over_velocity(self, role: str, by_velocity: Array, by_angle: Array) -> Statement:
        """State whether the change of the angle is the integral of the velocity.

        Parameters
        ----------
        by_velocity, by_angle : travel from sample to sample by either channel [rad].
        """
        device, about = self._drives[role], "angle over integral of velocity"
        rows = len(by_velocity) // WINDOW_SAMPLES * WINDOW_SAMPLES
        windows = np.stack(
            [travel[:rows].reshape(-1, WINDOW_SAMPLES).sum(axis=1) for travel in (by_velocity, by_angle)]
        )
        velocity, angle = windows[:, np.isfinite(windows).all(axis=0)]
        silent = self._silence_of(role, "velocity", "angle")
        reach = [float(np.ptp(np.cumsum(travel))) if len(travel) else 0.0 for travel in (velocity, angle)]
        if max(reach) < TURNED_RAD:
            return Statement(device.name, about, StatementVerdict.UNDECIDED, why=silent or "the shaft has not turned")
        if not velocity.any() or not angle.any():
            frozen = "velocity" if reach[0] < reach[1] else "angle"
            return Statement(
                device.name,
                about,
                StatementVerdict.WRONG,
                why=f"frozen: the {frozen} is constant while the other moves",
            )
        fitted = slopes(velocity[:, np.newaxis], angle)
        if not fitted:
            return Statement(device.name, about, StatementVerdict.UNDECIDED, why=silent or ENDED_EARLY)
        statement = ratio(device.name, about, *fitted[0], LAG_ERROR)
        if statement.verdict is not StatementVerdict.WRONG:
            return statement
        cause = factor_of_a_turn(fitted[0], self._motors[role].pole_pairs)
        advice = f"divide the angle's scale by {fitted[0].value:.4g}, or multiply the velocity's by it"
        return replace(statement, why=cause, change=setting(self._request, device, COUNT_SETTINGS, advice))

    def _shaft_statement(self, torques: Mapping[str, Sequence[Slope]]) -> Statement:
        """State whether the velocities of both drives are those of one shaft."""
        test, load = (self._motions[role].velocity for role in ("test", "load"))
        about, device = "velocity over that of test", self._drives["load"]
        moving = (np.abs(test) > TURNING_RAD_S) | (np.abs(load) > TURNING_RAD_S)
        for role, velocity in (("test", test[moving]), ("load", load[moving])):
            if len(velocity) >= FEWEST_SAMPLES and not np.nan_to_num(velocity).any():
                why = "no velocity of it while the other drive's says that the shaft turns"
                return Statement(self._drives[role].name, about, StatementVerdict.WRONG, why=why)
        fitted = slopes(test[moving, np.newaxis], load[moving])
        if not fitted:
            silent = "; ".join(filter(None, (self._silence_of(role, "velocity") for role in ("test", "load"))))
            return Statement(
                device.name, about, StatementVerdict.UNDECIDED, why=silent or "the shaft has hardly turned"
            )
        statement = ratio(device.name, about, *fitted[0], LAG_ERROR)
        if statement.verdict is not StatementVerdict.WRONG:
            return statement
        slope, cause = fitted[0], factor_of_a_turn(fitted[0], self._motors["test"].pole_pairs)
        if slope.value < 0.0 and is_of_size_one(slope):
            line = setting(self._request, device, ("sign",), "turn it: the drive is mounted the other way")
            return replace(statement, why=cause, change=line)
        errors = {role: self._inertia_error(role, fit) for role, fit in torques.items() if fit}
        device = self._drives[max(errors, key=lambda role: errors[role])] if len(errors) == 2 else device
        advice = f"a turn of it has {abs(slope.value):.4g} or {1.0 / abs(slope.value):.4g} times as many"
        advice += "; it is mounted the other way as well (sign)" if slope.value < 0.0 else ""
        by_inertia = ", by the inertia of" if len(errors) == 2 else "; of either drive, first of"
        why = f"{cause or 'no usual factor'}{by_inertia} {device.name}"
        return replace(statement, why=why, change=setting(self._request, device, COUNT_SETTINGS, advice))

    def _inertia_error(self, role: str, fit: Sequence[Slope]) -> float:
        """Return |log| of the ratio of the fitted inertia to that of the motor file; infinite if it is not positive."""
        inertia = fit[INERTIA].value / self._motors[role].rotor_inertia
        return abs(math.log(inertia)) if inertia > 0.0 else math.inf

    def _torques(self) -> dict[str, Sequence[Slope]]:
        """Fit torque constant, friction, damping and inertia of each role whose torque passes the sensor.

        A role is left out if the other drive has not turned the shaft, because then friction of the role cannot be told
        from the torque of its current.
        """
        fits: dict[str, Sequence[Slope]] = {}
        complete = self._run.has("torque") and self._run.status == "complete"
        for role in SENSED_ROLES.get(self._request.plan.setup, ()) if complete else ():
            if role not in self._drives:
                continue
            torque, motion = self._run.channel("torque"), self._motions[role]
            finite = np.isfinite(motion.velocity) & np.isfinite(motion.current)
            if finite.sum() < FEWEST_SAMPLES:
                continue
            acceleration = np.gradient(motion.velocity[finite], motion.time[finite])
            columns = (motion.current[finite], motion.velocity[finite], acceleration, motion.on[finite])
            current, velocity, rate, on = (np.interp(torque.time, motion.time[finite], column) for column in columns)
            moving = np.abs(velocity) > max(TURNING_RAD_S, SLOW_SHARE * float(np.max(np.abs(velocity))))
            if np.sum(moving & (on == 0.0)) < FEWEST_SAMPLES:
                continue
            sense = SENSES[role]
            terms = [sense * current, -sense * np.sign(velocity), -sense * velocity, -sense * rate]
            design = np.column_stack([*terms, np.ones_like(velocity)])
            fits[role] = slopes(design[moving], torque.values[moving])
        return fits

    def _torque_statements(self, fits: Mapping[str, Sequence[Slope]]) -> Iterator[Statement]:
        """State whether the torque sensor agrees with the currents and the torque constants of the motor files."""
        about, statements = "torque of its current over the motor file's", dict[str, Statement]()
        for role in self._drives if self._request.plan.setup == "coupled" else ():
            fit = fits.get(role)
            constant, name = self._motors[role].torque_constant, self._drives[role].name
            if fit:
                relative = (fit[CONSTANT].value / constant, fit[CONSTANT].std / constant)
                statements[role] = ratio(name, about, *relative, TORQUE_CONSTANT_LOSS)
            else:
                hint = "it takes a shaft that either drive turns, in turn"
                silent = [self._silence_of("test", "torque"), self._silence_of(role, "q_axis_current", "velocity")]
                why = "; ".join(filter(None, silent)) or (hint if self._run.status == "complete" else ENDED_EARLY)
                statements[role] = Statement(name, about, StatementVerdict.UNDECIDED, why=why)
        factors = {
            role: statement.measured
            for role, statement in statements.items()
            if statement.verdict is StatementVerdict.WRONG
        }
        size = max(1.0, *map(abs, factors.values())) if factors else 1.0
        by_sensor = len(factors) == 2 and abs(factors["test"] - factors["load"]) < SAME_FACTOR * size
        for role, statement in statements.items():
            yield self._with_cause(role, statement, by_sensor) if role in factors else statement

    def _with_cause(self, role: str, statement: Statement, by_sensor: bool) -> Statement:
        """Return a statement on a wrong torque with its cause: the sensor, or else the current or the motor file.

        Parameters
        ----------
        by_sensor : whether both drives show the same factor.
        """
        factor, margin = statement.measured, DEVIATION_STDS * statement.std
        size = abs(factor)
        likely = conventions(size - margin - SAME_FACTOR / 4.0, size, size + margin + SAME_FACTOR / 4.0)
        why = f"{'or both currents are' if by_sensor else 'the current is'} near {likely}" if likely else ""
        device = self._drives[role]
        if by_sensor:
            name = self._run.channel("torque").device
            device = next(candidate for candidate in self._request.devices if candidate.name == name)
        key, advice = "sign", "turn it"
        if size < SAME_FACTOR:
            why, key, advice = "the torque does not follow the current", "", "is it connected?"
        elif factor > 0.0:
            key, advice = "scale_per_V" if by_sensor else "current_convention", f"off by {factor:.4g}"
            constant = f"torque_constant of motor '{self._request.bench.motors[role]}'"  # type: ignore[index]
            advice += f", or {constant} by {factor:.4g}" + (", and so for the other drive" if by_sensor else "")
        elif abs(size - 1.0) > TORQUE_CONSTANT_LOSS:
            advice += f"; the scale is off by {size:.4g} as well"
        keys = next(
            (
                measurable.place
                for measurable in device.settings.shown()
                if by_sensor and measurable.quantity == "torque"
            ),
            (),
        )
        location = ("devices", device.name, "settings", *keys[:2])
        line = self._request.bench_document.fault((*location, *filter(None, [key])), advice)
        return replace(statement, why=why, change=line)
