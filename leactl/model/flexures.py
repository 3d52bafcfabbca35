"""Preload of bearings on cantilevered flexures: a force in proportion to the deflection of the free end.

The paper tells two points of one flexure: 300 N, the static load of the bearing, at 0.5 mm of deflection, and 138 N of
preload at a gap of 0.75 mm. A line through both does not go through the origin. They agree to 8 % where the gap at
which the flexure is at rest is 0.5 mm, so that 0.75 mm is a deflection of 0.25 mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from leactl.errors import InputError
from leactl.model.motor_schema import Bearings, MotorSheet


@dataclass(frozen=True)
class Reading:
    """One way to read the two told points: a stiffness, and the gap at which the flexure is at rest."""

    name: str
    stiffness: float  # N/m
    rest_gap: float  # m
    at_told_gap: float  # N, to be compared with the told preload
    at_static_deflection: float  # N, to be compared with the static load


@dataclass(frozen=True)
class Preload:
    """What one gap means under one reading."""

    gap: float  # m
    deflection: float  # m
    force: float  # N, of one bearing
    side: float  # N, of all bearings of a side, magnitudes added; on a centred rotor they cancel
    share: float  # of the static load of a bearing

    @property
    def holds(self) -> bool:
        """Whether a bearing takes it."""
        return self.share <= 1.0


def bearings_of(motor: MotorSheet) -> Bearings:
    """The bearings on flexures of a motor.

    Raises
    ------
    InputError : its file tells of none.
    """
    if motor.bearings is None:
        raise InputError(f"motor '{motor.name}' has no `bearings:`; a preload needs them")
    return motor.bearings


def readings(bearings: Bearings, rest_gap: float) -> list[Reading]:
    """Return the four readings of a motor's figures, each with the force that it predicts; `rest_gap` in m.

    Raises
    ------
    InputError : a flexure at rest at the told gap or beyond, which could not have a preload there.
    """
    if not 0.0 <= rest_gap < bearings.told_gap:
        raise InputError(
            f"gap at rest {1e3 * rest_gap:g} mm: from 0 to less than the {1e3 * bearings.told_gap:g} mm for which"
            f" {bearings.told_preload:g} N are told was expected"
        )
    static = bearings.static_radial_load / bearings.deflection_at_static_load
    told = bearings.told_preload / bearings.told_gap
    beyond = bearings.told_preload / (bearings.told_gap - rest_gap)
    ways = [
        ("static load, gap is deflection", static, 0.0),
        ("told preload, gap is deflection", told, 0.0),
        ("static load, beyond the gap at rest", static, rest_gap),
        ("told preload, beyond the gap at rest", beyond, rest_gap),
    ]
    return [
        Reading(
            name,
            stiffness,
            rest,
            stiffness * (bearings.told_gap - rest),
            stiffness * bearings.deflection_at_static_load,
        )
        for name, stiffness, rest in ways
    ]


def preload(bearings: Bearings, reading: Reading, gap: float) -> Preload:
    """Preload at a gap [m]; a flexure that is not deflected carries none.

    Raises
    ------
    InputError : a gap that is no length.
    """
    if not 0.0 <= gap < 0.1:
        raise InputError(f"gap {1e3 * gap:g} mm: from 0 to 100 mm was expected")
    deflection = max(gap - reading.rest_gap, 0.0)
    force = reading.stiffness * deflection
    return Preload(gap, deflection, force, bearings.each_side * force, force / bearings.static_radial_load)


def most_gap(bearings: Bearings, reading: Reading) -> float:
    """Gap at which a bearing carries its static load [m]."""
    return reading.rest_gap + bearings.static_radial_load / reading.stiffness


def disagreement(bearings: Bearings, ways: Sequence[Reading]) -> dict[str, float]:
    """By how much each reading misses the point that it was not made from, relative."""
    misses = {}
    for reading in ways:
        told = reading.at_told_gap / bearings.told_preload - 1.0
        static = reading.at_static_deflection / bearings.static_radial_load - 1.0
        misses[reading.name] = max(told, static, key=abs)
    return misses
