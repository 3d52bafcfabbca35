"""Plans that switch a supply on, before anything moves: what ends its current if every process is dead.

Either the winding outlives levels that stay on for ever, or the instrument's own protection ends them, or a person says
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
from leactl.safety.thermal.bound import BURNT, HOTTEST
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.guard import MARGIN_K
from leactl.safety.thermal.supply_left_on import Endured, endured, reached, trip_level


class EndedBy(StrEnum):
    """What ends a supply's current, or makes that unnecessary."""

    OUTLIVED = "outlived"
    PROTECTION = "protection"
    ATTENDED = "attended"
    NOTHING = "nothing"


@dataclass(frozen=True)
class LeftOn:
    """One supply at the leads of a role, with levels that a plan has it put out."""

    role: str
    voltage: float  # V
    current: float  # A
    reached: float  # degC, of the hottest phase at the most, if they stay on for ever
    ended_by: EndedBy
    trips_at: float | None = None  # V, of its protection
    most: float = math.inf  # A, that it may be seen to give; what is outlived holds for no more

    @property
    def told(self) -> str:
        """What comes of it if nobody switches it off, in one line."""
        told = f"{self.role} supply left on at {self.voltage:g} V, {self.current:g} A: winding {_hot(self.reached)}"
        match self.ended_by:
            case EndedBy.OUTLIVED:
                return f"{told}, which it outlives"
            case EndedBy.PROTECTION:
                return f"{told}, but for the supply's own protection at {self.trips_at:.2f} V"
            case EndedBy.ATTENDED:
                return f"{told}; the run is attended"
            case _:
                return f"{told}, and nothing ends it"


def left_on(plan: Plan, windings: Windings, bench: Bench) -> list[LeftOn]:
    """Each pair of levels that a plan has the bench's supplies put out, once."""
    supplies = at_leads(bench.others, windings.motors)
    levels: dict[Levels, None] = {}
    for action in plan.actions:
        for role, output in action.outputs.items() if isinstance(action, SetSupply) else ():
            if output is not None and role in supplies:
                levels[role, *output] = None
    return [_judged(windings, supplies[role], plan.attended, role, *output) for role, *output in levels]


def endings(plan: Plan, windings: Windings, powered: Sequence[LeftOn]) -> dict[Levels, Ending]:
    """What makes each pair of levels that are `left_on` end or endurable, for the supervisor to arm and to watch.

    Raises
    ------
    InputError : levels that nothing ends; a line each, with the ways out.
    """
    faults = [_refusal(plan, windings, one) for one in powered if one.ended_by is EndedBy.NOTHING]
    if faults:
        raise InputError(faults)
    return {(one.role, one.voltage, one.current): Ending(one.trips_at, one.most) for one in powered}


def _judged(
    windings: Windings, supply: PowerSupply, attended: bool, role: str, voltage: float, current: float
) -> LeftOn:
    motor, settings = windings.motors[role], windings.settings  # a reading that repeats says nothing of a setting
    if motor.winding != "wye":  # what two leads heat, and their resistance, is known of a wye alone
        return LeftOn(role, voltage, current, math.inf, EndedBy.ATTENDED if attended else EndedBy.NOTHING)
    box = Box.of(motor)
    start: Sequence[float] = windings.recalled[role].nodes.tolist()
    hottest = reached(box, settings.ambient, voltage, current)
    carried = _endured(windings, role)
    if carried.outlives(voltage, current, start):
        most = math.inf if attended else carried.most(voltage)
        return LeftOn(role, voltage, current, hottest, EndedBy.OUTLIVED, most=most)
    if isinstance(supply, ProtectedSupply):
        uneven = max(0.0, start[HOTTEST] - (settings.ambient - box.ambient_rise))
        limit = settings.limit - MARGIN_K
        level = trip_level(box, limit, uneven, voltage, current, supply.trip_accuracy)
        if level is not None:
            return LeftOn(role, voltage, current, hottest, EndedBy.PROTECTION, level)
    return LeftOn(role, voltage, current, hottest, EndedBy.ATTENDED if attended else EndedBy.NOTHING)


def _endured(windings: Windings, role: str) -> Endured:
    settings = windings.settings
    return endured(Box.of(windings.motors[role]), settings.limit - MARGIN_K, settings.ambient)


def _refusal(plan: Plan, windings: Windings, one: LeftOn) -> str:
    carried = _endured(windings, one.role)
    # rounded down to what the coarsest supplies can be set to
    volts, amperes = int(10.0 * carried.voltage(one.current)) / 10.0, int(10.0 * carried.current) / 10.0
    start = windings.recalled[one.role]
    ways = [f"current_A of {amperes:g} at the most"]
    if carried.outlives(volts, one.current, carried.nodes):
        ways.insert(0, f"voltage_V of {volts:g} at the most, where the supply itself takes the current back")
    if not carried.outlives(0.0, 0.0, start.nodes.tolist()):
        ways = ["a rest before"]
    return (
        f"protocol '{plan.name}': nothing switches off the supply of {one.role} if this machine fails, and"
        f" {one.voltage:g} V, {one.current:g} A left on may bring its winding to {_hot(one.reached)}, above its limit"
        f" of {windings.settings.limit:g} degC; what helps: {', or '.join(ways)}, or a supply whose own protection ends"
        " it in time, or a person who stays by it: `attended: true` in the protocol, or --attended"
    )


def _hot(temperature: float) -> str:
    return f"{temperature:.0f} degC" if temperature < BURNT else "ruin"
