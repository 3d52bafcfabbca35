"""Trials of the paper's three parameters, drawn from its printed means with a third of its +- as standard deviation."""

from dataclasses import dataclass

import numpy as np

CONDITIONS = ("unloaded", "design", "loaded")
PAIRS = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True)
class Printed:
    """One parameter of the paper over its conditions."""

    name: str
    experiment: str
    units: str
    means: tuple[float, float, float]
    plus_minus: tuple[float, float, float]
    trials: int
    differ: tuple[bool, bool, bool]  # the paper's verdicts, pair by pair

    def draw(self, rng: np.random.Generator, effect: bool) -> np.ndarray:
        """Values, shape (3, trials); without an effect all conditions have the mean of the means."""
        means = np.array(self.means if effect else 3 * [float(np.mean(self.means))])
        return rng.normal(means[:, None], np.array(self.plus_minus)[:, None] / 3.0, (3, self.trials))


PARAMETERS = (
    Printed(
        "viscous_damping",
        "friction",
        "N*m*s/rad",
        (18.2e-3, 23.8e-3, 25.5e-3),
        (9.7e-3, 8.0e-3, 11.1e-3),
        10,
        (True, True, False),
    ),
    Printed(
        "coulomb_friction",
        "friction",
        "N*m",
        (241.9e-3, 208.0e-3, 303.7e-3),
        (43.4e-3, 38.4e-3, 73.5e-3),
        10,
        (True, True, True),
    ),
    Printed(
        "torque_constant",
        "torque-constant",
        "N*m/A",
        (0.49, 0.49, 0.49),
        (0.06, 0.06, 0.06),
        6,
        (False, False, False),
    ),
)
