"""Plant for the challenge of a thermal bound: three phases and a housing, without any equation of the guard.

The heat of each cycle comes at the angles that the rotor passes in it. All commutation angles are simulated side by
side.
"""

import numpy as np
import numpy.typing as npt

from leactl.runner.challenge.courses import ChallengeCourse
from leactl.safety.thermal.box import Box

Array = npt.NDArray[np.float64]
OFFSETS = np.linspace(0.0, np.pi, 12, endpoint=False)  # rad electrical, errors of commutation
PHASE_ANGLES = 2.0 * np.pi / 3.0 * np.arange(3)  # rad electrical
NETWORK = (
    "winding_ambient_resistance",
    "winding_housing_resistance",
    "housing_ambient_resistance",
    "winding_capacitance",
    "housing_capacitance",
)
PARAMETERS = ("phase_resistance", "resistance_coefficient", *NETWORK)


class Phases:
    """One actuator inside its tolerances, once for each offset; `state` has three phases and the housing [degC]."""

    def __init__(self, box: Box, shares: Array, ambient: float, start: float) -> None:
        """Take each parameter at a share, 0 to 1, of its range, from its low end; ambient and start in degC."""
        values = [
            (bounds := getattr(box, name)).low + share * (bounds.high - bounds.low)
            for name, share in zip(PARAMETERS, shares, strict=True)
        ]
        self._resistance, self._rise, to_air, to_housing, outwards, winding, housing = values
        self._to_air, self._to_housing, self._outwards = 3.0 * to_air, 3.0 * to_housing, outwards
        self._phase, self._housing = winding / 3.0, housing
        self._reference, self._air = box.reference_temperature, ambient + box.ambient_rise
        self._gain = box.current_gain**2
        self.state = np.full((len(OFFSETS), 4), start)

    @property
    def hottest(self) -> float:
        """Temperature of the hottest phase at any offset [degC]."""
        return float(self.state[:, :3].max())

    @property
    def nodes(self) -> Array:
        """Hottest phase, mean of the phases and housing, the highest of all offsets [degC]."""
        phases = self.state[:, :3]
        return np.array([phases.max(), phases.mean(axis=1).max(), self.state[:, 3].max()])

    @property
    def worst(self) -> npt.NDArray[np.complex128]:
        """e^(2j theta) of the rotor angle that heats the hottest phase the most, shape (1,)."""
        offset, phase = np.unravel_index(int(self.state[:, :3].argmax()), (len(OFFSETS), 3))
        return np.asarray(np.exp(2j * (OFFSETS[offset : offset + 1] + PHASE_ANGLES[phase])), np.complex128)

    def heat(self, squares: Array, phasors: npt.NDArray[np.complex128], seconds: float) -> None:
        """Advance by `seconds` of some cycles, with the squares of their currents [A^2] and means of e^(2j theta)."""
        square = float(squares.sum()) / len(squares) * self._gain
        phasor = complex(squares @ phasors) / len(squares) * self._gain
        shares = (square + np.real(phasor * np.exp(-2j * (OFFSETS[:, None] + PHASE_ANGLES)))) / 3.0
        phases, housing = self.state[:, :3], self.state[:, 3:]
        warm = shares * self._resistance * (1.0 + self._rise * (phases - self._reference))
        across = (phases - housing) / self._to_housing
        phases = phases + (warm - across - (phases - self._air) / self._to_air) * seconds / self._phase
        to_air = (housing - self._air) / self._outwards
        housing = housing + (across.sum(axis=1, keepdims=True) - to_air) * seconds / self._housing
        self.state = np.concatenate([phases, housing], axis=1)


def turned(course: ChallengeCourse, pole_pairs: int) -> npt.NDArray[np.complex128]:
    """Return the mean of e^(2j theta) over the angles passed in each cycle, shape (cycles,)."""
    return np.asarray(np.exp(2j * pole_pairs * course.passed).mean(axis=1), np.complex128)
