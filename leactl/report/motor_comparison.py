"""Comparison of motors: figures, torques, and notes on missing or contradictory values of their files."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from leactl import yamlfile
from leactl.errors import InputError
from leactl.model.derived_quantities import (
    continuous_torques,
    electrical,
    fields_missing_for_friction,
    motor_constant,
    network_current,
    no_load_speed,
)
from leactl.model.motor import Motor, load_sheet
from leactl.model.motor_schema import LoopFigures, MotorSheet
from leactl.report.terminal import TEXT_WIDTH, aligned, wrapped
from leactl.safety.thermal.guarded_currents import Nominal, nominal

PEAK_DURATION_S = 20.0  # as in the paper
# inductance over resistance of real actuators is 0.1 to 20 ms; an inductance in mH makes it a thousand times longer
LONGEST_TIME_CONSTANT_S = 0.1
MOST_CONSTANT_DEVIATION = 0.1  # relative; saturation and current conventions make a few per cent, a wrong unit far more


@dataclass(frozen=True)
class OperatingConditions:
    """Ambient temperature and bus voltage under which motors are compared."""

    ambient: float = 25.0  # degC
    bus_voltage: float = 29.6  # V


@dataclass(frozen=True)
class ComparedMotor:
    """A motor file and the currents that the winding can carry, which are None if the file lacks values for them."""

    sheet: MotorSheet
    currents: Nominal | None
    missing_keys: tuple[str, ...]  # without which a bench must not move the motor
    conditions: OperatingConditions


@dataclass(frozen=True)
class FigureRow:
    """One figure of several motors; a value is None if it is not known."""

    name: str
    units: str
    values: tuple[float | str | None, ...]
    depends_on_frame: bool  # of the winding's quantities; it is then not comparable between different windings


Figure = tuple[str, str, Callable[[ComparedMotor], float | str | None]]
FRAME_DEPENDENT = {"torque_constant", "phase_resistance", "phase_inductance", "continuous_current", "network_current"}


def compared_motor(name_or_path: str, conditions: OperatingConditions) -> ComparedMotor:
    """Read a motor file, and compute the currents that the winding can carry if the file is complete.

    Raises
    ------
    InputError : there is no such motor or file, or the file has a fault.
    """
    sheet, document = load_sheet(name_or_path)
    motor, missing_keys = _motor_and_missing_keys(document)
    currents = nominal(motor, conditions.ambient, [PEAK_DURATION_S]) if motor is not None else None
    return ComparedMotor(sheet, currents, missing_keys, conditions)


def _motor_and_missing_keys(document: yamlfile.Document) -> tuple[Motor | None, tuple[str, ...]]:
    """Return the motor, None if the file is incomplete, and the missing keys."""
    try:
        motor = document.validate(Motor)
    except InputError as error:
        return None, tuple(fault.split("  ", 1)[-1].split(":")[0] for fault in error.faults)
    return motor, () if motor.tolerances is not None else ("tolerances",)


def figure_rows(motors: Sequence[ComparedMotor]) -> list[FigureRow]:
    """Return a row for each figure of FIGURES, with the values of these motors."""
    return [
        FigureRow(name, units, tuple(figure_of(motor) for motor in motors), name in FRAME_DEPENDENT)
        for name, units, figure_of in FIGURES
    ]


def comparison_json(motors: Sequence[ComparedMotor]) -> dict[str, Any]:
    """Return conditions, figures and notes of these motors as JSON takes them."""
    return {
        "motors": [motor.sheet.name for motor in motors],
        "ambient_degC": motors[0].conditions.ambient,
        "bus_voltage_V": motors[0].conditions.bus_voltage,
        "rows": [
            {"name": row.name, "units": row.units, "values": list(row.values), "depends_on_frame": row.depends_on_frame}
            for row in figure_rows(motors)
        ],
        "notes": comparison_notes(motors),
    }


def comparison_text(motors: Sequence[ComparedMotor]) -> str:
    """Return a table with a column for each motor, without figures in the frame of the winding if windings differ."""
    windings_differ = len({motor.sheet.winding for motor in motors}) > 1
    table_rows = [
        (f"{row.name} [{row.units}]" if row.units else row.name, *(cell(value) for value in row.values))
        for row in figure_rows(motors)
        if any(value is not None for value in row.values) and not (windings_differ and row.depends_on_frame)
    ]
    tables = [aligned(("", *(motor.sheet.name for motor in motors)), table_rows)]
    return "\n".join([*tables, *(wrapped("note:", [note], TEXT_WIDTH) for note in comparison_notes(motors))])


def comparison_notes(motors: Sequence[ComparedMotor]) -> list[str]:
    """Return notes on what cannot be compared, what files lack, and values that contradict each other."""
    notes = []
    if len({motor.sheet.winding for motor in motors}) > 1:
        notes.append(
            "windings differ: ampere, ohm and N*m/A of a q axis are not alike; compare torque, motor constant and"
            " figures between the leads"
        )
    notes += [
        f"{motor.sheet.name} is not to be moved by its file, which lacks {', '.join(motor.missing_keys)}"
        for motor in motors
        if motor.missing_keys
    ]
    notes += [
        f"{motor.sheet.name}: its no-load speed is without friction, for its file lacks {', '.join(missing_fields)}"
        for motor in motors
        if motor.sheet.back_emf_constant is not None and (missing_fields := fields_missing_for_friction(motor.sheet))
    ]
    for motor in motors:
        notes += [
            f"{motor.sheet.name}: {note}"
            for note in (*contradictions_to_print(motor), *contradictions_in_file(motor.sheet))
        ]
    return list(dict.fromkeys(notes))


def contradictions_in_file(sheet: MotorSheet) -> list[str]:
    """Return a note on each pair of values in one file that contradict each other."""
    contradictions = []
    torque, voltage = sheet.torque_constant, sheet.back_emf_constant
    # the electrical power into the back-EMF equals the mechanical power, so that both constants are equal in SI
    if torque is not None and voltage is not None and abs(voltage / torque - 1.0) > MOST_CONSTANT_DEVIATION:
        contradictions.append(
            f"torque constant {torque:.3g} N*m/A and back-EMF constant {voltage:.3g} V*s/rad: they are one number in SI"
        )
    inductance, resistance = sheet.phase_inductance, sheet.phase_resistance
    if inductance is not None and resistance is not None and inductance / resistance > LONGEST_TIME_CONSTANT_S:
        contradictions.append(
            f"phase inductance {inductance:.3g} H over phase resistance {resistance:.3g} ohm is"
            f" {inductance / resistance:.3g} s, of most actuators below 0.02 s: is it in H?"
        )
    return contradictions


def contradictions_to_print(motor: ComparedMotor) -> list[str]:
    """Return a note for each printed figure of the source that does not follow from its other values."""
    sheet, printed = motor.sheet, motor.sheet.printed
    torques = continuous_torques(sheet, motor.conditions.ambient)
    torque_at_peak = _torque_at(lambda currents: currents.peaks[0])
    comparisons = [
        ("motor constant", "N*m/sqrt(W)", printed.motor_constant, motor_constant(sheet), 0.05),
        ("rotor inertia", "kg*m^2", printed.rotor_inertia, sheet.rotor_inertia, 0.05),
        ("resistance coefficient", "1/K", printed.resistance_coefficient, sheet.resistance_coefficient, 0.05),
        ("continuous current", "A", sheet.continuous_current, network_current(sheet, motor.conditions.ambient), 0.02),
        ("nominal torque", "N*m", printed.nominal_torque, torques.stated, 0.02),
        ("peak torque of 20 s", "N*m", printed.peak_torque_20_s, torque_at_peak(motor), 0.02),
    ]
    return [
        f"{quantity} printed as {printed_value:.3g} {units}, {derived_value:.3g} {units} here"
        for quantity, units, printed_value, derived_value, largest_deviation in comparisons
        if printed_value is not None
        and derived_value is not None
        and abs(derived_value / printed_value - 1.0) > largest_deviation
    ]


def cell(value: float | str | None) -> str:
    """Return a value with four significant digits, or a text unchanged; `-` for a missing value."""
    if value is None:
        return "-"
    return value if isinstance(value, str) else f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"


def _scaled(value: float | None, factor: float) -> float | None:
    """Return a value times a factor; None for None."""
    return None if value is None else value * factor


def _torque_at(current_of: Callable[[Nominal], float]) -> Callable[[ComparedMotor], float | None]:
    """Return a function that computes a motor's torque [N*m] at one of the currents that its winding can carry."""

    def torque(motor: ComparedMotor) -> float | None:
        motor_current = None if motor.currents is None else current_of(motor.currents)
        return (
            None
            if motor_current is None or not math.isfinite(motor_current)
            else _scaled(motor.sheet.torque_constant, motor_current)
        )

    return torque


