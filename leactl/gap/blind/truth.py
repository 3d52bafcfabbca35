"""Measure with the key of a case where its gap lies, and how much of it a diagnosis closes that knows the effects.

The bench with its true parameters is replayed through the held-out runs with the true effects and without them. The
distance of the two replays in a channel, in floors, is the effects' move. The distance of the replay with effects from
that of the nominal model, calibrated without effects, is the gap after recalibration.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from leactl.effects import library
from leactl.gap import null
from leactl.gap.blind.answers import MODEL_FILE, runs_of, write
from leactl.gap.diagnose import Case, model_with, read_case
from leactl.gap.replay.comparison import Compared
from leactl.gap.search.angle_periodogram import strongest_orders
from leactl.gap.search.effect_regression import ORDERS_TRIED, Evidence, forms_at_scales
from leactl.gap.search.effect_sets import MOST_SIZE_RATIO, best_of_each, fit_member, refine
from leactl.gap.search.parameters import calibrated_parameters, with_calibration, with_effects
from leactl.gap.search.regression import Candidate
from leactl.gap.signals.record import Record
from leactl.gap.signals.setpoints import mark_setpoints
from leactl.gap.signals.stamps import stamped
from leactl.gap.verdict.shrinkage import shrinkage
from leactl.model.nominal import Model, as_mapping
from leactl.vocabulary.effect import effect_definition

UNKNOWN_EFFECT = "unknown"  # stands in the key for an effect outside the vocabulary
BENCH_MACHINE = "emulated bench"  # machine of a key that names no machine: only this bench had cases then


@dataclass(frozen=True)
class Truth:
    """One case's entry of the key."""

    kind: str  # none, single, pair, unknown
    effects: tuple[str, ...]  # of the vocabulary
    unlisted: tuple[str, ...]  # effects outside the vocabulary
    strength: str | None
    parameters: Mapping[str, Mapping[str, float]]
    base: Mapping[str, float]  # true parameters under the names of a model file
    # by effect: effects that no record of this machine can tell from it
    alike: Mapping[str, Sequence[str]] = field(default_factory=dict)
    machine: str = BENCH_MACHINE
    simulator: str = BENCH_MACHINE
    ratios_to: str | None = None  # parameter that no run determines; other parameters are compared as ratios to it

    @property
    def guises(self) -> set[str]:
        """The effects that act, and those that no record of this machine can tell from them."""
        return {*self.effects, *(name for effect in self.effects for name in self.alike.get(effect, ()))}

    @classmethod
    def of(cls, entry: Mapping[str, Any]) -> "Truth":
        """Return the truth of one entry of the key file."""
        effects = tuple(name for name in entry["effects"] if name != UNKNOWN_EFFECT)
        unlisted = tuple(entry["unlisted"])
        optional = {name: entry[name] for name in ("alike", "machine", "simulator", "ratios_to") if name in entry}
        strength, parameters, base = entry["strength"], entry["parameters"], entry["true_base"]
        return cls(entry["kind"], effects, unlisted, strength, parameters, base, **optional)


def measure(case: Path, entry: Mapping[str, Any], out: Path) -> None:
    """Measure a case with its key and write `moved`, moves by channel, and `oracle`, the shrinkage by known effects."""
    truth, loaded_case = Truth.of(entry), read_case(runs_of(case), [], case / MODEL_FILE)
    measured: dict[str, Any] = {"moved": [], "oracle": []}
    if truth.effects:
        calibrated, augmented, held_out = oracle(loaded_case, truth.effects)
        measured["moved"] = [asdict(line) for line in moves_by_effects(loaded_case, truth, calibrated)]
        measured["oracle"] = [
            asdict(line) for line in shrinkage(held_out, loaded_case.model, calibrated, augmented).shrinkage
        ]
    write(out, measured)


@dataclass(frozen=True)
class Moved:
    """Distances of the true model with its effects from two models without effects, in one channel, in floors."""

    quantity: str
    role: str
    mechanical: str
    by_effects: float  # from the true model without effects
    after_calibration: float  # from the calibrated nominal model


