"""Supplies of direct current under supervision: limits of their output, and the heat in the leads that they feed.

The measured current counts as heat. After a command, until two readings have come (the first may have been measured
before the command), the commanded current counts if it is higher. A reading that is NaN counts as the highest current
of the supply.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple, NoReturn

from leactl.driver.contract import Driver, PowerSupply, ProtectedSupply, Row
from leactl.errors import InputError
from leactl.safety.limits import LEADS, Limits
from leactl.safety.thermal.guard import ThermalGuard
from leactl.safety.thermal.measured import Leads

QUANTITY = "line_current"
FIRST_TRUSTED_READING = 2  # number of the first reading after a command that surely shows its effect
# readings may exceed the current that a winding endures for less than this: supplies settle, and windings heat slowly
MOST_ABOVE_ENDURED_S = 10.0
Levels = tuple[str, float, float]  # role, V, A


class Ending(NamedTuple):
    """What ends or limits the current of a supply that is left on."""

    trips_at: float | None = None  # V, of the supply's own protection
    endured_current: float = math.inf  # A, that the winding endures for ever


NEVER = Ending()


@dataclass
class _FedRole:
    """One supply at the leads of one role, with the state of its supervision."""

    device: PowerSupply
    role: str
    stream: str
    channel_index: int  # of the current in a row of that stream
    commanded_current: float = 0.0  # A, that may flow after the latest commands
    heating_current: float = 0.0  # A, that counts as heat
    last_reading: float = 0.0  # A, of the latest reading
    readings: int = 0  # since the latest command
    endured_current: float = math.inf  # A, that its winding endures if nobody switches it off
    above_since: float = math.nan  # s, since when readings are above `endured_current`


class Supplies:
    """The supplies of a bench that feed the leads of an actuator, at most one for each role."""

    def __init__(
        self,
        devices: Iterable[Driver],
        limits: Limits,
        guard: ThermalGuard,
        leads: Leads,
        refuse_latched: Callable[[], None],
        trip: Callable[[str], NoReturn],
    ) -> None:
        """Take the supplies at leads among all devices of a bench.

        `refuse_latched` raises after a trip, and `trip` trips: both are the supervisor's.

        Raises
        ------
        InputError : two supplies at the leads of one role.
        """
        self._limits, self._guard, self._leads = limits, guard, leads
        self._refuse_latched, self._trip = refuse_latched, trip
        self.endings: Mapping[Levels, Ending] = {}
        self._fed = _at_leads(devices, guard.roles)
        self._by_stream = {fed.stream: fed for fed in self._fed.values()}

    @property
    def streams(self) -> frozenset[str]:
        """Names of the streams that measure the current of a supply."""
        return frozenset(self._by_stream)

    @property
    def most(self) -> Mapping[str, tuple[float, float]]:
        """Highest voltage [V] and current [A] of each role's supply."""
        return {role: fed.device.most for role, fed in self._fed.items()}

    def put_out(self, role: str, voltage: float, current: float) -> None:
        """Set the levels of the supply of a role [V, A] and switch it on.

        Raises
        ------
        SafetyTrip : a trip is latched, the current is outside the limits, or more than the winding may carry now;
            nothing is passed on.
        InputError : the role has no supply, or the levels are outside what the supply can put out.
        """
        self._refuse_latched()
        fed = self._fed_role(role)
        low, high = self._limits.of(QUANTITY) or (math.nan, math.nan)
        if not low <= current <= high:
            self._trip(f"{role} {QUANTITY} of {current:g} A is outside the limits ({low:.4g}, {high:.4g})")
        allowed = self._guard.allowed[role] / LEADS**0.5
        if current > allowed:
            self._trip(
                f"{role} winding: {allowed:.1f} A may flow through two leads now, {current:g} A were asked for: its"
                f" hottest phase may be at {self._guard.hottest[role]:.1f} degC"
            )
        ending = self.endings.get((role, voltage, current), NEVER)
        if isinstance(fed.device, ProtectedSupply):
            fed.device.protect(fed.device.most[0] if ending.trips_at is None else ending.trips_at)
        fed.endured_current, fed.above_since = ending.endured_current, math.nan
        fed.device.supply(voltage, current)
        self._command(fed, current)
        fed.device.switch_on()

    def switch_off(self, role: str) -> None:
        """Switch off the supply of a role; its current counts as heat until readings show less.

        Raises
        ------
        InputError : the role has no supply.
        DeviceError : the line to the supply is gone.
        """
        fed = self._fed_role(role)
        self._command(fed, 0.0)
        fed.device.switch_off()

    def supplying(self, role: str) -> bool:
        """Return whether the supply of a role reports its output as on, or has not yet reported it as off.

        Raises
        ------
        InputError : the role has no supply.
        """
        return self._fed_role(role).device.supplying

    def cut(self) -> None:
        """Switch off every supply that is on or may be on; never raise."""
        for fed in self._fed.values():
            with suppress(Exception):  # a driver that breaks here is switched off by `make_safe`, and hides no trip
                if fed.heating_current or fed.device.supplying:
                    self._command(fed, 0.0)
                    fed.device.switch_off()

    def look(self, row: Row) -> None:
        """Take a row of any stream; judge it if it measures the current of a supply.

        Raises
        ------
        SafetyTrip : for `MOST_ABOVE_ENDURED_S` the current has been above what its winding endures.
        """
        fed = self._by_stream.get(row.stream)
        if fed is None:
            return
        reading = abs(row.values[fed.channel_index])
        fed.readings += 1
        # between two readings the larger of the two counts
        heating_current = max(reading, fed.last_reading) if reading == reading else fed.device.most[1]
        fed.last_reading = heating_current if reading != reading else reading
        self._count_current(
            fed,
            heating_current if fed.readings >= FIRST_TRUSTED_READING else max(heating_current, fed.commanded_current),
        )
        if reading <= fed.endured_current:
            fed.above_since = math.nan
        # a reading that is NaN neither begins nor ends an excess
        elif reading > fed.endured_current and not row.time - fed.above_since < MOST_ABOVE_ENDURED_S:
            self._judge_excess(fed, reading, row.time)

    def _judge_excess(self, fed: _FedRole, reading: float, now: float) -> None:
        """Note when a reading [A] above the endured current came first, or trip if it came before.

        A supply that is left on may give more than its setting.
        """
        if math.isnan(fed.above_since):
            fed.above_since = now
            return
        self._trip(
            f"{fed.role} supply gives {reading:.4g} A, and its winding outlives {fed.endured_current:.4g} A at the most"
            " if nobody switches it off: lower current_A, or attend the run"
        )

    def _command(self, fed: _FedRole, current: float) -> None:
        """Count the higher of a commanded current [A] and the heating current until readings show the effect."""
        fed.commanded_current, fed.readings = max(current, fed.heating_current), 0
        self._count_current(fed, fed.commanded_current)

    def _count_current(self, fed: _FedRole, heating_current: float) -> None:
        """Have the thermal guard count a current [A] through the leads of a role from now on."""
        fed.heating_current = heating_current
        self._leads.tell(fed.role, fed.stream, heating_current)

    def _fed_role(self, role: str) -> _FedRole:
        """Return the supply of a role.

        Raises
        ------
        InputError : the role has no supply.
        """
        if role not in self._fed:
            raise InputError(f"no supply feeds the leads of {role}")
        return self._fed[role]


def at_leads(devices: Iterable[Driver], roles: Iterable[str]) -> dict[str, PowerSupply]:
    """Return the supply at the leads of a role, by role; roles without a supply are left out.

    Raises
    ------
    InputError : two supplies at the leads of one role.
    """
    return {role: fed.device for role, fed in _at_leads(devices, roles).items()}


def _at_leads(devices: Iterable[Driver], roles: Iterable[str]) -> dict[str, _FedRole]:
    """Return the supply at the leads of each role that has one, with the state of its supervision.

    Raises
    ------
    InputError : two supplies at the leads of one role.
    """
    by_role: dict[str, _FedRole] = {}
    roles = tuple(roles)
    for device in devices:
        for stream in device.streams if isinstance(device, PowerSupply) else ():
            for index, channel in enumerate(stream.channels):
                if channel.quantity == QUANTITY and channel.role in roles:
                    if channel.role in by_role:
                        raise InputError(f"two supplies at the leads of {channel.role}; one was expected")
                    assert isinstance(device, PowerSupply)
                    by_role[channel.role] = _FedRole(device, channel.role, stream.name, index)
    return by_role