def _continuous_torque(name: str) -> Callable[[ComparedMotor], float | None]:
    """Return a function that computes one of the continuous torques or densities of a motor."""
    return lambda motor: getattr(continuous_torques(motor.sheet, motor.conditions.ambient), name)


def _loop_figure(
    loop: Callable[[MotorSheet], LoopFigures], name: str, factor: float
) -> Callable[[ComparedMotor], float | None]:
    """Return a function that gives one figure of a control loop of a motor, times a factor."""
    return lambda motor: _scaled(getattr(loop(motor.sheet), name), factor)


def _bandwidth(loop: Callable[[MotorSheet], LoopFigures]) -> Callable[[ComparedMotor], float | str | None]:
    """Return a function that gives the bandwidth of a control loop of a motor [Hz], or a lower bound as text."""

    def bandwidth(motor: ComparedMotor) -> float | str | None:
        figures = loop(motor.sheet)
        return figures.bandwidth if figures.bandwidth_at_least is None else f"> {figures.bandwidth_at_least:g}"

    return bandwidth


def _loop_rows(prefix: str, loop: Callable[[MotorSheet], LoopFigures]) -> list[Figure]:
    """Return the figures of one control loop; `prefix` begins their names."""
    return [
        (f"{prefix}_rise_time", "ms", _loop_figure(loop, "rise_time", 1e3)),
        (f"{prefix}_overshoot", "%", _loop_figure(loop, "overshoot_percent", 1.0)),
        (f"{prefix}_settling_time", "ms", _loop_figure(loop, "settling_time", 1e3)),
        (f"{prefix}_error", "%", _loop_figure(loop, "error_percent", 1.0)),
        (f"{prefix}_bandwidth", "Hz", _bandwidth(loop)),
    ]


