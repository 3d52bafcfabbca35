"""Smallest visible size of each effect in some runs, and effects that look alike there.

Columns of effects are projected off everything that recalibration can imitate (Frisch-Waugh). The size of a projected
column over the noise gives the standard error of the effect; the cosine of two columns shows whether the runs separate
the effects.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.gap.null import measure
from leactl.gap.search.effect_regression import Evidence, every_form, forms_at_scales
from leactl.gap.search.effect_sets import ENTRY_HEIGHT, STRENGTH_RANGE, WAVE_COEFFICIENTS
from leactl.gap.search.regression import Candidate, Normal
from leactl.gap.signals.record import Record
from leactl.gap.signals.setpoints import mark_setpoints
from leactl.model.nominal import Model
from leactl.vocabulary.effect import effect_definition

Array = npt.NDArray[np.float64]
ALIKE_COSINE = 0.95  # cosine of projected columns above which two effects are one class
ORDERS_PER_EFFECT = 3  # number of orders that represent a periodic effect
MOST_NEEDED_RATIO = 100.0  # visible size over the smallest size worth knowing, beyond which no bench has the effect
IMITATED_SHARE = 1e-6  # remaining share of a column's square below which recalibration imitates the column


@dataclass(frozen=True)
class Sight:
    """Visibility of one effect in some runs."""

    effect: str
    smallest: float | None  # size from which the effect is found; None if no run shows it
    faint: float | None  # smallest size worth knowing; None if the model does not determine its unit
    units: str
    alike: tuple[str, ...]  # effects that these runs cannot tell it from

    @property
    def seen(self) -> bool:
        """Whether the effect is found at every size worth knowing."""
        return self.smallest is not None and self.faint is not None and self.smallest <= self.faint


def planned_candidates(records: Sequence[Record], model: Model) -> list[Candidate]:
    """Return every form of every effect at the scales of some runs; periodic effects have a few orders."""
    candidates = every_form(forms_at_scales(records, model))
    for effect in library().values():
        if effect.periodic and effect.applies(model):
            low, high = effect.orders
            orders = np.unique(np.rint(np.geomspace(max(low, 1), high / 2.0, ORDERS_PER_EFFECT)))
            candidates += [(effect.name, (float(order),)) for order in orders]
    return candidates


def evidence_of(records: Sequence[Record], model: Model) -> Evidence:
    """Return the evidence of planned or measured runs for every effect, with a sound machine's residuals.

    The sound machine's sizes of effects are not used: they depend on which runs are combined. Whether setpoints hold
    over their interval is read from the runs, as in a diagnosis.
    """
    records = mark_setpoints(records, model)
    evidence = Evidence(records, model, only=planned_candidates(records, model))
    evidence.compare_with(measure(records, model, machines=1, only=[]))
    return evidence


def sights(evidence: Evidence, runs: Sequence[str]) -> list[Sight]:
    """Return the visibility of every effect that the model can lack, in some of the evidence's runs."""
    projected = Projected(evidence, runs)
    limits: dict[str, list[float]] = {}
    for candidate in evidence.candidates:
        needed = projected.needed(candidate)
        if needed is not None:
            limits.setdefault(candidate[0], []).append(needed)
    alike_pairs = projected.alike({name for name in limits})
    result = []
    for name in sorted({effect for effect, _ in evidence.candidates}):
        smallest_worth = evidence.worth_knowing.get(name)
        smallest = None
        if name in limits:
            # of forms that are sizes the smallest is needed; of other forms half are found from the median on
            needed = float(np.min(limits[name]) if sized_by_form(name) else np.median(limits[name]))
            smallest = needed if smallest_worth is None or needed < MOST_NEEDED_RATIO * smallest_worth else None
        alike = tuple(sorted(other for pair in alike_pairs if name in pair for other in pair if other != name))
        result.append(
            Sight(name, smallest, smallest_worth, effect_definition(name).smallest_worth_knowing.units, alike)
        )
    return result


def sized_by_form(name: str) -> bool:
    """Return whether an effect's forms are its sizes, as of a lag, rather than shapes of any size."""
    effect = library()[name]
    return effect.shaped and effect.continuous and name != "command_slew_limit"


