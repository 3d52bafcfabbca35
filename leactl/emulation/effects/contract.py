"""What an effect may do to the plant; each method left alone means: nothing."""

from dataclasses import dataclass
from typing import ClassVar

from leactl.emulation.parameters import Checked
from leactl.errors import InputError


@dataclass(frozen=True)
class Effect(Checked):
    """One thing that the nominal plant lacks, on one actuator."""

    adds_torque: ClassVar[bool] = False
    role: str = "test"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.role not in ("test", "load"):
            raise InputError(f"role: found {self.role!r}, expected test or load")

    def torque(self, angle: float, velocity: float) -> float:
        """Torque on the rotor [N*m], asked for at most every 0.25 ms where `adds_torque` is set."""
        return 0.0

    def sense_current(self, current: float) -> float:
        """What the drive's current sensor makes of a current [A]; affine, since the current loop closes over it."""
        return current

    def sense_torque(self, torque: float) -> float:
        """What the shaft's torque sensor makes of a torque [N*m]; the role does not matter."""
        return torque