def _sheet_value(name: str, factor: float = 1.0) -> Callable[[ComparedMotor], float | None]:
    """Return a function that gives a value of the motor file, times a factor."""
    return lambda motor: _scaled(getattr(motor.sheet, name), factor)


def _body_value(name: str, factor: float) -> Callable[[ComparedMotor], float | None]:
    """Return a function that gives a value of the `body:` block of the motor file, times a factor."""
    return lambda motor: _scaled(getattr(motor.sheet.body, name), factor)


def _network_value(name: str) -> Callable[[ComparedMotor], float | None]:
    """Return a function that gives a value of the thermal network of the motor file."""
    return lambda motor: None if motor.sheet.thermal is None else getattr(motor.sheet.thermal, name)


FIGURES: list[Figure] = [
    ("winding", "", lambda motor: motor.sheet.winding),
    ("pole_pairs", "", _sheet_value("pole_pairs")),
    ("mass", "g", _body_value("mass", 1e3)),
    ("outer_diameter", "mm", _body_value("outer_diameter", 1e3)),
    ("inner_diameter", "mm", _body_value("inner_diameter", 1e3)),
    ("length", "mm", _body_value("length", 1e3)),
    ("encoder_lines", "", _sheet_value("encoder_lines")),
    ("rotor_inertia", "g*m^2", _sheet_value("rotor_inertia", 1e3)),
    ("viscous_damping", "mN*m*s/rad", _sheet_value("viscous_damping", 1e3)),
    ("coulomb_friction", "mN*m", _sheet_value("coulomb_friction", 1e3)),
    ("torque_constant", "N*m/A", _sheet_value("torque_constant")),
    ("phase_resistance", "mohm", _sheet_value("phase_resistance", 1e3)),
    ("phase_inductance", "uH", _sheet_value("phase_inductance", 1e6)),
    ("line_to_line_resistance", "mohm", lambda motor: _scaled(electrical(motor.sheet).line_to_line().resistance, 1e3)),
    ("line_to_line_inductance", "uH", lambda motor: _scaled(electrical(motor.sheet).line_to_line().inductance, 1e6)),
    ("torque_per_line_ampere", "N*m/A", lambda motor: electrical(motor.sheet).per_line_amplitude()),
    ("motor_constant", "N*m/sqrt(W)", lambda motor: motor_constant(motor.sheet)),
    ("no_load_speed", "rad/s", lambda motor: no_load_speed(motor.sheet, motor.conditions.bus_voltage)),
    ("winding_ambient_resistance", "K/W", _network_value("winding_ambient_resistance")),
    ("winding_housing_resistance", "K/W", _network_value("winding_housing_resistance")),
    ("housing_ambient_resistance", "K/W", _network_value("housing_ambient_resistance")),
    ("winding_capacitance", "J/K", _network_value("winding_capacitance")),
    ("housing_capacitance", "J/K", _network_value("housing_capacitance")),
    ("continuous_current", "A", _sheet_value("continuous_current")),
    ("network_current", "A", lambda motor: network_current(motor.sheet, motor.conditions.ambient)),
    ("continuous_torque", "N*m", lambda motor: continuous_torques(motor.sheet, motor.conditions.ambient).stated),
    (
        "torque_density",
        "N*m/kg",
        lambda motor: continuous_torques(motor.sheet, motor.conditions.ambient).stated_density,
    ),
    ("network_torque", "N*m", lambda motor: continuous_torques(motor.sheet, motor.conditions.ambient).network),
    (
        "network_torque_density",
        "N*m/kg",
        lambda motor: continuous_torques(motor.sheet, motor.conditions.ambient).network_density,
    ),
    ("standing_torque", "N*m", _torque_at(lambda currents: currents.standing)),
    ("peak_torque_20_s", "N*m", _torque_at(lambda currents: currents.peaks[0])),
    ("standing_peak_torque_20_s", "N*m", _torque_at(lambda currents: currents.standing_peaks[0])),
    *_loop_rows("current", lambda sheet: sheet.control.current),
    *_loop_rows("position", lambda sheet: sheet.control.position),
]
