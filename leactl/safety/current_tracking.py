"""Check of a drive's q-axis current against its demand: it finds a dead sensor, a wrong sign, an undemanded current.

In velocity and angle mode the drive chooses its current by itself, and nothing is compared.
"""

import math
from collections import deque
from typing import NamedTuple

from leactl.driver.contract import MotionDevice
from leactl.model.winding import WindingType, voltage_ceiling
from leactl.safety.cross_checks import MOST_CYCLES_APART
from leactl.safety.interlocks import CurrentDisagreement
from leactl.safety.limits import Limits
from leactl.safety.watching import Trip

FLOOR_SHARE = 0.005  # of the bench's limit of the current: default floor, for the zero errors of current sensors
# a drive that is off may read this multiple of the floor, because no controller removes the zero error of its sensor
OFF_FLOORS = 8.0


class VoltageNeed(NamedTuple):
    """Constants of the voltage that a q-axis current needs: back-EMF constant, hot resistance; SI, power invariant."""

    back_emf_constant: float = 0.0
    resistance: float = 0.0
    winding: WindingType = "wye"

    def of(self, current: float, velocity: float) -> float:
        """Return the highest voltage [V] that a current [A] may need at a velocity [rad/s]."""
        return self.back_emf_constant * abs(velocity) + self.resistance * abs(current)


class CurrentTracking:
    """Trips on a current that stays away from its demand.

    A demand that the lowest bus voltage of the bench cannot drive at the shaft's speed is not judged: the voltage then
    explains a lower current. A reading that is NaN neither begins nor ends a disagreement; its age is checked
    elsewhere.
    """

    def __init__(
        self,
        role: str,
        motion: MotionDevice,
        settings: CurrentDisagreement,
        limits: Limits,
        voltage_need: VoltageNeed,
        trip: Trip,
    ) -> None:
        self._role, self._motion, self._trip, self._voltage_need = role, motion, trip, voltage_need
        self._allowed_share, self._for_s = settings.share_percent / 100.0, settings.for_s
        self._floor = settings.floor_A or FLOOR_SHARE * limits.current_A
        self._lowest_bus_ceiling = voltage_ceiling(limits.bus_voltage_low_V, voltage_need.winding)
        self._demands: deque[float] = deque(maxlen=MOST_CYCLES_APART + 1)
        self.since, self._disagreeing_cycles = math.nan, 0  # when the present disagreement began, and its cycles
        self.turn_to(judges=False)

    def turn_to(self, judges: bool) -> None:
        """Begin anew in another mode; `judges` tells whether the demanded current is known in that mode."""
        self._judges = judges
        self._demands.clear()
        self.since = math.nan
        self.ask(0.0)

    def ask(self, demand: float) -> None:
        """Take a new demand [A]; readings from `low` to `high` agree with it, all other readings need `look`."""
        self._demanded_in_cycle = True
        self._demands.append(demand)
        if self._judges:
            allowed = self._floor + self._allowed_share * (demand if demand > 0.0 else -demand)
            self.low, self.high = demand - allowed, demand + allowed
        else:
            self.low, self.high = -math.inf, math.inf

    def look(self, current: float, velocity: float, now: float) -> None:
        """Judge a reading [A] outside `low` to `high` by all demands to which it may belong.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        if not self._judges:
            return
        demands = self._demands
        demand = demands[-1]
        if not self._demanded_in_cycle:  # the same demand for another cycle
            demands.append(demand)
        self._demanded_in_cycle = False
        if current != current:
            return
        low, high = min(demands), max(demands)
        allowed = self._floor + self._allowed_share * (high if high > -low else -low)
        if (
            low - allowed <= current <= high + allowed
            or self._voltage_need.of(demand, velocity) >= self._lowest_bus_ceiling
        ):
            self.since = math.nan
            return
        if not self._motion.engaged:
            allowed = OFF_FLOORS * self._floor
            if abs(current) <= allowed:
                self.since = math.nan
                return
        if not self.since <= now:
            self.since, self._disagreeing_cycles = now, 0
        self._disagreeing_cycles += 1
        if now - self.since >= self._for_s and self._disagreeing_cycles > MOST_CYCLES_APART:
            self._trip(
                f"{self._role} q_axis_current of {current:.4g} A contradicts its demand of {demand:.4g} A for"
                f" {now - self.since:.3g} s; {allowed:.3g} A apart are allowed: is the current sensor connected, and"
                " does another master command the drive?"
            )
