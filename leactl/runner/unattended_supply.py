"""Check, before a run, that no supply can overheat its winding if every process dies.

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
from leactl.safety.thermal.temperature_bound import BURNT_DEGC, HOTTEST, HOUSING


class EndedBy(StrEnum):
    """What keeps a supply that is left on from overheating the winding; NOTHING if nothing does."""

    OUTLIVED = "outlived"
    PROTECTION = "protection"
    ATTENDED = "attended"
    NOTHING = "nothing"


@dataclass(frozen=True)
class SupplyLeftOn:
    """One supply at the leads of a role, with one pair of levels of a plan."""

    role: str
    voltage: float  # V
    current: float  # A
    reached: float  # degC, of the hottest phase at the most, if the levels stay on for ever; infinite for a delta
    ended_by: EndedBy
    # V, trip level of its over-voltage protection: at constant current the voltage rises as the winding warms
    trips_at: float | None = None
    # A, highest measured current to allow, where an unattended run relies on what the winding endures; else infinite
    endured_current: float = math.inf

    @property
    def summary(self) -> str:
        """What happens if nobody switches the supply off, in one line."""
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


def supplies_left_on(plan: Plan, windings: Windings, bench: Bench) -> list[SupplyLeftOn]:
    """Judge each pair of levels of the bench's supplies in a plan, once."""
    supplies = at_leads(bench.others, windings.motors)
    levels: dict[Levels, None] = {}  # a set that keeps the order of the plan
    for action in plan.actions:
        if not isinstance(action, SetSupply):
            continue
        for role, output in action.outputs.items():
            if output is not None and role in supplies:
                levels[role, *output] = None
    return [_judge(windings, supplies[role], plan.attended, role, *output) for role, *output in levels]


def endings(plan: Plan, windings: Windings, left_on: Sequence[SupplyLeftOn]) -> dict[Levels, Ending]:
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
) -> SupplyLeftOn:
    """Judge one pair of levels [V, A]: endured, ended by the supply's protection, attended, or none of these."""
    # `windings.motors`, not `windings.fed`, which allows for errors of current readings: these levels are settings
    motor, settings = windings.motors[role], windings.settings
    otherwise = EndedBy.ATTENDED if attended else EndedBy.NOTHING
    if motor.winding != "wye":  # heat and resistance of two leads are known for a wye alone
        return SupplyLeftOn(role, voltage, current, math.inf, otherwise)
    box = Box.of(motor)
    start: Sequence[float] = windings.recalled[role].nodes.tolist()
    hottest = temperature_reached(box, settings.ambient, voltage, current)
    endured = _endurance(windings, role)
    if endured.outlives(voltage, current, start):
        endured_current = math.inf if attended else endured.highest_current(voltage)
        return SupplyLeftOn(role, voltage, current, hottest, EndedBy.OUTLIVED, endured_current=endured_current)
    if isinstance(supply, ProtectedSupply):  # it is armed even if the run is attended
        # K, of the hottest phase above the coolest: no phase is colder than the coldest air in the tolerances
        phase_difference = max(0.0, start[HOTTEST] - (settings.ambient - box.ambient_rise))
        safe_limit = settings.limit - MARGIN_K
        level = trip_level(box, safe_limit, phase_difference, voltage, current, supply.trip_accuracy)
        if level is not None:
            return SupplyLeftOn(role, voltage, current, hottest, EndedBy.PROTECTION, level)
    return SupplyLeftOn(role, voltage, current, hottest, otherwise)


def _endurance(windings: Windings, role: str) -> Endurance:
    """Return what two leads of a role's motor endure for ever, with the guard's margin."""
    settings = windings.settings
    return endurance(Box.of(windings.motors[role]), settings.limit - MARGIN_K, settings.ambient)


def _refusal(plan: Plan, windings: Windings, item: SupplyLeftOn) -> str:
    """Return the refusal of levels that nothing ends, with what helps."""
    opening = f"protocol '{plan.name}': nothing switches off the supply of {item.role} if this machine fails, and"
    attending = "`attended: true` in the protocol, or --attended"
    if windings.motors[item.role].winding != "wye":
        return (
            f"{opening} the heating of a delta winding through two leads is not bounded here; a person has to stay"
            f" by the bench: {attending}"
        )
    levels = f"{item.voltage:g} V, {item.current:g} A"
    others = (
        f"or a supply whose own protection ends the current in time, or a person who stays by the bench: {attending}"
    )
    endured, limit = _endurance(windings, item.role), windings.settings.limit
    start = windings.recalled[item.role].nodes.tolist()
    if not endured.outlives(0.0, 0.0, start):  # without current, only the temperatures at the start can be too high
        is_rest_enough = endured.outlives(item.voltage, item.current, endured.start_ceilings)
        return (
            f"{opening} {levels} left on are not known to keep its winding below its limit of {limit:g} degC from where"
            f" it may begin, winding {start[HOTTEST]:.0f} and housing {start[HOUSING]:.0f} degC; what helps: a rest"
            f" before the run, in which it cools{'' if is_rest_enough else ', and lower levels'}, {others}"
        )
    # rounded down to what the coarsest supplies can be set to
    volts, amperes = int(10.0 * endured.highest_voltage(item.current)) / 10.0, int(10.0 * endured.current) / 10.0
    remedies = [f"current_A of {amperes:g} at the most"]
    if endured.outlives(volts, item.current, start):
        remedies.insert(0, f"voltage_V of {volts:g} at the most, where the supply itself takes the current back")
    heat = f"to {item.reached:.0f} degC, above" if item.reached < BURNT_DEGC else "far above"
    return (
        f"{opening} {levels} left on may bring its winding {heat} its limit of {limit:g} degC; what helps:"
        f" {', or '.join(remedies)}, {others}"
    )
