"""Compute the energy of an actuator over one cycle of a joint from its losses, and find the best transmission ratio.

    Kt i = tau / (N eta) + J N a + b N w + f sgn(w)      tau eta / N where the joint drives the actuator
    P = R(T) i^2 + Kt i N w

N is the ratio, eta the efficiency of the transmission, w and a are velocity and acceleration of the joint. Inertia
takes no net mechanical energy over a cycle, but it takes current.

Joule heat is quadratic in the sum of the torque's parts. Part k gets the share R/Kt^2 mean(tau_k tau), its Shapley
value: the shares add up to the heat, and a part that reduces the total torque has a negative share. The paper announces
this comparison (section "Introduction") and does not print it.
"""

from dataclasses import dataclass

import numpy as np

from leactl.errors import InputError
from leactl.model.cycle import Array, Cycle
from leactl.model.motor_schema import MotorSheet
from leactl.model.winding import FRAMES, resistance_ratio, voltage_ceiling

REQUIRED_FIELDS = (
    "torque_constant",
    "back_emf_constant",
    "phase_resistance",
    "phase_inductance",
    "pole_pairs",
    "rotor_inertia",
    "viscous_damping",
)
RATIO_RANGE = (0.05, 5000.0)  # turns of the motor for one of the joint
RATIO_COUNT = 300  # ratios tried, evenly on a logarithmic scale; as many again around the best of them
REST_VELOCITY = 1e-9  # rad/s; a joint at a lower speed counts as at rest


@dataclass(frozen=True)
class DriveSupply:
    """Limits of a drive and its bus, ambient temperature and winding temperature."""

    bus_voltage: float = 29.6  # V
    line_current: float | None = None  # A, largest amplitude in a lead; None: no limit
    ambient: float = 25.0  # degC
    winding_temperature: float | None = None  # degC; None: the steady state after many cycles


@dataclass(frozen=True)
class Stride:
    """Energies [J] and peaks of one actuator over one cycle at one ratio."""

    ratio: float  # turns of the motor for one of the joint
    joint_work: float  # net work onto the joint
    electrical: float  # from the bus, minus what is fed back
    electrical_without_return: float  # from a bus that accepts no energy back
    joule_load: float
    joule_friction: float
    joule_inertia: float
    viscous: float
    coulomb: float | None  # None: the motor's Coulomb friction is not known
    transmission: float
    winding_temperature: float | None  # degC; None: not known, the heat is computed at the file's resistance
    peak_line_current: float  # A, amplitude
    peak_voltage: float  # V, q axis
    voltage_ceiling: float  # V
    over_voltage: int  # points of the cycle above the voltage ceiling
    over_current: int  # points of the cycle above the supply's line current
    too_hot: bool
    first_beyond_percent: float | None  # percent of the cycle at the first point above a limit; None: there is none

    @property
    def joule(self) -> float:
        """Joule heat of the winding [J]."""
        return self.joule_load + self.joule_friction + self.joule_inertia

    @property
    def feasible(self) -> bool:
        """Whether no point of the cycle exceeds a limit and the winding stays below its temperature limit."""
        return not (self.over_voltage or self.over_current or self.too_hot)


def stride(
    motor: MotorSheet, cycle: Cycle, ratio: float, efficiency: float = 1.0, supply: DriveSupply | None = None
) -> Stride:
    """Compute one cycle at one ratio (turns of the motor for one of the joint) and efficiency of the transmission.

    Raises
    ------
    InputError : parameters that the motor file lacks, or a ratio, an efficiency or a supply out of range.
    """
    if not RATIO_RANGE[0] <= ratio <= RATIO_RANGE[1]:
        raise InputError(f"ratio {ratio:g}: from {RATIO_RANGE[0]:g} to {RATIO_RANGE[1]:g} was expected")
    return _RatioSweep(motor, cycle, np.array([ratio]), efficiency, supply or DriveSupply()).stride(0)


def best_ratio(motor: MotorSheet, cycle: Cycle, efficiency: float = 1.0, supply: DriveSupply | None = None) -> Stride:
    """Find the feasible ratio of least electrical energy; if none is feasible, one with the fewest points over a limit.

    Raises
    ------
    InputError : as `stride`.
    """
    low, high = RATIO_RANGE
    for _ in range(2):
        ratios = np.geomspace(low, high, RATIO_COUNT)
        sweep = _RatioSweep(motor, cycle, ratios, efficiency, supply or DriveSupply())
        best = sweep.best()
        low, high = ratios[max(best - 1, 0)], ratios[min(best + 1, RATIO_COUNT - 1)]
    return sweep.stride(best)


