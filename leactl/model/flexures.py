"""Compute the preload of bearings on cantilevered flexures, a force in proportion to the deflection of the free end.

The paper has two points of one flexure: 300 N, the static load of the bearing, at 0.5 mm of deflection, and 138 N of
preload at a gap of 0.75 mm, the "told" gap. A line through both points does not go through the origin. They agree to
8 % if the flexure is at rest at a gap of 0.5 mm, so that the gap of 0.75 mm is a deflection of 0.25 mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from leactl.errors import InputError
from leactl.model.motor_schema import Bearings, MotorSheet


@dataclass(frozen=True)
class Reading:
    """One interpretation of the two points: a stiffness, and the gap at which the flexure is at rest."""

    name: str
    stiffness: float  # N/m
    rest_gap: float  # m
    at_told_gap: float  # N, predicted preload at the gap `told_gap`, to compare with `told_preload`
    at_static_deflection: float  # N, predicted force at the static deflection, to compare with the static load


@dataclass(frozen=True)
class Preload:
    """Deflection and preload at one gap, by one reading."""

    gap: float  # m
    deflection: float  # m
    force: float  # N, on one bearing
    side: float  # N, sum of the magnitudes over all bearings of a side; on a centred rotor the forces cancel
    share: float  # force over the static load of a bearing

    @property
    def holds(self) -> bool:
        """Whether the force is at most the static load of a bearing."""
        return self.share <= 1.0


def bearings_of(motor: MotorSheet) -> Bearings:
    """Return the bearings on flexures of a motor.

    Raises
    ------
    InputError : the motor file has no `bearings`.
    """
    if motor.bearings is None:
        raise InputError(f"motor '{motor.name}' has no `bearings:`; a preload needs them")
    return motor.bearings


def readings(bearings: Bearings, rest_gap: float) -> list[Reading]:
    """Return the four readings of a motor's bearings, each with the forces that it predicts; `rest_gap` in m.

    Raises
    ------
    InputError : a rest gap of `told_gap` or more, at which the flexure could not have its preload.
    """
    if not 0.0 <= rest_gap < bearings.told_gap:
        raise InputError(
            f"gap at rest {1e3 * rest_gap:g} mm: from 0 to less than the {1e3 * bearings.told_gap:g} mm for which"
            f" {bearings.told_preload:g} N are told was expected"
        )
    stiffness_from_load = bearings.static_radial_load / bearings.deflection_at_static_load
    stiffness_from_preload = bearings.told_preload / bearings.told_gap
    stiffness_beyond_rest = bearings.told_preload / (bearings.told_gap - rest_gap)
    stiffnesses = [
        ("static load, gap is deflection", stiffness_from_load, 0.0),
        ("told preload, gap is deflection", stiffness_from_preload, 0.0),
        ("static load, beyond the gap at rest", stiffness_from_load, rest_gap),
        ("told preload, beyond the gap at rest", stiffness_beyond_rest, rest_gap),
    ]
    return [
        Reading(
            name,
            stiffness,
            rest_gap_of_reading,
            stiffness * (bearings.told_gap - rest_gap_of_reading),
            stiffness * bearings.deflection_at_static_load,
        )
        for name, stiffness, rest_gap_of_reading in stiffnesses
    ]


def preload(bearings: Bearings, reading: Reading, gap: float) -> Preload:
    """Return the preload at a gap [m]; it is zero for a flexure that is not deflected.

    Raises
    ------
    InputError : a gap below 0 or of 100 mm or more.
    """
    if not 0.0 <= gap < 0.1:
        raise InputError(f"gap {1e3 * gap:g} mm: from 0 to 100 mm was expected")
    deflection = max(gap - reading.rest_gap, 0.0)
    force = reading.stiffness * deflection
    return Preload(gap, deflection, force, bearings.each_side * force, force / bearings.static_radial_load)


def largest_gap(bearings: Bearings, reading: Reading) -> float:
    """Return the gap at which a bearing carries its static load [m]."""
    return reading.rest_gap + bearings.static_radial_load / reading.stiffness


def disagreement(bearings: Bearings, flexure_readings: Sequence[Reading]) -> dict[str, float]:
    """Return, by name of the reading, the relative error at the point from which the reading was not derived."""
    errors = {}
    for reading in flexure_readings:
        preload_error = reading.at_told_gap / bearings.told_preload - 1.0
        load_error = reading.at_static_deflection / bearings.static_radial_load - 1.0
        errors[reading.name] = max(preload_error, load_error, key=abs)
    return errors
