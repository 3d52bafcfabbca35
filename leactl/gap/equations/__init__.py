"""Equations of the bench, one for each channel that can be checked against the others."""

from dataclasses import replace

from leactl.effects.contract import Signals
from leactl.gap.equations import axis, electrical, mechanical, motion, thermal, twist
from leactl.gap.equations.contract import FEWEST_ROWS, Equation, usable_rows
from leactl.gap.signals.decimation import decimated
from leactl.gap.signals.derived import fast_signals, slow_signals
from leactl.gap.signals.record import Record
from leactl.gap.signals.rig import VOLTAGE_KIND, add_rig_signals, voltage_feed
from leactl.model.nominal import Model

__all__ = ["Equation", "equations"]

ELECTRICAL_EQUATIONS = (electrical.voltage, electrical.current, electrical.bus)
MECHANICAL_EQUATIONS = (
    mechanical.coupled_torque,
    mechanical.both_torque,
    mechanical.locked_torque,
    mechanical.swung_torque,
    motion.velocity,
    twist.shaft_twist,
    twist.lock_angle,
)
FREE_ROTOR = ("free_torque", "reversal_torque")
DECIMATION_FACTORS = (2, 4, 8, 16)  # by which a log's rate is divided where its encoder is coarse


def free_rotor_equations(record: Record, fast: Signals, slow: Signals | None) -> list[Equation]:
    """Return a free rotor's torque balance at the highest rate at which encoder noise does not mask acceleration.

    The log's own rate is kept for creeping motion, and where decimation does not help or leaves too few rows. The
    second equation has the rows that touch a reversal.
    """
    logged = mechanical.free_torque(record, fast)
    if logged is None:
        return []
    as_logged = [logged, mechanical.reversal_torque(record, logged)]
    if not mechanical.is_noisy(record, logged) or "creep" in fast.extra:
        return as_logged
    assert record.fast is not None
    for factor in DECIMATION_FACTORS:
        slower = replace(record, fast=decimated(record.fast, factor))
        signals = fast_signals(slower, fast.model, slow)
        assert signals is not None
        add_rig_signals(slower, signals)
        equation = mechanical.free_torque(slower, signals)
        if equation is None or int(usable_rows(equation).sum()) < FEWEST_ROWS:
            return as_logged  # too few rows are left
        if not mechanical.is_noisy(slower, equation):
            return [equation, mechanical.reversal_torque(slower, equation)]
    return as_logged


def equations(record: Record, model: Model) -> list[Equation]:
    """Build every equation that the run's channels allow; `record.nominal_effects` subtracts its effects from them."""
    built: list[Equation] = []
    slow = slow_signals(record, model)
    fast = fast_signals(record, model, slow)
    if fast is not None:
        add_rig_signals(record, fast)
        candidates = [
            *(build(record, fast) for build in ELECTRICAL_EQUATIONS),
            *free_rotor_equations(record, fast, slow),
        ]
        candidates += [build(record, fast) for build in MECHANICAL_EQUATIONS]
        built += [equation for equation in candidates if equation is not None]
        if (axis_balance := axis.axis_torque(record, fast)) is not None:
            built = [equation for equation in built if equation.name not in FREE_ROTOR] + [axis_balance]
            note = axis.confounded_note(record, fast)
            record.notes += [note] if note is not None and note not in record.notes else []
        if voltage_feed(record, model) is not None:
            # each test of a voltage is a kind by itself: its own noise would let it fit that run and no other
            built = [replace(equation, kind=VOLTAGE_KIND) for equation in built]
    if slow is not None and record.slow is not None and not record.slow.aside:
        line_voltage = electrical.line_voltage(record, slow)
        built += ([line_voltage] if line_voltage is not None else []) + thermal.temperatures(record, slow)
    return built if record.nominal_effects is None else record.nominal_effects(built)
