"""Base class of drives that enter operation over several cycles: `engage` sets the mode, later cycles complete it."""

import math
from abc import abstractmethod
from collections.abc import Container
from typing import ClassVar

from leactl.driver.clock import Clock
from leactl.driver.contract import Driver, Mode
from leactl.errors import InputError


class EngagingDrive(Driver):
    """A drive whose driver has one method that turns to a mode, `_follow`."""

    modes: ClassVar[Container[Mode]]  # that it can follow
    connection: ClassVar[str] = ""  # words behind a refusal, such as "over this line"
    enable_time_s: ClassVar[float]  # within which the drive has to enter operation

    name: str
    _clock: Clock
    _safe: bool  # whether it has confirmed its safe state, and nothing was demanded of it since
    _enable_by: float = math.inf  # s on the clock, by which it has to be in operation

    @abstractmethod
    def _follow(self, mode: Mode) -> None:
        """Turn to a mode with zero demand."""

    def engage(self, mode: Mode) -> None:
        """Begin to enter operation in this mode with zero demand; in angle mode the drive holds the present angle.

        Raises
        ------
        InputError : the drive has no such mode.
        """
        if mode not in self.modes:
            words = f"mode '{mode}' is not one a drive can follow"
            raise InputError(f"{self.name}: {words}{f' {self.connection}' if self.connection else ''}")
        self._follow(mode)
        self._safe = False
        self._enable_by = self._clock.now() + self.enable_time_s

    def release(self) -> None:
        """Begin to leave operation; no current flows once the drive has left it."""
        self._follow(Mode.OFF)
