"""Define the keys of setpoints in each mode; a key contains the unit, so that a wrong unit is an unknown key.

mode                     setpoint         levels, amplitude, ...     rate
current, torque_profile  current_A        levels_A                   rate_A_s
velocity                 velocity_rad_s   levels_rad_s               rate_rad_s2
angle                    angle_rad        levels_rad                 rate_rad_s
"""

from typing import NamedTuple

from leactl.driver.contract import Mode


class Spelling(NamedTuple):
    """Keys of one kind of setpoint."""

    setpoint: str
    suffix: str
    rate: str

    def key(self, stem: str) -> str:
        """Return the key of a stem: "setpoint", "to_setpoint", "from_setpoint", "rate", "levels", "offset" etc."""
        if stem.endswith("setpoint"):
            return stem.replace("setpoint", self.setpoint)
        return self.rate if stem == "rate" else f"{stem}_{self.suffix}"


CURRENT = Spelling("current_A", "A", "rate_A_s")
VELOCITY = Spelling("velocity_rad_s", "rad_s", "rate_rad_s2")
ANGLE = Spelling("angle_rad", "rad", "rate_rad_s")

SPELLINGS = {
    Mode.CURRENT: CURRENT,
    Mode.TORQUE_PROFILE: CURRENT,
    Mode.VELOCITY: VELOCITY,
    Mode.ANGLE: ANGLE,
}
