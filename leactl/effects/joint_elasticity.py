"""Joint elasticity: a share of the inertia follows the motor through a spring and a damper, and nothing else moves it.

The load's acceleration is the motor's behind (2 z w s + w^2) / (s^2 + 2 z w s + w^2), w being the pulsation at which it
swings while the motor stands, z its damping ratio (Spong, 1987, of joints with elastic transmissions).
"""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from scipy.signal import cont2discrete, lfilter

from leactl.effects.contract import Array, Effect, Form, Signals, Terms
from leactl.effects.plant import ElasticLoad, Plant
from leactl.model.nominal import Model

DAMPED = 0.05  # of critical, as gears and belts have it
CREEPS = 1.0  # of critical: such a load follows without a swing, which a lag of the motor's own may be
HIGHEST = 0.9  # of the inertia, that a load has in a simulation: the motor's rotor is the rest
DIES_AWAY = 4.0  # time constants, after which two per cent of a swing are left
GONE = 36.0  # time constants, after which less is left than a rounding error
FEWEST = 4  # samples for each number of a fit


class JointElasticity(Effect):
    """A load on an elastic transmission, without an encoder behind it."""

    name = "joint_elasticity"
    relative_to = ("rotor_inertia",)
    one_sided = True
    least = 0.1  # of the inertia: a load is no loose part, and less is what a loop or a stamp is late by
    forms = tuple((float(rate), damping) for rate in np.geomspace(0.003, 0.045, 14) for damping in (0.02, 0.07, 0.25))
    form_scales = ("sampling rate", "1")
    refined = 2
    narrow = True

    def applies(self, model: Model) -> bool:
        """A model with a shaft says how elastic that is: what it lacks there is `shaft_compliance`."""
        return model.bench.shaft_stiffness is None and model.load.type == "none"

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Torque that the load takes from the rigid joint's balance, for all of the inertia."""
        inertia = signals.model.rotor_inertia
        if signals.mechanical != "free" or signals.acceleration is None or inertia is None:
            return {}
        if form[1] >= CREEPS:
            return {}
        behind = swung(signals.acceleration, form[0], form[1], signals.interval)
        behind += swing_at_start(signals, behind, form)
        return {"drag": {"share": inertia * (behind - signals.acceleration)}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """The load's share of the inertia, the frequency of its swing, and how that is damped."""
        return {"share": coefficients["share"], "frequency": form[0], "damping_ratio": form[1]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """A second inertia behind a spring."""
        damping = parameters.get("damping_ratio", DAMPED)
        share = min(parameters["share"], HIGHEST)
        plant.elastic_load = ElasticLoad(share, parameters["frequency"], damping)


def swing_at_start(signals: Signals, behind: Array, form: Form) -> Array:
    """What the load's acceleration has beyond `behind` since a run's start, dying away as the load's swing does.

    A run may begin while the load swings, or with a leap within its first sample: no angle before tells of it. Fitted
    over the time in which it dies away, the run's current being what its torques add up to; nothing where the current
    is not logged, and where the fit has no load worth the name.
    """
    rate = 2.0 * np.pi * form[0]
    fading, ringing = form[1] * rate, rate * np.sqrt(1.0 - form[1] ** 2)
    time = np.arange(len(behind), dtype=np.float64) * signals.interval
    within = slice(0, int(np.searchsorted(time, DIES_AWAY / fading)))
    if signals.current is None or signals.acceleration is None or signals.sliding is None or signals.velocity is None:
        return np.zeros_like(behind)
    swings = fading_waves(fading, ringing, time)
    columns = [behind, *swings, signals.acceleration, signals.velocity, signals.sliding]
    table = np.stack([column[within] for column in columns], axis=1)
    if len(table) < FEWEST * len(columns):
        return np.zeros_like(behind)
    load, *begins, rotor, _, _ = np.linalg.lstsq(table, signals.current[within], rcond=None)[0]
    if load <= JointElasticity.least * abs(load + rotor):
        return np.zeros_like(behind)
    return np.asarray((begins[0] * swings[0] + begins[1] * swings[1]) / load, np.float64)


def fading_waves(fading: float, ringing: float, time: Array) -> list[Array]:
    """Cosine and sine of a swing that dies away; zero where a rounding error is larger than what is left of it."""
    lasts = int(np.searchsorted(time, GONE / fading))
    swings = np.zeros((2, len(time)))
    left = np.exp(-fading * time[:lasts])
    for swing, wave in zip(swings, (np.cos, np.sin), strict=True):
        swing[:lasts] = left * wave(ringing * time[:lasts])
    return list(swings)


def swung(acceleration: Array, frequency: float, damping_ratio: float, interval: float) -> Array:
    """The load's acceleration behind a motor's; at first it moves along."""
    above, below = behind_motor(frequency, damping_ratio, interval)
    first = acceleration[0]
    return np.asarray(first + lfilter(above, below, acceleration - first), np.float64)


@lru_cache(maxsize=1024)  # every run of a machine, and of each sound one in its place, asks for the same
def behind_motor(frequency: float, damping_ratio: float, interval: float) -> tuple[Array, Array]:
    """Numerator and denominator of the filter over samples that leads from a motor's acceleration to its load's."""
    rate = 2.0 * np.pi * frequency
    over = [2.0 * damping_ratio * rate, rate**2]
    above, below, _ = cont2discrete((over, [1.0, *over]), interval, "foh")
    return above.ravel(), below.ravel()
