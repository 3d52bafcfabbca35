"""Joint elasticity: a share of the inertia follows the motor through a spring and a damper, and nothing else moves it.

The load's acceleration is the motor's behind (2 z w s + w^2) / (s^2 + 2 z w s + w^2), w being the angular frequency at
which it swings while the motor stands, z its damping ratio (Spong, 1987, of joints with elastic transmissions). A
pendulum or an arm hangs on the spring with the load, which its weight twists as well; all of it is taken to hang there.
"""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from scipy.signal import cont2discrete, lfilter

from leactl.effects.contract import Array, Effect, Form, Signals, Terms
from leactl.effects.plant import ElasticLoad, Plant
from leactl.model.nominal import Model

DEFAULT_DAMPING_RATIO = 0.05  # typical for gears and belts
LEAST_CREEP_DAMPING = 1.0  # damping ratio from which a load follows without a swing, like a lag of the motor itself
MOST_LOAD_SHARE = 0.9  # largest share of the inertia in a simulated load: the motor's rotor has the remainder
DECAYED_TIME_CONSTANTS = 4.0  # time constants after which two per cent of a swing remain
VANISHED_TIME_CONSTANTS = 36.0  # time constants after which a swing is below rounding errors
FEWEST_SAMPLES_PER_COEFFICIENT = 4  # samples of a fit for each of its coefficients


class JointElasticity(Effect):
    """A load on an elastic transmission, without an encoder behind it."""

    name = "joint_elasticity"
    relative_to = ("rotor_inertia",)
    one_sided = True
    least = 0.1  # share of the inertia; a smaller share is a loose part, or what a late loop or stamp imitates
    forms = tuple((float(rate), damping) for rate in np.geomspace(0.003, 0.045, 14) for damping in (0.02, 0.07, 0.25))
    form_scales = ("sampling rate", "1")
    refined = 2
    narrow = True

    def applies(self, model: Model) -> bool:
        """Return whether the model has no shaft, whose elasticity is `shaft_compliance`."""
        return model.bench.shaft_stiffness is None

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the change of the rigid joint's torque balance if the whole inertia were elastically coupled."""
        inertia = signals.model.rotor_inertia
        if signals.mechanical != "free" or signals.acceleration is None or inertia is None:
            return {}
        if form[1] >= LEAST_CREEP_DAMPING:
            return {}
        load_motion = follow_spring(signals.acceleration, form[0], form[1], signals.interval)
        load_motion += swing_at_start(signals, load_motion, form)
        column = (inertia + signals.load_inertia) * (load_motion - signals.acceleration)
        if signals.weight is not None:
            column += (inertia + signals.load_inertia) / signals.load_inertia * weight_on_spring(signals, form)
        return {"drag": {"share": column}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the load's share of the inertia, and frequency and damping ratio of its swing."""
        return {"share": coefficients["share"], "frequency": form[0], "damping_ratio": form[1]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a second inertia behind a spring."""
        damping = parameters.get("damping_ratio", DEFAULT_DAMPING_RATIO)
        share = min(parameters["share"], MOST_LOAD_SHARE)
        plant.elastic_load = ElasticLoad(share, parameters["frequency"], damping)


def weight_on_spring(signals: Signals, form: Form) -> Array:
    """Return the change of a weight's torque on the motor by the spring: it lags, and hangs at another angle."""
    assert signals.weight is not None and signals.weight_slope is not None and signals.angle is not None
    followed_weight, followed_angle = (
        follow_spring(values, form[0], form[1], signals.interval) for values in (signals.weight, signals.angle)
    )
    sag = followed_weight / (signals.load_inertia * (2.0 * np.pi * form[0]) ** 2)
    return np.asarray(
        followed_weight - signals.weight + signals.weight_slope * (followed_angle - signals.angle - sag), np.float64
    )


def swing_at_start(signals: Signals, load_motion: Array, form: Form) -> Array:
    """Return the decaying part of the load's acceleration, beyond `load_motion`, of a swing at a run's start.

    A run may begin while the load swings, or with a leap within its first sample, of which no earlier angle is logged.
    The swing is fitted to the torque balance of the run's current over its decay time. It is zero if the current is not
    logged, the run is too short, or the fitted load is too small.
    """
    angular_frequency = 2.0 * np.pi * form[0]
    decay_rate, swing_rate = form[1] * angular_frequency, angular_frequency * np.sqrt(1.0 - form[1] ** 2)
    time = np.arange(len(load_motion), dtype=np.float64) * signals.interval
    fitted_samples = slice(0, int(np.searchsorted(time, DECAYED_TIME_CONSTANTS / decay_rate)))
    if signals.current is None or signals.acceleration is None or signals.sliding is None or signals.velocity is None:
        return np.zeros_like(load_motion)
    swings = fading_waves(decay_rate, swing_rate, time)
    columns = [load_motion, *swings, signals.acceleration, signals.velocity, signals.sliding]
    columns += [] if signals.weight is None else [signals.weight]
    design = np.stack([column[fitted_samples] for column in columns], axis=1)
    if len(design) < FEWEST_SAMPLES_PER_COEFFICIENT * len(columns):
        return np.zeros_like(load_motion)
    load_coefficient, cosine, sine, rotor_coefficient, *_ = np.linalg.lstsq(
        design, signals.current[fitted_samples], rcond=None
    )[0]
    if load_coefficient <= JointElasticity.least * abs(load_coefficient + rotor_coefficient):
        return np.zeros_like(load_motion)
    return np.asarray((cosine * swings[0] + sine * swings[1]) / load_coefficient, np.float64)


def fading_waves(decay_rate: float, swing_rate: float, time: Array) -> list[Array]:
    """Return cosine and sine of a decaying swing, zero where they are below rounding errors."""
    sample_count = int(np.searchsorted(time, VANISHED_TIME_CONSTANTS / decay_rate))
    swings = np.zeros((2, len(time)))
    envelope = np.exp(-decay_rate * time[:sample_count])
    for swing, wave in zip(swings, (np.cos, np.sin), strict=True):
        swing[:sample_count] = envelope * wave(swing_rate * time[:sample_count])
    return list(swings)


def follow_spring(motion: Array, frequency: float, damping_ratio: float, interval: float) -> Array:
    """Return the load's acceleration, speed or angle for that of the motor; both begin equal and at rest."""
    numerator, denominator = load_filter(frequency, damping_ratio, interval)
    initial = motion[0]
    return np.asarray(initial + lfilter(numerator, denominator, motion - initial), np.float64)


@lru_cache(maxsize=1024)  # all runs of a machine, and their simulated sound runs, need the same filters
def load_filter(frequency: float, damping_ratio: float, interval: float) -> tuple[Array, Array]:
    """Return numerator and denominator of the discrete filter from a motor's acceleration to its load's."""
    angular_frequency = 2.0 * np.pi * frequency
    stiffness_terms = [2.0 * damping_ratio * angular_frequency, angular_frequency**2]
    numerator, denominator, _ = cont2discrete((stiffness_terms, [1.0, *stiffness_terms]), interval, "foh")
    return numerator.ravel(), denominator.ravel()
