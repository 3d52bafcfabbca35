"""What a run commands now, by role: modes, setpoints, and supplies that are to be on."""

from leactl.driver.contract import Mode


class Commanded:
    """Keeps what was commanded last, and tells whether the bench rests by it."""

    def __init__(self) -> None:
        self._modes: dict[str, Mode] = {}
        self._moving: set[str] = set()  # roles whose setpoint does not let them rest
        self._supplying: set[str] = set()

    @property
    def rests(self) -> bool:
        """Whether nothing is commanded but angles that are held: a pause leaves out nothing of the plan."""
        return not self._moving and not self._supplying

    def engage(self, role: str, mode: Mode) -> None:
        """Take the mode of a role, which begins with a setpoint of zero or the angle where the shaft is."""
        self._modes[role] = mode
        self._moving.discard(role)

    def move(self, role: str, setpoint: float) -> None:
        """Take a role's setpoint, in the unit of its mode; one that was never engaged counts as moving."""
        if setpoint == 0.0 or self._modes.get(role) is Mode.ANGLE:
            self._moving.discard(role)
        else:
            self._moving.add(role)

    def supply(self, role: str, on: bool) -> None:
        """Take whether the supply at a role's leads is to be on."""
        if on:
            self._supplying.add(role)
        else:
            self._supplying.discard(role)
