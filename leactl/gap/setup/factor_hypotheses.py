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
LEAST_EXPLAINED_SQUARES = 9.0  # squared standard deviations of the factors that a fault has to explain
MOST_RESIDUAL_STDS = 3.0  # largest residual of any factor, in standard deviations
MOST_RIVAL_COST = 9.0  # squared standard deviations by which a rival may fit worse
WRONG_PARAMETER_STD = math.log(2.0)  # deviation of the logarithm of a parameter that is wrong in the model file
MOST_DISAGREEMENT = 0.2  # deviation of the logarithm of a factor to either side, between runs with one fault
EXACT_FACTOR_ERROR = 0.004  # error of the logarithm of a factor between two channels of one quantity
WARM_DIFFERENCE = {"resistance": 0.4}  # further difference of logarithms between warm and cold runs
MOST_USUAL_STDS = 3.0  # standard deviations up to which a factor is usual
LEAST_EXPLAINED_SHARE = 0.8  # smallest share of a channel's squared error that a scale fault removes
TIME: Key = ("time", "")


@dataclass(frozen=True)
class Signature:
    """Powers of a fault's size in each factor, and the factors whose sign a negative fault reverses."""

    keys: tuple[Key, ...]  # channels that are scaled alike; empty for a parameter of the model
    powers: Mapping[str, float]
    reversed_factors: frozenset[str] = frozenset()
    parameter: str = ""  # wrong parameter of the model; empty for a fault of channels


def _signature(keys: Sequence[Key], multiplied: str = "", divided: str = "", reversed_only: str = "") -> Signature:
    """Return the signature of a fault that multiplies, divides or only reverses relations, each separated by commas."""
    powers = {name: 1.0 for name in multiplied.split(",") if name} | {name: -1.0 for name in divided.split(",") if name}
    return Signature(tuple(keys), powers, frozenset([*powers, *filter(None, reversed_only.split(","))]))


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
    """One factor that several runs agree on."""

    sign: float
    size: float  # logarithm of the absolute factor
    error: float  # standard error of `size`
    explained: float


@dataclass(frozen=True)
class FaultHypothesis:
    """A fault, or a wrong parameter of the model, that fits the factors."""

    signature: Signature
    size: float  # logarithm of the absolute factor
    error: float  # standard error of `size`
    sign: float
    misfit: float
    explained: float

    @property
    def factor(self) -> float:
        """Signed factor by which the fault multiplies its channels."""
        return self.sign * math.exp(self.size)


def pool_factors(runs: Sequence[Mapping[str, Factor]]) -> dict[str, PooledFactor]:
    """Return the factors that all runs agree on, by relation."""
    pooled = {}
    for relation in FACTOR_STDS:
        factors = [run[relation] for run in runs if relation in run]
        if not factors:
            continue
        signs = np.sign([factor.value for factor in factors])
        sizes = np.log(np.abs([factor.value for factor in factors]))
        median_error = float(np.median([factor.error for factor in factors]))
        std_of_runs = float(np.std(sizes))
        if (signs != signs[0]).any() or float(np.ptp(sizes)) > 2.0 * MOST_DISAGREEMENT + WARM_DIFFERENCE.get(
            relation, 0.0
        ) + 4.0 * median_error:
            continue
        error = math.hypot(median_error, std_of_runs / math.sqrt(len(factors)))
        explained = float(np.median([factor.explained for factor in factors]))
        pooled[relation] = PooledFactor(float(signs[0]), float(np.median(sizes)), error, explained)
    return pooled


def is_usual(factor: Factor) -> bool:
    """Return whether a sound machine may have a factor."""
    deviation = math.hypot(
        math.hypot(FACTOR_STDS[factor.relation], factor.error), CONSTANT_STD * abs(constant_power(factor.relation))
    )
    return factor.value > 0.0 and abs(math.log(factor.value)) <= MOST_USUAL_STDS * deviation


def constant_power(relation: str) -> float:
    """Return the power of the torque constant in a factor."""
    return CONSTANT_POWERS.get(relation, 0.0)


