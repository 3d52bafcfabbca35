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
    """One actuator within its tolerances, once for each commutation offset.

    `state` holds the temperatures of three phases and the housing [degC], shape (offsets, 4).
    """

    def __init__(self, box: Box, shares: Array, ambient: float, start: float) -> None:
        """Place each parameter in its range by a share from 0, its low end, to 1; ambient and start in degC.

        shares : in the order of `PARAMETERS`.
        """
        values = [
            (bounds := getattr(box, name)).low + share * (bounds.high - bounds.low)
            for name, share in zip(PARAMETERS, shares, strict=True)
        ]
        (
            self._resistance,
            self._coefficient,
            to_air,
            to_housing,
            housing_to_air,
            winding_capacitance,
            housing_capacitance,
        ) = values
        self._to_air, self._to_housing, self._housing_to_air = 3.0 * to_air, 3.0 * to_housing, housing_to_air
        self._phase_capacitance, self._housing_capacitance = winding_capacitance / 3.0, housing_capacitance
        self._reference_temperature, self._air_temperature = box.reference_temperature, ambient + box.ambient_rise
        self._gain = box.current_gain**2
        self.state = np.full((len(OFFSETS), 4), start)

    @property
    def hottest(self) -> float:
        """Temperature of the hottest phase at any offset [degC]."""
        return float(self.state[:, :3].max())

    @property
    def nodes(self) -> Array:
        """Hottest phase, mean of the phases and housing [degC], each the highest of all offsets, shape (3,)."""
        phases = self.state[:, :3]
        return np.array([phases.max(), phases.mean(axis=1).max(), self.state[:, 3].max()])

    @property
    def worst(self) -> npt.NDArray[np.complex128]:
        """e^(2j theta) of the rotor angle that heats the hottest phase the most, shape (1,)."""
        offset, phase = np.unravel_index(int(self.state[:, :3].argmax()), (len(OFFSETS), 3))
        return np.asarray(np.exp(2j * (OFFSETS[offset : offset + 1] + PHASE_ANGLES[phase])), np.complex128)

    def heat(self, squares: Array, phasors: npt.NDArray[np.complex128], seconds: float) -> None:
        """Advance by some cycles, which last `seconds` in all.

        squares, phasors : square current [A^2] and mean of e^(2j theta) of each cycle, shape (cycles,).
        """
        square = float(squares.sum()) / len(squares) * self._gain
        phasor = complex(squares @ phasors) / len(squares) * self._gain
        shares = (square + np.real(phasor * np.exp(-2j * (OFFSETS[:, None] + PHASE_ANGLES)))) / 3.0
        phases, housing = self.state[:, :3], self.state[:, 3:]
        phase_heat = shares * self._resistance * (1.0 + self._coefficient * (phases - self._reference_temperature))
        flow_to_housing = (phases - housing) / self._to_housing
        phases = (
            phases
            + (phase_heat - flow_to_housing - (phases - self._air_temperature) / self._to_air)
            * seconds
            / self._phase_capacitance
        )
        flow_to_air = (housing - self._air_temperature) / self._housing_to_air
        housing = (
            housing + (flow_to_housing.sum(axis=1, keepdims=True) - flow_to_air) * seconds / self._housing_capacitance
        )
        self.state = np.concatenate([phases, housing], axis=1)


def mean_phasors(course: ChallengeCourse, pole_pairs: int) -> npt.NDArray[np.complex128]:
    """Return the mean of e^(2j theta) over the angles passed in each cycle, shape (cycles,)."""
    return np.asarray(np.exp(2j * pole_pairs * course.passed_angles).mean(axis=1), np.complex128)