class Projected:
    """Columns of effects projected off calibration, for some of the runs of an evidence."""

    def __init__(self, evidence: Evidence, runs: Sequence[str]) -> None:
        self.evidence = evidence
        evidence.weigh_as_usual()
        weights = [
            weight if rows.run in runs else 0.0
            for weight, rows in zip(evidence.weights, evidence.stack.rows, strict=True)
        ]
        gram = Normal(evidence.stack, weights).gram
        non_zero = np.diag(gram) > 0.0
        is_effect = np.asarray([name[0] == "effect" for name in evidence.stack.names])
        calibration_columns, self.columns = np.flatnonzero(non_zero & ~is_effect), np.flatnonzero(non_zero & is_effect)
        calibration_gram, cross_gram = (
            gram[np.ix_(calibration_columns, calibration_columns)],
            gram[np.ix_(calibration_columns, self.columns)],
        )
        effect_gram = gram[np.ix_(self.columns, self.columns)]
        scale = np.sqrt(np.diag(calibration_gram))
        scaled_gram = calibration_gram / np.outer(scale, scale) + 1e-10 * np.eye(len(calibration_columns))
        self.projected_gram = effect_gram - (cross_gram / scale[:, None]).T @ np.linalg.solve(
            scaled_gram, cross_gram / scale[:, None]
        )
        self.is_determined = np.diag(self.projected_gram) > IMITATED_SHARE * np.diag(effect_gram)
        self.position_of_column = {int(column): k for k, column in enumerate(self.columns)}

    def block(self, candidate: Candidate) -> list[int]:
        """Return the positions of a candidate's columns; empty if calibration or other columns of it imitate one."""
        columns = []
        for column in self.evidence.columns(candidate):
            position = self.position_of_column.get(int(column))
            if position is not None and self.is_determined[position]:
                columns.append(position)
            elif position is not None or not self.is_of_one_run(int(column)):
                return []
        block_gram = self.projected_gram[np.ix_(columns, columns)]
        scale = np.sqrt(np.diag(block_gram))
        eigenvalues = np.linalg.eigvalsh(block_gram / np.outer(scale, scale)) if columns else np.zeros(1)
        return columns if float(eigenvalues[0]) > IMITATED_SHARE else []

    def is_of_one_run(self, column: int) -> bool:
        """Return whether a column belongs to a single run, which need not be one of the chosen runs."""
        return self.evidence.coefficient(column).startswith("start of")

    def needed(self, candidate: Candidate) -> float | None:
        """Return the size from which one form of an effect exceeds its floor and uncertainty; None if no size does."""
        block = self.block(candidate)
        if not block:
            return None
        effect, model = library()[candidate[0]], self.evidence.model
        names = [self.evidence.coefficient(int(self.columns[k])) for k in block]
        wave_indices = [k for k, name in enumerate(names) if name in WAVE_COEFFICIENTS] or [0]
        covariance = np.linalg.inv(self.projected_gram[np.ix_(block, block)])
        std = float(np.sqrt(np.mean(np.diag(covariance)[wave_indices])))
        unit_size = {name: 1.0 if k == wave_indices[0] else 0.0 for k, name in enumerate(names)}
        small_size = {name: 1e-3 * value for name, value in unit_size.items()}
        slope = abs(effect.size(candidate[1], small_size, model)) / 1e-3
        needed = ENTRY_HEIGHT * float(np.hypot(slope * std, self.evidence.floor(candidate)))
        if not effect.shaped:
            return needed
        # a shaped effect is only found within the range of its strength
        low, high = (slope * share for share in STRENGTH_RANGE)
        return max(needed, low) if needed <= high else None

    def alike(self, effects: set[str]) -> set[tuple[str, str]]:
        """Return the pairs of effects with cosines above `ALIKE_COSINE` for most forms of both effects."""
        slices_by_effect: dict[str, list[slice]] = {}
        directions: list[Array] = []
        for candidate in self.evidence.candidates:
            if candidate[0] in effects and (block := self.block(candidate)):
                begin = sum(map(len, directions))
                directions.append(self._directions(block))
                slices_by_effect.setdefault(candidate[0], []).append(slice(begin, begin + len(directions[-1])))
        if not directions:
            return set()
        cosines = np.concatenate(directions) @ self.projected_gram @ np.concatenate(directions).T
        pairs = set()
        for first_effect, second_effect in combinations(sorted(slices_by_effect), 2):
            # cosine of the smallest angle between the columns of two forms
            largest_cosines = np.asarray(
                [
                    [np.linalg.norm(cosines[p, q], 2) for q in slices_by_effect[second_effect]]
                    for p in slices_by_effect[first_effect]
                ]
            )
            # a small lag is like a small delay in any experiment: effects are alike if most of their sizes are
            if (
                min(
                    np.mean(largest_cosines.max(axis=1) > ALIKE_COSINE),
                    np.mean(largest_cosines.max(axis=0) > ALIKE_COSINE),
                )
                > 0.5
            ):
                pairs.add((first_effect, second_effect))
        return pairs

    def _directions(self, block: list[int]) -> Array:
        """Return orthonormal combinations of all columns that span a candidate, projected off single runs' columns."""
        own_columns = [k for k in block if self.is_of_one_run(int(self.columns[k]))]
        shared_columns = [k for k in block if k not in own_columns]
        spanned = np.zeros((len(shared_columns), len(self.columns)))
        spanned[np.arange(len(shared_columns)), shared_columns] = 1.0
        if own_columns:
            spanned[:, own_columns] = -np.linalg.solve(
                self.projected_gram[np.ix_(own_columns, own_columns)],
                self.projected_gram[np.ix_(own_columns, shared_columns)],
            ).T
        root = np.linalg.cholesky(spanned @ self.projected_gram @ spanned.T)
        return np.asarray(np.linalg.solve(root, spanned), np.float64)