def moves_by_effects(case: Case, truth: Truth, calibrated: Model) -> list[Moved]:
    """Return how far the true effects move every channel of the held-out runs from two models without them."""
    without_effects = true_model(case.model, truth.base)
    with_true_effects = with_effects(without_effects, [(name, truth.parameters[name]) for name in truth.effects])
    groups: dict[tuple[str, str, str], list[Compared]] = {}
    for channel in shrinkage(case.held_out, without_effects, calibrated, with_true_effects).channels:
        groups.setdefault((channel.quantity, channel.role, channel.mechanical), []).append(channel)
    return [Moved(*key, *(distance_in_floors(group, model) for model in (0, 1))) for key, group in groups.items()]


def distance_in_floors(group: Sequence[Compared], model_index: int) -> float:
    """Return the root mean square distance between the replays of a model and of the last model, in floors."""
    difference = np.concatenate([channel.replayed[model_index] - channel.replayed[-1] for channel in group])
    floor = np.concatenate([channel.floor_squares() for channel in group])
    return float(np.sqrt(np.mean(difference**2) / np.mean(floor)))


def true_model(nominal: Model, true_parameters: Mapping[str, float]) -> Model:
    """Return the nominal model with the true parameters of the bench."""
    document = as_mapping(nominal)
    for name, value in true_parameters.items():
        *path, parameter = name.split(".")
        section = document
        for section_name in path:
            section = section.setdefault(section_name, {})
        if path or parameter in Model.model_fields:
            section[parameter] = value
    return Model.model_validate(document)


def oracle(case: Case, effects: Sequence[str]) -> tuple[Model, Model, list[Record]]:
    """Return the calibrated and the augmented model of a diagnosis that knows which effects act.

    The third value is the held-out runs, with their stamps fitted by that diagnosis.
    """
    case = case.of_records(mark_setpoints([*case.fitted, *case.held_out], case.model))
    forms = forms_at_scales(case.fitted, case.model)
    candidates = [(name, form) for name in effects for form in forms.get(name, []) if not library()[name].periodic]
    evidence = Evidence(case.fitted, case.model, only=candidates)
    null.set_floors(evidence, null.measure(case.fitted, case.model, only=candidates))
    hypothesis = true_set(evidence, effects)
    calibrated = with_calibration(case.model, calibrated_parameters(evidence, evidence.settle([])))
    lateness = evidence.lateness(evidence.settle(hypothesis))
    augmented = model_with(case.model, evidence, hypothesis)
    return calibrated, augmented, [stamped(record, lateness) for record in case.held_out]


def true_set(evidence: Evidence, effects: Sequence[str]) -> list[Candidate]:
    """Return the best form of each effect beside the others, without effects that no run shows in a possible size."""
    hypothesis: list[Candidate] = []
    # orders are searched in the residual of the others, then each effect is fitted again beside all others
    for name in (*sorted(effects, key=lambda name: bool(library()[name].periodic)), *effects):
        other_members = [item for item in hypothesis if item[0] != name]
        fit = evidence.settle(other_members)
        if library()[name].periodic:
            orders = strongest_orders(evidence.stack, fit, evidence.weights, ORDERS_TRIED)
            evidence.add([item for item in orders if item[0] == name])
        best = best_of_each(evidence, evidence.normal(), other_members)
        hypothesis = [*other_members, *(item.candidate for item in best if item.effect == name)]
    hypothesis = refine(evidence, hypothesis)
    evidence.settle(hypothesis)
    normal = evidence.normal()
    members = [fit_member(evidence, normal, hypothesis, index) for index in range(len(hypothesis))]
    # a form that decays before the slowest row has a column of almost zero, whose coefficient is arbitrary
    return [item.candidate for item in members if item is not None and item.size <= largest_size(item.effect)]


def largest_size(effect: str) -> float:
    """Return `MOST_SIZE_RATIO` times the largest size of an effect in its definition."""
    return MOST_SIZE_RATIO * effect_definition(effect).largest
