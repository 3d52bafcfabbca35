"""Base class of drives that enter operation over several cycles: `engage` sets the mode, later cycles complete it."""

import math
from abc import abstractmethod
from collections.abc import Container
from typing import ClassVar

from leactl.driver.clock import Clock
from leactl.driver.contract import Driver, Mode
from leactl.errors import InputError


class EngagingDrive(Driver):
    """A drive whose driver changes its mode by the method `_follow`."""

    modes: ClassVar[Container[Mode]]  # that the drive can follow
    connection: ClassVar[str] = ""  # added to the message on an unknown mode, such as "over this line"
    enable_time_s: ClassVar[float]  # time for the drive to enter operation

    name: str
    _clock: Clock
    _safe: bool  # whether the drive has confirmed its safe state, and has received no demand since
    _enable_by: float = math.inf  # time on the clock [s] by which the drive has to be in operation

    @abstractmethod
    def _follow(self, mode: Mode) -> None:
        """Change to a mode with zero demand."""

    def engage(self, mode: Mode) -> None:
        """Begin to enter operation in this mode with zero demand; in angle mode the drive holds the present angle.

        Raises
        ------
        InputError : the drive has no such mode.
        """
        if mode not in self.modes:
            reason = f"mode '{mode}' is not one a drive can follow"
            raise InputError(f"{self.name}: {reason}{f' {self.connection}' if self.connection else ''}")
        self._follow(mode)
        self._safe = False
        self._enable_by = self._clock.now() + self.enable_time_s

    def release(self) -> None:
        """Begin to leave operation; no current flows once the drive has left operation."""
        self._follow(Mode.OFF)