class _RatioSweep:
    """One cycle at several ratios; arrays have the shape (ratios, points), or (ratios,) for temperatures."""

    def __init__(self, motor: MotorSheet, cycle: Cycle, ratios: Array, efficiency: float, supply: DriveSupply) -> None:
        missing_fields = motor.missing(*REQUIRED_FIELDS)
        if missing_fields:
            raise InputError(
                f"motor '{motor.name}' has no {', '.join(missing_fields)}: its energy cannot be worked out"
            )
        if not 0.0 < efficiency <= 1.0:
            raise InputError(f"efficiency {efficiency:g}: more than 0 and at most 1 was expected")
        if not 0.0 < supply.bus_voltage <= 1000.0:
            raise InputError(f"bus voltage {supply.bus_voltage:g} V: more than 0 and at most 1000 V was expected")
        if supply.line_current is not None and not 0.0 < supply.line_current <= 10_000.0:
            raise InputError(f"line current {supply.line_current:g} A: more than 0 and at most 10000 A was expected")
        assert motor.torque_constant and motor.rotor_inertia and motor.viscous_damping is not None
        self._motor, self._cycle, self._ratios, self._supply = motor, cycle, ratios, supply
        ratio_column = ratios[:, np.newaxis]
        lossless_load = cycle.torque / ratio_column
        motor_drives = cycle.torque * cycle.velocity >= 0.0
        self._load = lossless_load * np.where(motor_drives, 1.0 / efficiency, efficiency)
        self._speed = ratio_column * cycle.velocity
        self._inertia = motor.rotor_inertia * ratio_column * cycle.acceleration
        self._drag = motor.viscous_damping * self._speed
        self._coulomb = self._coulomb_torque(motor.coulomb_friction or 0.0)
        self._torque = self._load + self._inertia + self._drag + self._coulomb
        self._current = self._torque / motor.torque_constant
        self._transmission_loss = (self._load - lossless_load) * self._speed
        self.temperature = self._temperatures()
        self.resistance = self._resistances()
        self._compare_with_limits()

    def _coulomb_torque(self, friction: float) -> Array:
        """Return the Coulomb friction torque [N*m]; at rest, up to `friction` it opposes load and inertia."""
        at_rest = np.abs(self._cycle.velocity) < REST_VELOCITY
        holding_friction = -np.clip(self._load + self._inertia, -friction, friction)
        return np.where(at_rest, holding_friction, friction * np.sign(self._speed))

    def _temperatures(self) -> Array:
        """Return the winding temperature [degC] at each ratio: the supply's, else the steady state.

        NaN if the thermal network or the resistance's coefficient is not known; infinite if there is no steady state.
        """
        motor, supply = self._motor, self._supply
        if supply.winding_temperature is not None:
            return np.full(len(self._ratios), supply.winding_temperature)
        resistance_to_ambient = motor.thermal.to_ambient if motor.thermal is not None else None
        coefficient, reference = motor.resistance_coefficient, motor.reference_temperature
        if resistance_to_ambient is None or coefficient is None or reference is None or motor.phase_resistance is None:
            return np.full(len(self._ratios), np.nan)
        cold_rise = np.mean(self._current**2, axis=1) * motor.phase_resistance * resistance_to_ambient  # K
        stability_margin = 1.0 - coefficient * cold_rise
        stable = stability_margin > 0.0
        ambient_factor = resistance_ratio(supply.ambient, coefficient, reference)
        rise = cold_rise * ambient_factor / np.where(stable, stability_margin, np.nan)
        return np.where(stable, supply.ambient + rise, np.inf)

    def _resistances(self) -> Array:
        """Return the phase resistance [ohm] at each winding temperature, or the file's if that is not known."""
        motor = self._motor
        assert motor.phase_resistance is not None
        coefficient, reference = motor.resistance_coefficient, motor.reference_temperature
        if coefficient is None or reference is None:
            return np.full(len(self._ratios), motor.phase_resistance)
        warm_resistance = motor.phase_resistance * resistance_ratio(self.temperature, coefficient, reference)
        return np.where(np.isnan(warm_resistance), motor.phase_resistance, warm_resistance)

    def _compare_with_limits(self) -> None:
        """Compare voltages with the bus, line currents with the drive, and temperatures with the winding's limit."""
        motor, supply = self._motor, self._supply
        assert motor.back_emf_constant and motor.pole_pairs and motor.phase_inductance
        with np.errstate(invalid="ignore"):
            q_axis_voltage = self.resistance[:, np.newaxis] * self._current + motor.back_emf_constant * self._speed
        d_axis_voltage = motor.pole_pairs * self._speed * motor.phase_inductance * self._current
        self.voltage = np.hypot(q_axis_voltage, d_axis_voltage)
        self.line = np.abs(self._current) / FRAMES[motor.winding].current
        self.ceiling = voltage_ceiling(supply.bus_voltage, motor.winding)
        self.over_voltage = ~(self.voltage <= self.ceiling)
        current_limit = np.inf if supply.line_current is None else supply.line_current
        self.over_current = self.line > current_limit
        temperature_limit = motor.limits.winding_temperature
        self.too_hot = np.isinf(self.temperature) if temperature_limit is None else self.temperature > temperature_limit

    def best(self) -> int:
        """Return the row of least electrical energy among the rows with the fewest points over a limit."""
        points_beyond = (self.over_voltage | self.over_current).sum(axis=1) + self.too_hot * self._cycle.torque.size
        candidates = np.flatnonzero(points_beyond == points_beyond.min())
        return int(candidates[np.argmin(self._electrical()[candidates])])

    def _electrical(self) -> Array:
        """Return the energy from the bus over a cycle [J] at each ratio; infinite without a steady state."""
        heat = np.mean(self._current**2, axis=1) * self.resistance
        return np.asarray(self._cycle.period * (heat + np.mean(self._torque * self._speed, axis=1)), np.float64)

    def stride(self, row: int) -> Stride:
        """Return the energies and peaks of one row."""
        motor, cycle = self._motor, self._cycle
        period, speed, torque = cycle.period, self._speed[row], self._torque[row]
        assert motor.torque_constant
        heat_per_torque_squared = self.resistance[row] / motor.torque_constant**2

        def heat(torque_part: Array) -> float:
            """Return the Joule heat over a cycle [J] of a part of the torque."""
            return float(period * heat_per_torque_squared * np.mean(torque_part[row] * torque))

        power = heat_per_torque_squared * torque**2 + torque * speed
        is_beyond_limit = self.over_voltage[row] | self.over_current[row]
        temperature = float(self.temperature[row])
        return Stride(
            ratio=float(self._ratios[row]),
            joint_work=float(period * np.mean(cycle.torque * cycle.velocity)),
            electrical=float(period * np.mean(power)),
            electrical_without_return=float(period * np.mean(np.maximum(power, 0.0))),
            joule_load=heat(self._load),
            joule_friction=heat(self._drag + self._coulomb),
            joule_inertia=heat(self._inertia),
            viscous=float(period * np.mean(self._drag[row] * speed)),
            coulomb=None if motor.coulomb_friction is None else float(period * np.mean(self._coulomb[row] * speed)),
            transmission=float(period * np.mean(self._transmission_loss[row])),
            winding_temperature=None if np.isnan(temperature) else temperature,
            peak_line_current=float(self.line[row].max()),
            peak_voltage=float(self.voltage[row].max()),
            voltage_ceiling=self.ceiling,
            over_voltage=int(self.over_voltage[row].sum()),
            over_current=int(self.over_current[row].sum()),
            too_hot=bool(self.too_hot[row]),
            first_beyond_percent=100.0 * int(np.argmax(is_beyond_limit)) / is_beyond_limit.size
            if is_beyond_limit.any()
            else None,
        )


def remarks(motor: MotorSheet, motion: Stride) -> list[str]:
    """Return a text for each parameter that the motor file lacks and that limits what the energies mean."""
    texts = []
    if motor.coulomb_friction is None:
        texts.append("its Coulomb friction is not known: losses are at least these")
    if motor.resistance_coefficient is None:
        texts.append("the coefficient of its resistance is not known: heat at the resistance as told")
    elif motion.winding_temperature is None:
        texts.append("its thermal network is not known: heat at the resistance as told")
    if motor.limits.winding_temperature is None:
        texts.append("it has no limit of the winding's temperature: not judged")
    return texts
