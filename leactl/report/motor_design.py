"""Scaled motors, energy over cycles and preloads of flexures as text that fits 80 columns."""

import math
from collections.abc import Sequence
from typing import Any

from leactl.model.cycle import Cycle
from leactl.model.energy import Stride
from leactl.model.flexures import Preload, Reading
from leactl.model.motor_schema import Bearings, MotorSheet
from leactl.model.scaling import Scaled
from leactl.report.motors import WIDTH, cell
from leactl.report.terminal import aligned, wrapped

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


def scaled_text(motor: MotorSheet, found: Sequence[Scaled], radius: float) -> str:
    """Figures of a motor of another air-gap radius beside those it was scaled from."""
    table = [
        (f"{one.name} [{one.units}]", cell(one.known), cell(one.scaled), f"r^{one.power:g}")
        for one in found
        if one.known is not None
    ]
    lines = [aligned(("", motor.name, f"{1e3 * radius:g} mm", "goes by"), table)]
    kept = f"{motor.winding} winding throughout; thickness, length, materials and turns a slot as they are"
    lines.append(wrapped(kept, [], WIDTH))
    return "\n".join(lines)


def energy_text(cycle: Cycle, motors: Sequence[MotorSheet], found: Sequence[Stride], notes: Sequence[str]) -> str:
    """One cycle by several motors: a column each, energies in J."""
    rows = [("ratio", *(f"{one.ratio:.4g}" for one in found))]
    rows += [(f"{words} [J]", *(cell(getattr(one, name)) for one in found)) for name, words in ENERGIES.items()]
    rows.append(("winding in the end [degC]", *(cell(one.winding_temperature) for one in found)))
    rows.append(("largest line current [A]", *(cell(one.peak_line_current) for one in found)))
    rows.append(
        ("largest voltage, of what there is", *(f"{one.peak_voltage / one.voltage_ceiling:.0%}" for one in found))
    )
    rows.append(("feasible", *("yes" if one.feasible else "no" for one in found)))
    head = (
        f"{cycle.name}: {cycle.period:g} s, angle over {_degrees(cycle):.3g} deg, torque up to"
        f" {abs(cycle.torque).max():.3g} N*m"
    )
    beyond = [f"{motor.name}: {words}" for motor, one in zip(motors, found, strict=True) for words in beyond_of(one)]
    table = aligned(("", *(motor.name for motor in motors)), rows)
    return "\n".join([head, table, *(wrapped("note:", [note], WIDTH) for note in [*beyond, *notes])])


def beyond_of(one: Stride) -> list[str]:
    """Which ceilings a cycle passes, and where first."""
    found = []
    if one.over_voltage or one.over_current:
        what = [f"{one.over_voltage} by voltage"] * (one.over_voltage > 0)
        what += [f"{one.over_current} by current"] * (one.over_current > 0)
        found.append(f"points out of reach: {' and '.join(what)}, the first at {one.first_beyond_percent:.1f} %")
    if one.too_hot:
        found.append("cycle after cycle the winding passes its limit")
    return found


def stride_json(motor: MotorSheet, one: Stride, notes: Sequence[str]) -> dict[str, Any]:
    """One motor over one cycle."""
    energies = {name: getattr(one, name) for name in (*ENERGIES, "joule")}
    return {
        "motor": motor.name,
        "ratio": one.ratio,
        "feasible": one.feasible,
        "energies_J": {name: _finite(value) for name, value in energies.items()},
        "winding_temperature_degC": _finite(one.winding_temperature),
        "peak_line_current_A": one.peak_line_current,
        "peak_voltage_V": _finite(one.peak_voltage),
        "voltage_ceiling_V": one.voltage_ceiling,
        "points_over_voltage": one.over_voltage,
        "points_over_current": one.over_current,
        "too_hot": one.too_hot,
        "first_beyond_percent": one.first_beyond_percent,
        "notes": list(notes),
    }


def preload_text(
    bearings: Bearings, found: Sequence[tuple[Reading, list[Preload], float]], misses: dict[str, float]
) -> str:
    """Preloads at some gaps under each reading of the two told points, and whether they contradict each other."""
    lines = [
        wrapped(
            f"{bearings.each_side} bearings a side, {bearings.static_radial_load:g} N each at"
            f" {1e3 * bearings.deflection_at_static_load:g} mm of deflection;"
            f" {bearings.told_preload:g} N told at a gap of {1e3 * bearings.told_gap:g} mm",
            [],
            WIDTH,
        )
    ]
    for reading, loads, most in found:
        lines += [
            "",
            f"{reading.name}: {reading.stiffness / 1e3:.0f} N/mm, at rest up to {1e3 * reading.rest_gap:g} mm",
        ]
        lines.append(
            f"  at the told gap {reading.at_told_gap:.0f} N, at the told deflection"
            f" {reading.at_static_deflection:.0f} N: {misses[reading.name]:+.0%} off what is told"
        )
        rows = [
            (
                f"  {1e3 * one.gap:g}",
                f"{1e3 * one.deflection:.3g}",
                f"{one.force:.0f}",
                f"{one.side:.0f}",
                f"{one.share:.0%}",
                "" if one.holds else "over the static load",
            )
            for one in loads
        ]
        lines.append(aligned(("  gap [mm]", "deflection", "each [N]", "a side [N]", "of static load", ""), rows))
        lines.append(f"  the static load is reached at a gap of {1e3 * most:.3g} mm")
    return "\n".join(lines)


def preload_json(
    bearings: Bearings, found: Sequence[tuple[Reading, list[Preload], float]], misses: dict[str, float]
) -> dict[str, Any]:
    """The same for a script."""
    return {
        "bearings": bearings.model_dump(),
        "readings": [
            {
                "name": reading.name,
                "stiffness_N_per_m": reading.stiffness,
                "rest_gap_mm": 1e3 * reading.rest_gap,
                "off_what_is_told": misses[reading.name],
                "gap_at_static_load_mm": 1e3 * most,
                "gaps": [
                    {
                        "gap_mm": 1e3 * one.gap,
                        "deflection_mm": 1e3 * one.deflection,
                        "preload_N": one.force,
                        "side_N": one.side,
                        "share_of_static_load": one.share,
                        "holds": one.holds,
                    }
                    for one in loads
                ],
            }
            for reading, loads, most in found
        ],
    }


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _degrees(cycle: Cycle) -> float:
    return math.degrees(float(cycle.angle.max() - cycle.angle.min()))
