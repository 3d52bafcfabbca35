"""Identify the fault of a set-up from the factors of relations.

A fault scales several factors at once, each by a power of the fault's size, and reverses the sign of some. A wrong
parameter of the model scales factors, too. Each fault is a small regression over the logarithms of the factors, whose
errors are the scatter of sound machines; faults that fit about as well as the best cannot be told from it.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.setup.relations import CONSTANT_POWERS, CONSTANT_STD, FACTOR_STDS, TIGHT_STD, Factor
from leactl.gap.signals.record import Key

Array = npt.NDArray[np.float64]
LEAST_EXPLAINED_SQUARES = 9.0  # squared standard deviations that a fault explains
MOST_RESIDUAL_STDS = 3.0  # largest residual of any factor, in standard deviations
MOST_RIVAL_COST = 9.0  # squared standard deviations by which a rival may fit worse
WRONG_PARAMETER_STD = math.log(2.0)  # deviation of the logarithm of a parameter that is wrong in the model file
MOST_DISAGREEMENT = 0.2  # largest deviation of the logarithms of one factor between runs with one fault
EXACT_FACTOR_ERROR = 0.004  # error of the logarithm of a factor between two channels of one quantity
WARM_DIFFERENCE = {"resistance": 0.4}  # further difference of logarithms between warm and cold runs
MOST_USUAL_STDS = 3.0  # standard deviations up to which a factor is usual
LEAST_EXPLAINED_SHARE = 0.8  # smallest share of a channel's squared error that a scale fault removes
TIME: Key = ("time", "")


@dataclass(frozen=True)
class Signature:
    """Powers of a fault's size in each factor, and the factors whose sign a negative fault reverses."""

    keys: tuple[Key, ...]  # channels that are scaled alike; none for a parameter of the model
    powers: Mapping[str, float]
    turns: frozenset[str] = frozenset()
    parameter: str = ""


def _signature(keys: Sequence[Key], up: str = "", down: str = "", turned: str = "") -> Signature:
    powers = {name: 1.0 for name in up.split(",") if name} | {name: -1.0 for name in down.split(",") if name}
    return Signature(tuple(keys), powers, frozenset([*powers, *filter(None, turned.split(","))]))


CURRENT, REFERENCE = ("q_axis_current", "test"), ("q_axis_current_reference", "test")
VELOCITY, ANGLE, TORQUE = ("velocity", "test"), ("angle", "test"), ("torque", "test")
MOTION_RELATIONS = "inertia,damping"
SIGNATURES_BY_ANGLE = (
    _signature([VELOCITY], "velocity test,velocity to its reference"),
    _signature(
        [ANGLE],
        "angle to its reference",
        f"velocity test,velocity load,back_emf,{MOTION_RELATIONS}",
        "friction,feeding",
    ),
    _signature(
        [ANGLE, VELOCITY],
        "angle to its reference,velocity to its reference",
        f"velocity load,back_emf,{MOTION_RELATIONS}",
        "friction,feeding",
    ),
    Signature(
        (TIME,),
        {"velocity test": 1.0, "velocity load": 1.0, "back_emf": 1.0, "damping": 1.0, "inertia": 2.0},
    ),
)
SIGNATURES_BY_VELOCITY = (
    _signature(
        [VELOCITY], "velocity to its reference", f"velocity load,back_emf,{MOTION_RELATIONS}", "friction,feeding"
    ),
    Signature((TIME,), {"inertia": 1.0}),
)
"""Faults of motion measured by the angle, and by the velocity where no angle is logged."""
OTHER_SIGNATURES = (
    _signature([("velocity", "load")], "velocity load"),
    _signature([("q_axis_current", "load")], "current load"),
    _signature([("q_axis_current_reference", "load")], "", "current load"),
    _signature([CURRENT], f"current test,{MOTION_RELATIONS},friction", "torque,resistance"),
    _signature([REFERENCE], "", "current test"),
    _signature([CURRENT, REFERENCE], f"{MOTION_RELATIONS},friction", "torque,resistance"),
    _signature([TORQUE], "torque"),
    _signature([("q_axis_voltage", "test")], "resistance,back_emf,feeding"),
    _signature([("angle_reference", "test")], "", "angle to its reference"),
    _signature([("velocity_reference", "test")], "", "velocity to its reference"),
)
PARAMETER_SIGNATURES = (
    Signature((), CONSTANT_POWERS, parameter="torque_constant"),
    Signature((), {"resistance": 1.0}, parameter="phase_resistance"),
    Signature((), {"inertia": 1.0}, parameter="rotor_inertia"),
    Signature((), {"damping": 1.0}, parameter="viscous_damping"),
    Signature((), {"friction": 1.0}, parameter="coulomb_friction"),
)


@dataclass(frozen=True)
class PooledFactor:
    """One factor of several runs."""

    sign: float
    size: float  # logarithm
    error: float
    explained: float


@dataclass(frozen=True)
class ShownFault:
    """A fault that the factors show, with its fitted size."""

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


