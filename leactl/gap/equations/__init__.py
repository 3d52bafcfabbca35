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
FREE_ROTOR = ("free_torque", "reversal_torque")  # balances of the bench's rotor, which the balance of an axis replaces
DECIMATION_FACTORS = (2, 4, 8, 16)  # factors by which a log's rate is divided where its encoder is coarse


def free_rotor_equations(record: Record, fast: Signals, slow: Signals | None) -> list[Equation]:
    """Return a free rotor's torque balances at the highest rate at which encoder noise does not mask acceleration.

    The log's own rate is kept for creeping motion, and where decimation does not help or leaves too few rows. The
    second equation has the rows that touch a reversal.
    """
    logged_balance = mechanical.free_torque(record, fast)
    if logged_balance is None:
        return []
    balances_as_logged = [logged_balance, mechanical.reversal_torque(record, logged_balance)]
    if not mechanical.is_noisy(record, logged_balance) or "creep" in fast.extra:
        return balances_as_logged
    assert record.fast is not None
    for factor in DECIMATION_FACTORS:
        slower_record = replace(record, fast=decimated(record.fast, factor))
        signals = fast_signals(slower_record, fast.model, slow)
        assert signals is not None
        add_rig_signals(slower_record, signals)
        balance = mechanical.free_torque(slower_record, signals)
        if balance is None or int(usable_rows(balance).sum()) < FEWEST_ROWS:
            return balances_as_logged  # too few rows are left
        if not mechanical.is_noisy(slower_record, balance):
            return [balance, mechanical.reversal_torque(slower_record, balance)]
    return balances_as_logged


def equations(record: Record, model: Model) -> list[Equation]:
    """Return every equation that the run's channels allow, less the nominal effects that `record` has."""
    equations_of_run: list[Equation] = []
    slow = slow_signals(record, model)
    fast = fast_signals(record, model, slow)
    if fast is not None:
        add_rig_signals(record, fast)
        candidates = [
            *(build(record, fast) for build in ELECTRICAL_EQUATIONS),
            *free_rotor_equations(record, fast, slow),
        ]
        candidates += [build(record, fast) for build in MECHANICAL_EQUATIONS]
        equations_of_run += [equation for equation in candidates if equation is not None]
        if (axis_balance := axis.axis_torque(record, fast)) is not None:
            equations_of_run = [equation for equation in equations_of_run if equation.name not in FREE_ROTOR] + [
                axis_balance
            ]
            note = axis.confounded_note(record, fast)
            record.notes += [note] if note is not None and note not in record.notes else []
        if voltage_feed(record, model) is not None:
            # each test of a voltage is a kind by itself: its own noise would let it fit that run and no other
            equations_of_run = [replace(equation, kind=VOLTAGE_KIND) for equation in equations_of_run]
    if slow is not None and record.slow is not None and not record.slow.aside:
        line_voltage = electrical.line_voltage(record, slow)
        equations_of_run += ([line_voltage] if line_voltage is not None else []) + thermal.temperatures(record, slow)
    return equations_of_run if record.nominal_effects is None else record.nominal_effects(equations_of_run)
