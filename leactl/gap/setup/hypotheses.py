"""What each fault of a set-up does to the factors of relations, and which fault the factors of some runs speak for.

A fault scales several factors at once, each by a power of its own size, and turns the sign of some. A wrong parameter
of the model scales others. The sizes at which sound machines have these factors are the errors of a small regression,
one for each fault; those that fit as well as the best one cannot be told from it.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.setup.relations import CONSTANT, OF_CONSTANT, TIGHT, USUAL, Factor
from leactl.gap.signals.record import Key

Array = npt.NDArray[np.float64]
SURPRISE = 9.0  # squares of standard deviations, that a fault has to explain
LEFT = 3.0  # standard deviations, that it may leave of any factor
RIVAL = 9.0  # squares of standard deviations, by which another may fit worse and still be named beside it
WRONG_PARAMETER = math.log(2.0)  # deviation of the logarithm of a parameter that is wrong in the model file
AGREE = 0.2  # logarithm, by which the factors of runs with one fault may differ
EXACT = 0.004  # logarithm, to which two channels that say the same tell a factor
HEATED = {"resistance": 0.4}  # logarithm, by which warm and cold runs may differ beyond that
OFF = 3.0  # standard deviations, beyond which a factor is not usual
EXPLAINS = 0.8  # of what a channel is off by
TIME: Key = ("time", "")


@dataclass(frozen=True)
class Signature:
    """Powers of a fault's size in each factor, and the factors whose sign it turns if it is negative."""

    keys: tuple[Key, ...]  # channels that are scaled alike; none for a parameter of the model
    powers: Mapping[str, float]
    turns: frozenset[str] = frozenset()
    parameter: str = ""


def _of(keys: Sequence[Key], up: str = "", down: str = "", turned: str = "") -> Signature:
    powers = {name: 1.0 for name in up.split(",") if name} | {name: -1.0 for name in down.split(",") if name}
    return Signature(tuple(keys), powers, frozenset([*powers, *filter(None, turned.split(","))]))


CURRENT, REFERENCE = ("q_axis_current", "test"), ("q_axis_current_reference", "test")
VELOCITY, ANGLE, TORQUE = ("velocity", "test"), ("angle", "test"), ("torque", "test")
MOTION = "inertia,damping"
BY_ANGLE = (
    _of([VELOCITY], "velocity test,velocity to its reference"),
    _of([ANGLE], "angle to its reference", f"velocity test,velocity load,back_emf,{MOTION}", "friction,feeding"),
    _of(
        [ANGLE, VELOCITY],
        "angle to its reference,velocity to its reference",
        f"velocity load,back_emf,{MOTION}",
        "friction,feeding",
    ),
    Signature(
        (TIME,),
        {"velocity test": 1.0, "velocity load": 1.0, "back_emf": 1.0, "damping": 1.0, "inertia": 2.0},
    ),
)
BY_VELOCITY = (
    _of([VELOCITY], "velocity to its reference", f"velocity load,back_emf,{MOTION}", "friction,feeding"),
    Signature((TIME,), {"inertia": 1.0}),
)
"""Faults of motion that is told by the angle, and by the velocity where no angle is logged."""
OTHERS = (
    _of([("velocity", "load")], "velocity load"),
    _of([("q_axis_current", "load")], "current load"),
    _of([("q_axis_current_reference", "load")], "", "current load"),
    _of([CURRENT], f"current test,{MOTION},friction", "torque,resistance"),
    _of([REFERENCE], "", "current test"),
    _of([CURRENT, REFERENCE], f"{MOTION},friction", "torque,resistance"),
    _of([TORQUE], "torque"),
    _of([("q_axis_voltage", "test")], "resistance,back_emf,feeding"),
    _of([("angle_reference", "test")], "", "angle to its reference"),
    _of([("velocity_reference", "test")], "", "velocity to its reference"),
)
PARAMETERS = (
    Signature((), OF_CONSTANT, parameter="torque_constant"),
    Signature((), {"resistance": 1.0}, parameter="phase_resistance"),
    Signature((), {"inertia": 1.0}, parameter="rotor_inertia"),
    Signature((), {"damping": 1.0}, parameter="viscous_damping"),
    Signature((), {"friction": 1.0}, parameter="coulomb_friction"),
)


@dataclass(frozen=True)
class Pooled:
    """One factor of several runs."""

    sign: float
    size: float  # logarithm
    error: float
    explained: float


