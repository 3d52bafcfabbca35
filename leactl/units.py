"""Units in which foreign files may be written, each with its factor and zero in the units of run files."""

import math
from typing import Final, NamedTuple

from leactl.quantities import LINEAR_UNITS, accepted_units

TURN = 2.0 * math.pi
POUND_FORCE = 4.4482216152605  # N

# target unit -> source unit -> (factor, zero): target = factor * (source - zero)
CONVERSIONS: Final[dict[str, dict[str, tuple[float, float]]]] = {
    "rad": {"rad": (1, 0), "mrad": (1e-3, 0), "deg": (TURN / 360, 0), "turn": (TURN, 0), "rev": (TURN, 0)},
    "rad/s": {
        "rad/s": (1, 0),
        "deg/s": (TURN / 360, 0),
        "rpm": (TURN / 60, 0),
        "turn/s": (TURN, 0),
        "rev/s": (TURN, 0),
        "Hz": (TURN, 0),
    },
    "m": {"m": (1, 0), "cm": (1e-2, 0), "mm": (1e-3, 0), "um": (1e-6, 0), "in": (0.0254, 0)},
    "m/s": {"m/s": (1, 0), "cm/s": (1e-2, 0), "mm/s": (1e-3, 0), "um/s": (1e-6, 0), "in/s": (0.0254, 0)},
    "N*m": {
        "N*m": (1, 0),
        "mN*m": (1e-3, 0),
        "N*cm": (1e-2, 0),
        "N*mm": (1e-3, 0),
        "kgf*cm": (0.0980665, 0),
        "lbf*in": (0.0254 * POUND_FORCE, 0),
        "lbf*ft": (0.3048 * POUND_FORCE, 0),
    },
    "N": {"N": (1, 0), "mN": (1e-3, 0), "kN": (1e3, 0), "kgf": (9.80665, 0), "lbf": (POUND_FORCE, 0)},
    "A": {"A": (1, 0), "mA": (1e-3, 0), "uA": (1e-6, 0), "kA": (1e3, 0)},
    "V": {"V": (1, 0), "mV": (1e-3, 0), "uV": (1e-6, 0), "kV": (1e3, 0)},
    "degC": {"degC": (1, 0), "K": (1, 273.15), "degF": (5 / 9, 32)},
    "1": {"1": (1, 0), "%": (1e-2, 0)},
}
SECONDS: Final[dict[str, float]] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
LINEAR: Final = frozenset(LINEAR_UNITS.values())  # units of linear axes in run files


class Conversion(NamedTuple):
    """Conversion of numbers to a unit of run files: target = factor * (source - zero)."""

    target: str  # unit
    factor: float
    zero: float  # in the source unit


def converter(units: str, quantity: str) -> Conversion | None:
    """Return the conversion from these units to a unit of the quantity; None if they measure another quantity."""
    for target in accepted_units(quantity):
        if units in CONVERSIONS[target]:
            return Conversion(target, *CONVERSIONS[target][units])
    return None


def known_units(quantity: str) -> list[str]:
    """Return every unit in which a file may give a quantity."""
    return [units for target in accepted_units(quantity) for units in CONVERSIONS[target]]
