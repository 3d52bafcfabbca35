"""The modes, setpoints and supply states that a run commands now, by role."""

from leactl.driver.contract import Mode


class Commanded:
    """Stores the newest command to each role, and tells whether these commands keep the bench at rest."""

    def __init__(self) -> None:
        self._modes: dict[str, Mode] = {}
        self._moving: set[str] = set()  # roles with a setpoint other than zero or an angle
        self._supplying: set[str] = set()  # roles whose supply is to be on

    @property
    def rests(self) -> bool:
        """Whether every setpoint is zero or a held angle and no supply is to be on, so that a pause skips nothing."""
        return not self._moving and not self._supplying

    def engage(self, role: str, mode: Mode) -> None:
        """Store the mode of a role; its first setpoint is zero, or the present angle of the shaft."""
        self._modes[role] = mode
        self._moving.discard(role)

    def move(self, role: str, setpoint: float) -> None:
        """Store a role's setpoint, in the unit of its mode; if it is not zero, a role that was never engaged moves."""
        if setpoint == 0.0 or self._modes.get(role) is Mode.ANGLE:
            self._moving.discard(role)
        else:
            self._moving.add(role)

    def supply(self, role: str, on: bool) -> None:
        """Store whether the supply at a role's leads is to be on."""
        if on:
            self._supplying.add(role)
        else:
            self._supplying.discard(role)