@dataclass(frozen=True)
class Spoken:
    """A signature that the factors speak for, at its size."""

    signature: Signature
    size: float  # logarithm
    error: float
    sign: float
    misfit: float
    explained: float

    @property
    def factor(self) -> float:
        """The signed size."""
        return self.sign * math.exp(self.size)


def pooled(runs: Sequence[Mapping[str, Factor]]) -> dict[str, Pooled]:
    """Factors that runs agree on."""
    by_channel = {}
    for name in USUAL:
        factors = [run[name] for run in runs if name in run]
        if not factors:
            continue
        signs = np.sign([one.value for one in factors])
        sizes = np.log(np.abs([one.value for one in factors]))
        errors = float(np.median([one.error for one in factors]))
        spread = float(np.std(sizes))
        if (signs != signs[0]).any() or float(np.ptp(sizes)) > 2.0 * AGREE + HEATED.get(name, 0.0) + 4.0 * errors:
            continue
        error = math.hypot(errors, spread / math.sqrt(len(factors)))
        explained = float(np.median([one.explained for one in factors]))
        by_channel[name] = Pooled(float(signs[0]), float(np.median(sizes)), error, explained)
    return by_channel


def usual(factor: Factor) -> bool:
    """Whether a sound machine may show a factor."""
    deviation = math.hypot(math.hypot(USUAL[factor.relation], factor.error), CONSTANT * abs(constant(factor.relation)))
    return factor.value > 0.0 and abs(math.log(factor.value)) <= OFF * deviation


def constant(relation: str) -> float:
    """The power of the torque constant in a factor."""
    return OF_CONSTANT.get(relation, 0.0)


def spoken_for(factors: Mapping[str, Pooled], channels: Iterable[Key]) -> list[Spoken]:
    """The fault that factors speak for and its rivals, best first; empty where all is usual or nothing fits.

    Parameters
    ----------
    channels : that the runs have.
    """
    if not factors:
        return []
    there, names = {*channels, TIME}, list(factors)
    by_motion = BY_ANGLE if ANGLE in there else BY_VELOCITY
    sizes = np.array([factors[name].size for name in names])
    signs = np.array([factors[name].sign for name in names])
    along = np.array([constant(name) for name in names])
    usually = np.diag([USUAL[name] ** 2 + factors[name].error ** 2 for name in names])
    usually += CONSTANT**2 * np.outer(along, along)
    weights = np.linalg.inv(usually)
    nothing = float(sizes @ weights @ sizes)
    turned = bool((signs < 0.0).any())
    if not turned and nothing < SURPRISE:
        return []
    fitted = []
    for signature in (*by_motion, *OTHERS, *PARAMETERS):
        if not there.issuperset(signature.keys):
            continue
        sign = np.array([-1.0 if name in signature.turns else 1.0 for name in names])
        if turned and not np.array_equal(sign, signs):
            continue
        powers = np.array([signature.powers.get(name, 0.0) for name in names])
        cost = 0.0 if signature.keys else WRONG_PARAMETER**-2.0
        information = float(powers @ weights @ powers) + cost
        if information == 0.0:
            continue
        size = float(powers @ weights @ sizes) / information
        if turned and information * size**2 < SURPRISE:
            size = 0.0  # turned, and no more than that
        left = sizes - size * powers
        misfit = float(left @ weights @ left) + cost * size**2
        if not turned and (nothing - misfit < SURPRISE or not shown(names, powers, factors)):
            continue
        if np.max(np.abs(left) / np.sqrt(np.diag(usually))) > LEFT:
            continue
        own = [factors[name].explained for name in names if powers[names.index(name)] or name in signature.turns]
        error = float(information**-0.5)
        for name, power in zip(names, powers.tolist(), strict=True):
            if size and power and USUAL[name] <= TIGHT:  # two channels that say the same tell the size best
                size, error = factors[name].size / power, math.hypot(factors[name].error, EXACT)
        fitted.append(Spoken(signature, size, error, -1.0 if turned else 1.0, misfit, max(own)))
    fitted.sort(key=lambda one: (one.misfit, len(one.signature.keys)))
    return [one for one in fitted if one.misfit <= fitted[0].misfit + RIVAL]


def shown(names: Sequence[str], powers: Array, factors: Mapping[str, Pooled]) -> bool:
    """Whether the factors that a signature scales explain nearly all of what their channels are off by.

    Two channels that say the same have to agree once the factor is undone; of other relations one has to.
    """
    scaled = [name for name, power in zip(names, powers, strict=True) if power]
    tight = [name for name in scaled if USUAL[name] <= TIGHT]
    return (all if tight else any)(factors[name].explained >= EXPLAINS for name in tight or scaled)
