"""Energy of an actuator over one cycle of a joint, through a transmission: where it goes, and which ratio is best.

    Kt i = tau / (N eta) + J N a + b N w + f sgn(w)      tau at eta / N where the joint drives the actuator
    P = R(T) i^2 + Kt i N w                              over a cycle the inertia takes none, but current

Joule heat is a square of the current's parts; each part k is told its share R/Kt^2 mean(tau_k tau), its Shapley value:
the parts add up, and one that lightens the others has a negative share. The paper announces this comparison (section
"Introduction") and does not print it.
"""

from dataclasses import dataclass

import numpy as np

from leactl.errors import InputError
from leactl.model.cycle import Array, Cycle
from leactl.model.motor_schema import MotorSheet
from leactl.model.winding import FRAMES, voltage_ceiling

NEEDED = (
    "torque_constant",
    "back_emf_constant",
    "phase_resistance",
    "phase_inductance",
    "pole_pairs",
    "rotor_inertia",
    "viscous_damping",
)
RATIOS = (0.05, 5000.0)
TRIED = 300  # ratios, evenly on a logarithmic scale; as many again around the best
STILL = 1e-9  # rad/s of the joint


@dataclass(frozen=True)
class DriveSupply:
    """What a drive and its bus give, and the air around."""

    bus_voltage: float = 29.6  # V
    line_current: float | None = None  # A, amplitude in a lead
    ambient: float = 25.0  # degC
    winding_temperature: float | None = None  # degC; None: where many cycles lead to


@dataclass(frozen=True)
class Stride:
    """One cycle of one actuator; energies in J."""

    ratio: float
    joint_work: float  # onto the joint, net
    electrical: float  # from the bus, what comes back counted
    electrical_without_return: float  # from a bus that takes nothing back
    joule_load: float
    joule_friction: float
    joule_inertia: float
    viscous: float
    coulomb: float | None  # None: the motor's Coulomb friction is not known
    transmission: float
    winding_temperature: float | None  # degC; None: at the resistance as told
    peak_line_current: float  # A, amplitude
    peak_voltage: float  # V, q axis
    voltage_ceiling: float  # V
    over_voltage: int  # points of the cycle beyond what the bus gives
    over_current: int
    too_hot: bool
    first_beyond_percent: float | None  # of the cycle

    @property
    def joule(self) -> float:
        """All heat of the winding."""
        return self.joule_load + self.joule_friction + self.joule_inertia

    @property
    def feasible(self) -> bool:
        """Whether the actuator can do it at every point of the cycle, and for ever."""
        return not (self.over_voltage or self.over_current or self.too_hot)


def stride(
    motor: MotorSheet, cycle: Cycle, ratio: float, efficiency: float = 1.0, supply: DriveSupply | None = None
) -> Stride:
    """One cycle at one ratio (turns of the motor for one of the joint) and efficiency of the transmission.

    Raises
    ------
    InputError : figures that the motor file lacks, or a ratio, an efficiency or a supply that makes no sense.
    """
    if not RATIOS[0] <= ratio <= RATIOS[1]:
        raise InputError(f"ratio {ratio:g}: from {RATIOS[0]:g} to {RATIOS[1]:g} was expected")
    return _Many(motor, cycle, np.array([ratio]), efficiency, supply or DriveSupply()).stride(0)


def best_ratio(motor: MotorSheet, cycle: Cycle, efficiency: float = 1.0, supply: DriveSupply | None = None) -> Stride:
    """The feasible ratio of least electrical energy; where none is feasible, one with the fewest points beyond.

    Raises
    ------
    InputError : as `stride`.
    """
    low, high = RATIOS
    for _ in range(2):
        ratios = np.geomspace(low, high, TRIED)
        many = _Many(motor, cycle, ratios, efficiency, supply or DriveSupply())
        best = many.best()
        low, high = ratios[max(best - 1, 0)], ratios[min(best + 1, TRIED - 1)]
    return many.stride(best)


