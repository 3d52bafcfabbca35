"""Scaled motors, energy over cycles and preloads of flexures as text that fits 80 columns."""

import math
from collections.abc import Sequence
from typing import Any

from leactl.model.cycle import Cycle
from leactl.model.energy import Stride
from leactl.model.flexures import Preload, Reading
from leactl.model.motor_schema import Bearings, MotorSheet
from leactl.model.scaling import ScaledFigure
from leactl.report.motor_comparison import cell
from leactl.report.terminal import TEXT_WIDTH, aligned, wrapped

ENERGIES = {
    "joint_work": "onto the joint, net",
    "joule_load": "Joule heat of the load",
    "joule_inertia": "  of the rotor's inertia",
    "joule_friction": "  of friction",
    "viscous": "viscous friction",
    "coulomb": "Coulomb friction",
    "transmission": "lost in the transmission",
    "electrical": "from the bus, net",
    "electrical_without_return": "  where nothing goes back",
}


def scaled_text(motor: MotorSheet, figures: Sequence[ScaledFigure], radius: float) -> str:
    """Return the figures of a motor that was scaled to another air-gap radius [m], beside the original's."""
    rows = [
        (f"{figure.name} [{figure.units}]", cell(figure.known), cell(figure.scaled), f"r^{figure.power:g}")
        for figure in figures
        if figure.known is not None
    ]
    lines = [aligned(("", motor.name, f"{1e3 * radius:g} mm", "goes by"), rows)]
    assumption = f"{motor.winding} winding throughout; thickness, length, materials and turns a slot as they are"
    lines.append(wrapped(assumption, [], TEXT_WIDTH))
    return "\n".join(lines)


def energy_text(cycle: Cycle, motors: Sequence[MotorSheet], strides: Sequence[Stride], notes: Sequence[str]) -> str:
    """Return one cycle's energies [J], temperature and peaks, a column for each motor."""
    rows = [("ratio", *(f"{stride.ratio:.4g}" for stride in strides))]
    rows += [(f"{label} [J]", *(cell(getattr(stride, name)) for stride in strides)) for name, label in ENERGIES.items()]
    rows.append(("winding in the end [degC]", *(cell(stride.winding_temperature) for stride in strides)))
    rows.append(("largest line current [A]", *(cell(stride.peak_line_current) for stride in strides)))
    rows.append(
        (
            "largest voltage, of what there is",
            *(f"{stride.peak_voltage / stride.voltage_ceiling:.0%}" for stride in strides),
        )
    )
    rows.append(("feasible", *("yes" if stride.feasible else "no" for stride in strides)))
    title = (
        f"{cycle.name}: {cycle.period:g} s, angle over {_degrees(cycle):.3g} deg, torque up to"
        f" {abs(cycle.torque).max():.3g} N*m"
    )
    ceiling_notes = [
        f"{motor.name}: {label}"
        for motor, stride in zip(motors, strides, strict=True)
        for label in ceilings_passed(stride)
    ]
    table = aligned(("", *(motor.name for motor in motors)), rows)
    return "\n".join([title, table, *(wrapped("note:", [note], TEXT_WIDTH) for note in [*ceiling_notes, *notes])])


def ceilings_passed(stride: Stride) -> list[str]:
    """Return a line for each ceiling that a cycle passes: voltage or current, and temperature."""
    lines = []
    if stride.over_voltage or stride.over_current:
        causes = [f"{stride.over_voltage} by voltage"] * (stride.over_voltage > 0)
        causes += [f"{stride.over_current} by current"] * (stride.over_current > 0)
        lines.append(f"points out of reach: {' and '.join(causes)}, the first at {stride.first_beyond_percent:.1f} %")
    if stride.too_hot:
        lines.append("cycle after cycle the winding passes its limit")
    return lines


def stride_json(motor: MotorSheet, stride: Stride, notes: Sequence[str]) -> dict[str, Any]:
    """Return one motor over one cycle as JSON takes it."""
    energies = {name: getattr(stride, name) for name in (*ENERGIES, "joule")}
    return {
        "motor": motor.name,
        "ratio": stride.ratio,
        "feasible": stride.feasible,
        "energies_J": {name: _finite(value) for name, value in energies.items()},
        "winding_temperature_degC": _finite(stride.winding_temperature),
        "peak_line_current_A": stride.peak_line_current,
        "peak_voltage_V": _finite(stride.peak_voltage),
        "voltage_ceiling_V": stride.voltage_ceiling,
        "points_over_voltage": stride.over_voltage,
        "points_over_current": stride.over_current,
        "too_hot": stride.too_hot,
        "first_beyond_percent": stride.first_beyond_percent,
        "notes": list(notes),
    }


def preload_text(
    bearings: Bearings, readings: Sequence[tuple[Reading, list[Preload], float]], deviations: dict[str, float]
) -> str:
    """Return the preloads at some gaps under each reading of the source, and how far each reading contradicts it."""
    lines = [
        wrapped(
            f"{bearings.each_side} bearings a side, {bearings.static_radial_load:g} N each at"
            f" {1e3 * bearings.deflection_at_static_load:g} mm of deflection;"
            f" {bearings.told_preload:g} N told at a gap of {1e3 * bearings.told_gap:g} mm",
            [],
            TEXT_WIDTH,
        )
    ]
    for reading, preloads, static_gap in readings:
        lines += [
            "",
            f"{reading.name}: {reading.stiffness / 1e3:.0f} N/mm, at rest up to {1e3 * reading.rest_gap:g} mm",
        ]
        lines.append(
            f"  at the told gap {reading.at_told_gap:.0f} N, at the told deflection"
            f" {reading.at_static_deflection:.0f} N: {deviations[reading.name]:+.0%} off what is told"
        )
        rows = [
            (
                f"  {1e3 * preload.gap:g}",
                f"{1e3 * preload.deflection:.3g}",
                f"{preload.force:.0f}",
                f"{preload.side:.0f}",
                f"{preload.share:.0%}",
                "" if preload.holds else "over the static load",
            )
            for preload in preloads
        ]
        lines.append(aligned(("  gap [mm]", "deflection", "each [N]", "a side [N]", "of static load", ""), rows))
        lines.append(f"  the static load is reached at a gap of {1e3 * static_gap:.3g} mm")
    return "\n".join(lines)


def preload_json(
    bearings: Bearings, readings: Sequence[tuple[Reading, list[Preload], float]], deviations: dict[str, float]
) -> dict[str, Any]:
    """Return the preloads under each reading as JSON takes them."""
    return {
        "bearings": bearings.model_dump(),
        "readings": [
            {
                "name": reading.name,
                "stiffness_N_per_m": reading.stiffness,
                "rest_gap_mm": 1e3 * reading.rest_gap,
                "off_what_is_told": deviations[reading.name],
                "gap_at_static_load_mm": 1e3 * static_gap,
                "gaps": [
                    {
                        "gap_mm": 1e3 * preload.gap,
                        "deflection_mm": 1e3 * preload.deflection,
                        "preload_N": preload.force,
                        "side_N": preload.side,
                        "share_of_static_load": preload.share,
                        "holds": preload.holds,
                    }
                    for preload in preloads
                ],
            }
            for reading, preloads, static_gap in readings
        ],
    }


def _finite(value: float | None) -> float | None:
    """Return a value; None if it is not finite, which JSON cannot hold."""
    return value if value is not None and math.isfinite(value) else None


def _degrees(cycle: Cycle) -> float:
    """Return the range of the joint's angle in a cycle [deg]."""
    return math.degrees(float(cycle.angle.max() - cycle.angle.min()))