def pool_factors(runs: Sequence[Mapping[str, Factor]]) -> dict[str, PooledFactor]:
    """Return the factors that all runs agree on, by relation."""
    by_channel = {}
    for name in FACTOR_STDS:
        factors = [run[name] for run in runs if name in run]
        if not factors:
            continue
        signs = np.sign([factor.value for factor in factors])
        sizes = np.log(np.abs([factor.value for factor in factors]))
        errors = float(np.median([factor.error for factor in factors]))
        spread = float(np.std(sizes))
        if (signs != signs[0]).any() or float(np.ptp(sizes)) > 2.0 * MOST_DISAGREEMENT + WARM_DIFFERENCE.get(
            name, 0.0
        ) + 4.0 * errors:
            continue
        error = math.hypot(errors, spread / math.sqrt(len(factors)))
        explained = float(np.median([factor.explained for factor in factors]))
        by_channel[name] = PooledFactor(float(signs[0]), float(np.median(sizes)), error, explained)
    return by_channel


def is_usual(factor: Factor) -> bool:
    """Return whether a sound machine may have a factor."""
    deviation = math.hypot(
        math.hypot(FACTOR_STDS[factor.relation], factor.error), CONSTANT_STD * abs(constant_power(factor.relation))
    )
    return factor.value > 0.0 and abs(math.log(factor.value)) <= MOST_USUAL_STDS * deviation


def constant_power(relation: str) -> float:
    """Return the power of the torque constant in a factor."""
    return CONSTANT_POWERS.get(relation, 0.0)


def shown_faults(factors: Mapping[str, PooledFactor], channels: Iterable[Key]) -> list[ShownFault]:
    """Return the fault that the factors show and its rivals, best first; empty if all are usual or no fault fits.

    Parameters
    ----------
    channels : channels of the runs.
    """
    if not factors:
        return []
    channels_there, names = {*channels, TIME}, list(factors)
    by_motion = SIGNATURES_BY_ANGLE if ANGLE in channels_there else SIGNATURES_BY_VELOCITY
    sizes = np.array([factors[name].size for name in names])
    signs = np.array([factors[name].sign for name in names])
    constant_powers = np.array([constant_power(name) for name in names])
    covariance = np.diag([FACTOR_STDS[name] ** 2 + factors[name].error ** 2 for name in names])
    covariance += CONSTANT_STD**2 * np.outer(constant_powers, constant_powers)
    weights = np.linalg.inv(covariance)
    misfit_without_fault = float(sizes @ weights @ sizes)
    turned = bool((signs < 0.0).any())
    if not turned and misfit_without_fault < LEAST_EXPLAINED_SQUARES:
        return []
    fitted = []
    for signature in (*by_motion, *OTHER_SIGNATURES, *PARAMETER_SIGNATURES):
        if not channels_there.issuperset(signature.keys):
            continue
        sign = np.array([-1.0 if name in signature.turns else 1.0 for name in names])
        if turned and not np.array_equal(sign, signs):
            continue
        powers = np.array([signature.powers.get(name, 0.0) for name in names])
        cost = 0.0 if signature.keys else WRONG_PARAMETER_STD**-2.0
        information = float(powers @ weights @ powers) + cost
        if information == 0.0:
            continue
        size = float(powers @ weights @ sizes) / information
        if turned and information * size**2 < LEAST_EXPLAINED_SQUARES:
            size = 0.0  # only the sign is reversed
        residual = sizes - size * powers
        misfit = float(residual @ weights @ residual) + cost * size**2
        if not turned and (
            misfit_without_fault - misfit < LEAST_EXPLAINED_SQUARES or not is_explained(names, powers, factors)
        ):
            continue
        if np.max(np.abs(residual) / np.sqrt(np.diag(covariance))) > MOST_RESIDUAL_STDS:
            continue
        explained_shares = [
            factors[name].explained for name in names if powers[names.index(name)] or name in signature.turns
        ]
        error = float(information**-0.5)
        for name, power in zip(names, powers.tolist(), strict=True):
            if size and power and FACTOR_STDS[name] <= TIGHT_STD:  # two channels of one quantity give the size best
                size, error = factors[name].size / power, math.hypot(factors[name].error, EXACT_FACTOR_ERROR)
        fitted.append(ShownFault(signature, size, error, -1.0 if turned else 1.0, misfit, max(explained_shares)))
    fitted.sort(key=lambda fault: (fault.misfit, len(fault.signature.keys)))
    return [fault for fault in fitted if fault.misfit <= fitted[0].misfit + MOST_RIVAL_COST]


def is_explained(names: Sequence[str], powers: Array, factors: Mapping[str, PooledFactor]) -> bool:
    """Return whether the scaled factors explain nearly all of their channels' squared errors.

    All relations between two channels of one quantity have to; if there is none, one other relation has to.
    """
    scaled = [name for name, power in zip(names, powers, strict=True) if power]
    tight = [name for name in scaled if FACTOR_STDS[name] <= TIGHT_STD]
    return (all if tight else any)(factors[name].explained >= LEAST_EXPLAINED_SHARE for name in tight or scaled)
