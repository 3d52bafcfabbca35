"""One actuator of the rig as its drive shows it: commands in, noiseless readings out."""

from typing import TYPE_CHECKING

from leactl.emulation.parameters import ActuatorParameters
from leactl.emulation.regime import ANGLE, CURRENT, FILTERED, PER_ACTUATOR, VELOCITY
from leactl.emulation.thermal import ThermalNetwork
from leactl.errors import InputError

if TYPE_CHECKING:
    from leactl.emulation.rig import Rig

MODES = ("off", "current", "velocity", "angle")


class Actuator:
    """A role of the rig; the state itself is the rig's."""

    def __init__(self, rig: "Rig", place: int, parameters: ActuatorParameters, ambient: float) -> None:
        self.parameters = parameters
        self.thermal = ThermalNetwork(parameters.thermal, ambient)
        self.mode = "off"
        self.setpoint = 0.0
        self._rig, self._place, self._first = rig, place, place * PER_ACTUATOR

    def command(self, mode: str, value: float = 0.0) -> None:
        """Hold a q-axis current [A], a velocity [rad/s] or an angle [rad], or let no current flow ("off")."""
        if mode not in MODES:
            raise InputError(f"mode {mode!r} is unknown; known are {', '.join(MODES)}")
        if not abs(value) < 1e9:
            raise InputError(f"setpoint {value} of mode {mode} is not a number a drive can hold")
        if mode != self.mode or value != self.setpoint:
            self._rig.take_command(self._place, mode, float(value))

    @property
    def current(self) -> float:
        """Q-axis current as the drive's sensor has it [A]."""
        return self._rig.sensed_current(self._place)

    @property
    def current_true(self) -> float:
        """Q-axis current that flows [A]."""
        return self._rig.state(self._first + CURRENT)

    @property
    def voltage(self) -> float:
        """Q-axis voltage at the terminals [V]; the back-EMF while off."""
        return self._rig.voltage(self._place)

    @property
    def velocity_true(self) -> float:
        """Velocity of the rotor [rad/s]."""
        return self._rig.state(self._first + VELOCITY)

    @property
    def velocity(self) -> float:
        """Velocity behind the drive's filter [rad/s]."""
        return self._rig.state(self._first + FILTERED)

    @property
    def angle(self) -> float:
        """Angle of the rotor [rad]."""
        return self._rig.state(self._first + ANGLE)

    @property
    def winding_temperature(self) -> float:
        """Temperature of the winding [degC]."""
        return self.thermal.winding

    @property
    def housing_temperature(self) -> float:
        """Temperature of the housing [degC]."""
        return self.thermal.housing

    @property
    def resistance(self) -> float:
        """Phase resistance at the winding's temperature [ohm]."""
        return self.parameters.resistance(self.thermal.winding)