class _Many:
    """One cycle at many ratios side by side, one row each."""

    def __init__(self, motor: MotorSheet, cycle: Cycle, ratios: Array, efficiency: float, supply: DriveSupply) -> None:
        lacking = motor.missing(*NEEDED)
        if lacking:
            raise InputError(f"motor '{motor.name}' has no {', '.join(lacking)}: its energy cannot be worked out")
        if not 0.0 < efficiency <= 1.0:
            raise InputError(f"efficiency {efficiency:g}: more than 0 and at most 1 was expected")
        if not 0.0 < supply.bus_voltage <= 1000.0:
            raise InputError(f"bus voltage {supply.bus_voltage:g} V: more than 0 and at most 1000 V was expected")
        if supply.line_current is not None and not 0.0 < supply.line_current <= 10_000.0:
            raise InputError(f"line current {supply.line_current:g} A: more than 0 and at most 10000 A was expected")
        assert motor.torque_constant and motor.rotor_inertia and motor.viscous_damping is not None
        self._motor, self._cycle, self._ratios, self._supply = motor, cycle, ratios, supply
        n = ratios[:, np.newaxis]
        at_motor = cycle.torque / n
        driving = cycle.torque * cycle.velocity >= 0.0
        self._load = at_motor * np.where(driving, 1.0 / efficiency, efficiency)
        self._speed = n * cycle.velocity
        self._inertia = motor.rotor_inertia * n * cycle.acceleration
        self._drag = motor.viscous_damping * self._speed
        self._coulomb = self._sticking(motor.coulomb_friction or 0.0)
        self._torque = self._load + self._inertia + self._drag + self._coulomb
        self._current = self._torque / motor.torque_constant
        self._lost = (self._load - at_motor) * self._speed
        self.temperature = self._temperatures()
        self.resistance = self._resistances()
        self._judge()

    def _sticking(self, friction: float) -> Array:
        """Coulomb friction; at rest it carries up to its own size of what the motor would have to."""
        still = np.abs(self._cycle.velocity) < STILL
        carried = -np.clip(self._load + self._inertia, -friction, friction)
        return np.where(still, carried, friction * np.sign(self._speed))

    def _temperatures(self) -> Array:
        """Of the winding [degC], in the end or as given; NaN where the motor's network or coefficient is not known."""
        motor, supply = self._motor, self._supply
        if supply.winding_temperature is not None:
            return np.full(len(self._ratios), supply.winding_temperature)
        outwards = motor.thermal.to_ambient if motor.thermal is not None else None
        slope, reference = motor.resistance_coefficient, motor.reference_temperature
        if outwards is None or slope is None or reference is None or motor.phase_resistance is None:
            return np.full(len(self._ratios), np.nan)
        cold = np.mean(self._current**2, axis=1) * motor.phase_resistance * outwards  # K
        left = 1.0 - slope * cold
        rise = cold * (1.0 + slope * (supply.ambient - reference)) / np.where(left > 0.0, left, np.nan)
        return np.where(left > 0.0, supply.ambient + rise, np.inf)

    def _resistances(self) -> Array:
        motor = self._motor
        assert motor.phase_resistance is not None
        slope, reference = motor.resistance_coefficient, motor.reference_temperature
        if slope is None or reference is None:
            return np.full(len(self._ratios), motor.phase_resistance)
        warm = motor.phase_resistance * (1.0 + slope * (self.temperature - reference))
        return np.where(np.isnan(warm), motor.phase_resistance, warm)

    def _judge(self) -> None:
        """Voltages against the bus, currents against the drive, temperatures against the winding's limit."""
        motor, supply = self._motor, self._supply
        assert motor.back_emf_constant and motor.pole_pairs and motor.phase_inductance
        with np.errstate(invalid="ignore"):
            along = self.resistance[:, np.newaxis] * self._current + motor.back_emf_constant * self._speed
        across = motor.pole_pairs * self._speed * motor.phase_inductance * self._current
        self.voltage = np.hypot(along, across)
        self.line = np.abs(self._current) / FRAMES[motor.winding].current
        self.ceiling = voltage_ceiling(supply.bus_voltage, motor.winding)
        self.over_voltage = ~(self.voltage <= self.ceiling)
        most = np.inf if supply.line_current is None else supply.line_current
        self.over_current = self.line > most
        limit = motor.limits.winding_temperature
        self.too_hot = np.isinf(self.temperature) if limit is None else self.temperature > limit

    def best(self) -> int:
        """Row of the least electrical energy among the feasible, or else of the fewest points beyond."""
        beyond = (self.over_voltage | self.over_current).sum(axis=1) + self.too_hot * self._cycle.torque.size
        fewest = np.flatnonzero(beyond == beyond.min())
        return int(fewest[np.argmin(self._electrical()[fewest])])

    def _electrical(self) -> Array:
        """From the bus over a cycle [J]; infinite for a winding that runs away."""
        heat = np.mean(self._current**2, axis=1) * self.resistance
        return np.asarray(self._cycle.period * (heat + np.mean(self._torque * self._speed, axis=1)), np.float64)

    def stride(self, row: int) -> Stride:
        """What one ratio comes to."""
        motor, cycle = self._motor, self._cycle
        period, speed, torque = cycle.period, self._speed[row], self._torque[row]
        assert motor.torque_constant
        heating = self.resistance[row] / motor.torque_constant**2

        def heat(part: Array) -> float:
            return float(period * heating * np.mean(part[row] * torque))

        power = heating * torque**2 + torque * speed
        beyond = self.over_voltage[row] | self.over_current[row]
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
            transmission=float(period * np.mean(self._lost[row])),
            winding_temperature=None if np.isnan(temperature) else temperature,
            peak_line_current=float(self.line[row].max()),
            peak_voltage=float(self.voltage[row].max()),
            voltage_ceiling=self.ceiling,
            over_voltage=int(self.over_voltage[row].sum()),
            over_current=int(self.over_current[row].sum()),
            too_hot=bool(self.too_hot[row]),
            first_beyond_percent=100.0 * int(np.argmax(beyond)) / beyond.size if beyond.any() else None,
        )


def remarks(motor: MotorSheet, one: Stride) -> list[str]:
    """What a reader of these figures must know of this motor."""
    lines = []
    if motor.coulomb_friction is None:
        lines.append("its Coulomb friction is not known: losses are at least these")
    if motor.resistance_coefficient is None:
        lines.append("the coefficient of its resistance is not known: heat at the resistance as told")
    elif one.winding_temperature is None:
        lines.append("its thermal network is not known: heat at the resistance as told")
    if motor.limits.winding_temperature is None:
        lines.append("it has no limit of the winding's temperature: not judged")
    return lines
