"""An actuator of three phases and a housing, which shares no equation with the guard: what its bound is held against.

Heat of each cycle stands at the angles that the rotor passes in it, for every commutation angle side by side.
"""

import numpy as np
import numpy.typing as npt

from leactl.runner.challenge.courses import ChallengeCourse
from leactl.safety.thermal.box import Box

Array = npt.NDArray[np.float64]
OFFSETS = np.linspace(0.0, np.pi, 12, endpoint=False)  # rad electrical, that commutation may be off by
PLACES = 2.0 * np.pi / 3.0 * np.arange(3)
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

    def __init__(self, box: Box, places: Array, ambient: float, start: float) -> None:
        """Take each parameter at its place between the ends of its range, 0 to 1."""
        values = [
            (one := getattr(box, name)).low + place * (one.high - one.low)
            for name, place in zip(PARAMETERS, places, strict=True)
        ]
        self._resistance, self._rise, to_air, to_housing, outwards, winding, housing = values
        self._to_air, self._to_housing, self._outwards = 3.0 * to_air, 3.0 * to_housing, outwards
        self._phase, self._housing = winding / 3.0, housing
        self._reference, self._air = box.reference_temperature, ambient + box.ambient_rise
        self._gain = box.current_gain**2
        self.state = np.full((len(OFFSETS), 4), start)

    @property
    def hottest(self) -> float:
        """Of any phase at any offset [degC]."""
        return float(self.state[:, :3].max())

    @property
    def nodes(self) -> Array:
        """Hottest phase, mean of the phases and housing, the highest of all offsets [degC]."""
        phases = self.state[:, :3]
        return np.array([phases.max(), phases.mean(axis=1).max(), self.state[:, 3].max()])

    @property
    def worst(self) -> npt.NDArray[np.complex128]:
        """Where a rotor stands that heats the hottest phase the most, shape (1,)."""
        offset, place = np.unravel_index(int(self.state[:, :3].argmax()), (len(OFFSETS), 3))
        return np.asarray(np.exp(2j * (OFFSETS[offset : offset + 1] + PLACES[place])), np.complex128)

    def heat(self, squares: Array, turned: npt.NDArray[np.complex128], seconds: float) -> None:
        """Go on through some cycles, `squares` being their currents' [A^2] and `turned` the means of e^(2j theta)."""
        square = float(squares.sum()) / len(squares) * self._gain
        stood = complex(squares @ turned) / len(squares) * self._gain
        shares = (square + np.real(stood * np.exp(-2j * (OFFSETS[:, None] + PLACES)))) / 3.0
        phases, housing = self.state[:, :3], self.state[:, 3:]
        warm = shares * self._resistance * (1.0 + self._rise * (phases - self._reference))
        across = (phases - housing) / self._to_housing
        phases = phases + (warm - across - (phases - self._air) / self._to_air) * seconds / self._phase
        out = (housing - self._air) / self._outwards
        housing = housing + (across.sum(axis=1, keepdims=True) - out) * seconds / self._housing
        self.state = np.concatenate([phases, housing], axis=1)


def turned(course: ChallengeCourse, pole_pairs: int) -> npt.NDArray[np.complex128]:
    """Mean of e^(2j theta) over the angles that are passed in each cycle."""
    return np.asarray(np.exp(2j * pole_pairs * course.passed).mean(axis=1), np.complex128)