def fault_hypotheses(factors: Mapping[str, PooledFactor], channels: Iterable[Key]) -> list[FaultHypothesis]:
    """Return the fault that the factors show and its rivals, best first; empty if all are usual or no fault fits.

    Parameters
    ----------
    channels : channels of the runs.
    """
    if not factors:
        return []
    logged_channels, relations = {*channels, TIME}, list(factors)
    motion_signatures = SIGNATURES_BY_ANGLE if ANGLE in logged_channels else SIGNATURES_BY_VELOCITY
    sizes = np.array([factors[relation].size for relation in relations])
    signs = np.array([factors[relation].sign for relation in relations])
    constant_powers = np.array([constant_power(relation) for relation in relations])
    covariance = np.diag([FACTOR_STDS[relation] ** 2 + factors[relation].error ** 2 for relation in relations])
    covariance += CONSTANT_STD**2 * np.outer(constant_powers, constant_powers)
    weights = np.linalg.inv(covariance)
    misfit_without_fault = float(sizes @ weights @ sizes)
    is_reversed = bool((signs < 0.0).any())
    if not is_reversed and misfit_without_fault < LEAST_EXPLAINED_SQUARES:
        return []
    hypotheses = []
    for signature in (*motion_signatures, *OTHER_SIGNATURES, *PARAMETER_SIGNATURES):
        if not logged_channels.issuperset(signature.keys):
            continue
        expected_signs = np.array([-1.0 if relation in signature.reversed_factors else 1.0 for relation in relations])
        if is_reversed and not np.array_equal(expected_signs, signs):
            continue
        powers = np.array([signature.powers.get(relation, 0.0) for relation in relations])
        prior_precision = 0.0 if signature.keys else WRONG_PARAMETER_STD**-2.0
        information = float(powers @ weights @ powers) + prior_precision
        if information == 0.0:
            continue
        size = float(powers @ weights @ sizes) / information
        if is_reversed and information * size**2 < LEAST_EXPLAINED_SQUARES:
            size = 0.0  # the size is not significant: only the sign is reversed
        residual = sizes - size * powers
        misfit = float(residual @ weights @ residual) + prior_precision * size**2
        if not is_reversed and (
            misfit_without_fault - misfit < LEAST_EXPLAINED_SQUARES or not is_explained(relations, powers, factors)
        ):
            continue
        if np.max(np.abs(residual) / np.sqrt(np.diag(covariance))) > MOST_RESIDUAL_STDS:
            continue
        explained_shares = [
            factors[relation].explained
            for relation in relations
            if powers[relations.index(relation)] or relation in signature.reversed_factors
        ]
        error = float(information**-0.5)
        for relation, power in zip(relations, powers.tolist(), strict=True):
            if size and power and FACTOR_STDS[relation] <= TIGHT_STD:  # two channels of one quantity give the size best
                size, error = factors[relation].size / power, math.hypot(factors[relation].error, EXACT_FACTOR_ERROR)
        hypotheses.append(
            FaultHypothesis(signature, size, error, -1.0 if is_reversed else 1.0, misfit, max(explained_shares))
        )
    hypotheses.sort(key=lambda fault: (fault.misfit, len(fault.signature.keys)))
    return [fault for fault in hypotheses if fault.misfit <= hypotheses[0].misfit + MOST_RIVAL_COST]


def is_explained(relations: Sequence[str], powers: Array, factors: Mapping[str, PooledFactor]) -> bool:
    """Return whether the scaled factors explain nearly all of their channels' squared errors.

    All relations between two channels of one quantity have to; if there is none, one other relation has to.
    """
    scaled = [relation for relation, power in zip(relations, powers, strict=True) if power]
    tight = [relation for relation in scaled if FACTOR_STDS[relation] <= TIGHT_STD]
    return (all if tight else any)(factors[relation].explained >= LEAST_EXPLAINED_SHARE for relation in tight or scaled)
