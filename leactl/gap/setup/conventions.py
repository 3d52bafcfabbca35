"""Named factors: conventions of transformations, mistaken units, and small whole numbers."""

import math
from fractions import Fraction

CURRENT_FACTORS = {
    "2/3": 2.0 / 3.0,
    "3/2": 1.5,
    "sqrt(3/2)": math.sqrt(1.5),
    "sqrt(2/3)": math.sqrt(2.0 / 3.0),
    "sqrt(2)": math.sqrt(2.0),
    "1/sqrt(2)": math.sqrt(0.5),
    "sqrt(3)": math.sqrt(3.0),
    "1/sqrt(3)": math.sqrt(1.0 / 3.0),
}
"""Factors between conventions of currents, voltages and torque constants: power or amplitude, peak or effective value,
line or phase."""
UNIT_FACTORS = {
    "1000": 1000.0,
    "1/1000": 1e-3,
    "pi/180": math.pi / 180.0,
    "180/pi": 180.0 / math.pi,
    "60/(2 pi)": 30.0 / math.pi,
    "2 pi/60": math.pi / 30.0,
    "1/(2 pi)": 0.5 / math.pi,
    "2 pi": 2.0 * math.pi,
}
FACTORS = CURRENT_FACTORS | UNIT_FACTORS
TIME_FACTORS = {"1000": 1000.0, "1/1000": 1e-3, "1000000": 1e6, "1/1000000": 1e-6, "60": 60.0, "1/60": 1.0 / 60.0}
CONVENTION_TOLERANCE = 0.06  # largest difference of logarithms between a factor and its convention
MOST_RATE_DENOMINATOR = 10  # largest denominator of a ratio of two sampling rates
MOST_POLE_PAIRS = 64  # largest whole number that is taken for pole pairs or a gear
WHOLE_TOLERANCE = 0.25  # largest distance of a factor from a whole number


def convention(factor: float, error: float = 0.0) -> str:
    """Return the name of the convention that a factor equals within its error; empty if it equals none."""
    size = abs(factor)
    nearest = min(FACTORS, key=lambda name: abs(math.log(size / FACTORS[name])))
    return (
        ("-" if factor < 0.0 else "") + nearest
        if abs(math.log(size / FACTORS[nearest])) < CONVENTION_TOLERANCE + error
        else ""
    )


def time_unit(factor: float, error: float) -> str:
    """Return the unit or ratio of rates that a factor of time equals; empty if it is neither."""
    nearest = min(TIME_FACTORS, key=lambda name: abs(math.log(factor / TIME_FACTORS[name])))
    if abs(math.log(factor / TIME_FACTORS[nearest])) < CONVENTION_TOLERANCE + error:
        return nearest
    ratio = Fraction(factor).limit_denominator(MOST_RATE_DENOMINATOR)
    if (
        1 in (ratio.numerator, ratio.denominator)
        and ratio
        and abs(math.log(factor / float(ratio))) < CONVENTION_TOLERANCE + error
    ):
        return str(ratio)
    return ""


def whole_number(factor: float, error: float) -> int | None:
    """Return the whole number, 2 to `MOST_POLE_PAIRS`, that a factor or its inverse equals; None if it equals none."""
    larger = max(factor, 1.0 / factor)
    number = round(larger)
    tolerance = WHOLE_TOLERANCE / max(number, 1)  # of the logarithm
    is_determined = 2 <= number <= MOST_POLE_PAIRS and error < tolerance
    return number if is_determined and abs(math.log(larger / number)) < tolerance + error else None
