"""Equations of the bench, one for each channel that can be checked against the others."""

from dataclasses import replace

from leactl.effects.contract import Signals
from leactl.gap.equations import axis, electrical, mechanical, motion, thermal, twist
from leactl.gap.equations.contract import FEWEST_ROWS, Equation, usable
from leactl.gap.signals.decimation import decimated
from leactl.gap.signals.derived import fast_signals, slow_signals
from leactl.gap.signals.record import Record
from leactl.gap.signals.rig import VOLTAGE, complete, fed_by_voltage
from leactl.model.nominal import Model

__all__ = ["Equation", "equations"]

DRIVEN = (electrical.voltage, electrical.current, electrical.bus)
MOVED = (
    mechanical.coupled,
    mechanical.both,
    mechanical.held_still,
    mechanical.swung,
    motion.velocity,
    twist.coupled,
    twist.locked,
)
FACTORS = (2, 4, 8, 16)  # by which a log's rate is divided where its encoder is coarse


def free_rotor(record: Record, fast: Signals, slow: Signals | None) -> Equation | None:
    """Balance of a free rotor, at the highest rate at which its encoder's counts do not drown its acceleration.

    At the log's own rate where none helps, as for a shaft that hardly accelerates, and for a chain of rests.
    """
    logged = mechanical.free(record, fast)
    if logged is None or not mechanical.is_loud(record, logged) or "creep" in fast.extra:
        return logged
    assert record.fast is not None
    for factor in FACTORS:
        slower = replace(record, fast=decimated(record.fast, factor))
        signals = fast_signals(slower, fast.model, slow)
        assert signals is not None
        complete(slower, signals)
        equation = mechanical.free(slower, signals)
        if equation is None or int(usable(equation).sum()) < FEWEST_ROWS:
            return logged  # too few rows are left
        if not mechanical.is_loud(slower, equation):
            return equation
    return logged


def equations(record: Record, model: Model) -> list[Equation]:
    """Every equation that a run has the channels for, without what effects of its nominal do."""
    built: list[Equation] = []
    slow = slow_signals(record, model)
    fast = fast_signals(record, model, slow)
    if fast is not None:
        complete(record, fast)
        every = [*(build(record, fast) for build in DRIVEN), free_rotor(record, fast, slow)]
        every += [build(record, fast) for build in MOVED]
        built += [equation for equation in every if equation is not None]
        if (own := axis.axis(record, fast)) is not None:
            built = [equation for equation in built if equation.name != "free_torque"] + [own]
            note = axis.confounded(record, fast)
            record.notes += [note] if note is not None and note not in record.notes else []
        if fed_by_voltage(record, model) is not None:
            # each test of a voltage is a kind by itself: one run's own noise would let it fit that run and no other
            built = [replace(equation, kind=VOLTAGE) for equation in built]
    if slow is not None and record.slow is not None and not record.slow.aside:
        line = electrical.line_voltage(record, slow)
        built += ([line] if line is not None else []) + thermal.temperatures(record, slow)
    return built if record.nominal_effects is None else record.nominal_effects(built)
