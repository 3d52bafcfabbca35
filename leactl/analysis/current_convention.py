"""Ratios of torque constants by which a wrong convention of current shows.

q-axis current, power-invariant, is sqrt(3/2) times the amplitude of a phase and sqrt(3) times its rms value.
"""

import math

CONVENTIONS = {
    math.sqrt(3 / 2): "the current may be a phase amplitude taken for q-axis current",
    math.sqrt(2 / 3): "the current may be q-axis current taken for a phase amplitude",
    math.sqrt(3): "the current may be a phase rms taken for q-axis current",
    math.sqrt(1 / 3): "the current may be q-axis current taken for a phase rms",
}
WITHIN = 0.02


def named(ratio: float) -> str:
    """What a torque constant this many times too large says of its current; empty where it says nothing."""
    found = (why for factor, why in CONVENTIONS.items() if abs(ratio / factor - 1.0) < WITHIN)
    return next((f"{why}; check current_convention" for why in found), "")
