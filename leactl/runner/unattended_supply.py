"""Check of plans that switch a supply on, before anything moves: what ends the current if every process dies.

Either the winding endures the levels for ever, or the protection of the instrument ends the current, or a person says
that they attend the run; a plan without any of the three is refused.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from leactl.bench.bench import Bench
from leactl.driver.contract import PowerSupply, ProtectedSupply
from leactl.errors import InputError
from leactl.protocol.plan import Plan, SetSupply
from leactl.runner.thermal_admission import Windings
from leactl.safety.supplies import Ending, Levels, at_leads
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.guard import MARGIN_K
from leactl.safety.thermal.supply_left_on import Endurance, endurance, temperature_reached, trip_level
from leactl.safety.thermal.temperature_bound import BURNT_DEGC, HOTTEST


class EndedBy(StrEnum):
    """What keeps a supply that is left on from overheating the winding; NOTHING if nothing does."""

    OUTLIVED = "outlived"
    PROTECTION = "protection"
    ATTENDED = "attended"
    NOTHING = "nothing"


@dataclass(frozen=True)
class LeftOn:
    """One supply at the leads of a role, with one pair of levels of a plan."""

    role: str
    voltage: float  # V
    current: float  # A
    reached: float  # degC, of the hottest phase at the most, if the levels stay on for ever; infinite for a delta
    ended_by: EndedBy
    trips_at: float | None = None  # V, trip level of its protection
    endured_current: float = math.inf  # A, highest reading for which the winding endures the levels

    @property
    def summary(self) -> str:
        """The consequence if nobody switches the supply off, in one line."""
        levels = f"{self.role} supply left on at {self.voltage:g} V, {self.current:g} A: winding {self._temperature}"
        match self.ended_by:
            case EndedBy.OUTLIVED:
                return f"{levels}, which it outlives"
            case EndedBy.PROTECTION:
                return f"{levels}, but for the supply's own protection at {self.trips_at:.2f} V"
            case EndedBy.ATTENDED:
                return f"{levels}; the run is attended"
            case _:
                return f"{levels}; nothing ends the current"

    @property
    def _temperature(self) -> str:
        if math.isinf(self.reached):
            return "temperature not bounded"
        return f"{self.reached:.0f} degC" if self.reached < BURNT_DEGC else "above every limit"


def supplies_left_on(plan: Plan, windings: Windings, bench: Bench) -> list[LeftOn]:
    """Judge each pair of levels of the bench's supplies in a plan, once."""
    supplies = at_leads(bench.others, windings.motors)
    levels: dict[Levels, None] = {}
    for action in plan.actions:
        for role, output in action.outputs.items() if isinstance(action, SetSupply) else ():
            if output is not None and role in supplies:
                levels[role, *output] = None
    return [_judge(windings, supplies[role], plan.attended, role, *output) for role, *output in levels]


def endings(plan: Plan, windings: Windings, left_on: Sequence[LeftOn]) -> dict[Levels, Ending]:
    """Return for each pair of levels the protection to arm and the highest current to allow, for the supervisor.

    Raises
    ------
    InputError : one line for each pair of levels that nothing ends, with what helps.
    """
    faults = [_refusal(plan, windings, item) for item in left_on if item.ended_by is EndedBy.NOTHING]
    if faults:
        raise InputError(faults)
    return {(item.role, item.voltage, item.current): Ending(item.trips_at, item.endured_current) for item in left_on}


def _judge(
    windings: Windings, supply: PowerSupply, attended: bool, role: str, voltage: float, current: float
) -> LeftOn:
    # `motors`, not `fed`: levels count as they are set, and the tolerance of the line current in `fed` is of readings
    motor, settings = windings.motors[role], windings.settings
    if motor.winding != "wye":  # heat and resistance of two leads are known for a wye alone
        return LeftOn(role, voltage, current, math.inf, EndedBy.ATTENDED if attended else EndedBy.NOTHING)
    box = Box.of(motor)
    start: Sequence[float] = windings.recalled[role].nodes.tolist()
    hottest = temperature_reached(box, settings.ambient, voltage, current)
    limits = _endurance(windings, role)
    if limits.outlives(voltage, current, start):
        endured_current = math.inf if attended else limits.highest_current(voltage)
        return LeftOn(role, voltage, current, hottest, EndedBy.OUTLIVED, endured_current=endured_current)
    if isinstance(supply, ProtectedSupply):
        uneven = max(0.0, start[HOTTEST] - (settings.ambient - box.ambient_rise))
        limit = settings.limit - MARGIN_K
        level = trip_level(box, limit, uneven, voltage, current, supply.trip_accuracy)
        if level is not None:
            return LeftOn(role, voltage, current, hottest, EndedBy.PROTECTION, level)
    return LeftOn(role, voltage, current, hottest, EndedBy.ATTENDED if attended else EndedBy.NOTHING)


def _endurance(windings: Windings, role: str) -> Endurance:
    settings = windings.settings
    return endurance(Box.of(windings.motors[role]), settings.limit - MARGIN_K, settings.ambient)


def _refusal(plan: Plan, windings: Windings, item: LeftOn) -> str:
    """Return the refusal of levels that nothing ends, with what helps."""
    unattended = f"protocol '{plan.name}': nothing switches off the supply of {item.role} if this machine fails, and"
    person = "`attended: true` in the protocol, or --attended"
    if windings.motors[item.role].winding != "wye":
        return (
            f"{unattended} the heating of a delta winding through two leads is not bounded here; a person has to stay"
            f" by it: {person}"
        )
    limits = _endurance(windings, item.role)
    # rounded down to what the coarsest supplies can be set to
    volts, amperes = int(10.0 * limits.highest_voltage(item.current)) / 10.0, int(10.0 * limits.current) / 10.0
    start = windings.recalled[item.role]
    remedies = [f"current_A of {amperes:g} at the most"]
    if limits.outlives(volts, item.current, limits.start_ceilings):
        remedies.insert(0, f"voltage_V of {volts:g} at the most, where the supply itself takes the current back")
    if not limits.outlives(0.0, 0.0, start.nodes.tolist()):
        remedies = ["a rest before"]
    heat = f"to {item.reached:.0f} degC, above" if item.reached < BURNT_DEGC else "far above"
    return (
        f"{unattended} {item.voltage:g} V, {item.current:g} A left on may bring its winding {heat} its limit of"
        f" {windings.settings.limit:g} degC; what helps: {', or '.join(remedies)}, or a supply whose own protection"
        f" ends it in time, or a person who stays by it: {person}"
    )
