"""Check of a drive's q-axis current against its demand: a dead sensor, a turned sign, a current nobody demanded.

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

FLOOR_SHARE = 0.005  # of the bench's limit of the current: accuracy of the zeros of current sensors
OFF_FLOORS = 8.0  # floors that the current of a drive that is off may read: no controller removes its zero error


class VoltageNeed(NamedTuple):
    """Constants for the voltage that a current needs, SI, power invariant: back-EMF constant and hot resistance."""

    back_emf_constant: float = 0.0
    resistance: float = 0.0
    winding: WindingType = "wye"

    def of(self, current: float, velocity: float) -> float:
        """Return the highest voltage that a current may need at a speed [V]."""
        return self.back_emf_constant * abs(velocity) + self.resistance * abs(current)


class CurrentTracking:
    """Trips on a current that stays away from its demand.

    A demand that the lowest bus voltage of the bench cannot drive at the shaft's speed is not judged: the voltage then
    explains a lower current. A reading that is no number neither begins nor ends a disagreement; its age is checked
    elsewhere.
    """

    def __init__(
        self,
        role: str,
        motion: MotionDevice,
        settings: CurrentDisagreement,
        limits: Limits,
        need: VoltageNeed,
        trip: Trip,
    ) -> None:
        self._role, self._motion, self._trip, self._need = role, motion, trip, need
        self._share, self._for_s = settings.share_percent / 100.0, settings.for_s
        self._floor = settings.floor_A or FLOOR_SHARE * limits.current_A
        self._available = voltage_ceiling(limits.bus_voltage_low_V, need.winding)
        self._demands: deque[float] = deque(maxlen=MOST_CYCLES_APART + 1)
        self.since, self._cycles = math.nan, 0  # when the present disagreement began, and its cycles
        self.turn_to(judges=False)

    def turn_to(self, judges: bool) -> None:
        """Begin anew in another mode; `judges` is whether the demanded current is known in it."""
        self._judges = judges
        self._demands.clear()
        self.since = math.nan
        self.ask(0.0)

    def ask(self, demand: float) -> None:
        """Take a new demand [A]; readings from `low` to `high` agree with it, all others need `look`."""
        self._asked = True
        self._demands.append(demand)
        if self._judges:
            allowed = self._floor + self._share * (demand if demand > 0.0 else -demand)
            self.low, self.high = demand - allowed, demand + allowed
        else:
            self.low, self.high = -math.inf, math.inf

    def look(self, current: float, velocity: float, now: float) -> None:
        """Judge a reading outside `low` to `high` by all demands that it may belong to.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        if not self._judges:
            return
        demands = self._demands
        demand = demands[-1]
        if not self._asked:  # the same demand for another cycle
            demands.append(demand)
        self._asked = False
        if current != current:
            return
        low, high = min(demands), max(demands)
        allowed = self._floor + self._share * (high if high > -low else -low)
        if low - allowed <= current <= high + allowed or self._need.of(demand, velocity) >= self._available:
            self.since = math.nan
            return
        if not self._motion.engaged:
            allowed = OFF_FLOORS * self._floor
            if abs(current) <= allowed:
                self.since = math.nan
                return
        if not self.since <= now:
            self.since, self._cycles = now, 0
        self._cycles += 1
        if now - self.since >= self._for_s and self._cycles > MOST_CYCLES_APART:
            self._trip(
                f"{self._role} q_axis_current of {current:.4g} A contradicts its demand of {demand:.4g} A for"
                f" {now - self.since:.3g} s; {allowed:.3g} A apart are allowed: is the current sensor connected, and"
                " does another master command the drive?"
            )
