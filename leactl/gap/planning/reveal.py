"""What an effect must reach to be seen in some runs, and which effects look alike there.

Columns of effects are projected off everything that recalibration can imitate (Frisch-Waugh). What is left of a column
over its noise gives the standard error of the effect's size; cosines between two tell whether the runs separate them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.gap.null import measure
from leactl.gap.search.evidence import Evidence, every_form, forms_here
from leactl.gap.search.regression import Candidate, Normal
from leactl.gap.search.sets import ENTRY, SHAPE, WAVE
from leactl.gap.signals.record import Record
from leactl.gap.signals.setpoints import marked
from leactl.model.nominal import Model
from leactl.vocabulary.effect import effect_definition

Array = npt.NDArray[np.float64]
ALIKE = 0.95  # cosine of projected columns, above which two effects are one class
ORDERS = 3  # of a periodic effect that stand for all
NO_BENCH = 100.0  # times the smallest size worth knowing, beyond which no bench has it
IMITATED = 1e-6  # of a column's square, below which recalibration imitates all of it


@dataclass(frozen=True)
class Sight:
    """One effect in some runs."""

    effect: str
    smallest: float | None  # size from which on it is found; None where no run shows it
    faint: float | None  # smallest size worth knowing; None where the model does not tell its unit
    units: str
    alike: tuple[str, ...]  # effects that these runs cannot tell it from

    @property
    def seen(self) -> bool:
        """Whether it is found at every size worth knowing."""
        return self.smallest is not None and self.faint is not None and self.smallest <= self.faint


def planned_candidates(records: Sequence[Record], model: Model) -> list[Candidate]:
    """Every form of every effect at the scales of some runs; periodic ones at a few orders over their range."""
    candidates = every_form(forms_here(records, model))
    for effect in library().values():
        if effect.periodic and effect.applies(model):
            low, high = effect.orders
            orders = np.unique(np.rint(np.geomspace(max(low, 1), high / 2.0, ORDERS)))
            candidates += [(effect.name, (float(order),)) for order in orders]
    return candidates


def evidence_of(records: Sequence[Record], model: Model) -> Evidence:
    """Evidence of planned or measured runs for every effect, with what a sound machine leaves over in each of them.

    What it shows of effects is not counted: that hangs on which of the runs are taken together. Whether setpoints hold
    over their interval is read from the runs, as a diagnosis reads it.
    """
    records = marked(records, model)
    evidence = Evidence(records, model, only=planned_candidates(records, model))
    evidence.compare_with(measure(records, model, machines=1, only=[]))
    return evidence


def sights(evidence: Evidence, runs: Sequence[str]) -> list[Sight]:
    """Every effect that the model can lack, as these of the evidence's runs show it."""
    projected = Projected(evidence, runs)
    limits: dict[str, list[float]] = {}
    for candidate in evidence.candidates:
        needed = projected.needed(candidate)
        if needed is not None:
            limits.setdefault(candidate[0], []).append(needed)
    twins = projected.alike({name for name in limits})
    shown = []
    for name in sorted({effect for effect, _ in evidence.candidates}):
        worth = evidence.worth_knowing.get(name)
        smallest = None
        if name in limits:
            # a form that is itself the size is found where it is smallest; of others half are found from the median on
            needed = float(np.min(limits[name]) if sized_by_form(name) else np.median(limits[name]))
            smallest = needed if worth is None or needed < NO_BENCH * worth else None
        alike = tuple(sorted(other for pair in twins if name in pair for other in pair if other != name))
        shown.append(Sight(name, smallest, worth, effect_definition(name).worth_knowing.units, alike))
    return shown


def sized_by_form(name: str) -> bool:
    """Whether an effect's forms are its sizes, as of a lag, rather than shapes of any size."""
    effect = library()[name]
    return effect.shaped and effect.continuous and name != "command_slew_limit"


class Projected:
    """Columns of effects beyond calibration, for some of the runs of an evidence."""

    def __init__(self, evidence: Evidence, runs: Sequence[str]) -> None:
        self.evidence = evidence
        evidence.weigh_as_usual()
        weights = [
            w if rows.run in runs else 0.0 for w, rows in zip(evidence.weights, evidence.stack.rows, strict=True)
        ]
        gram = Normal(evidence.stack, weights).gram
        there = np.diag(gram) > 0.0
        effect = np.asarray([name[0] == "effect" for name in evidence.stack.names])
        base, self.columns = np.flatnonzero(there & ~effect), np.flatnonzero(there & effect)
        a, b = gram[np.ix_(base, base)], gram[np.ix_(base, self.columns)]
        whole = gram[np.ix_(self.columns, self.columns)]
        scale = np.sqrt(np.diag(a))
        scaled = a / np.outer(scale, scale) + 1e-10 * np.eye(len(base))
        self.left = whole - (b / scale[:, None]).T @ np.linalg.solve(scaled, b / scale[:, None])
        self.kept = np.diag(self.left) > IMITATED * np.diag(whole)
        self.place = {int(column): k for k, column in enumerate(self.columns)}

    def block(self, candidate: Candidate) -> list[int]:
        """Where a candidate's columns stand; empty where nothing is left of one of them, or of one beside another."""
        columns = []
        for column in self.evidence.columns(candidate):
            place = self.place.get(int(column))
            if place is not None and self.kept[place]:
                columns.append(place)
            elif place is not None or not self.own(int(column)):
                return []
        left = self.left[np.ix_(columns, columns)]
        scale = np.sqrt(np.diag(left))
        apart = np.linalg.eigvalsh(left / np.outer(scale, scale)) if columns else np.zeros(1)
        return columns if float(apart[0]) > IMITATED else []

    def own(self, column: int) -> bool:
        """Whether a column belongs to a single run, which need not be among these."""
        return self.evidence.coefficient(column).startswith("start of")

    def needed(self, candidate: Candidate) -> float | None:
        """Size from which on one form of an effect stands above its floor and uncertainty; None where it cannot."""
        block = self.block(candidate)
        if not block:
            return None
        effect, model = library()[candidate[0]], self.evidence.model
        names = [self.evidence.coefficient(int(self.columns[k])) for k in block]
        leading = [k for k, name in enumerate(names) if name in WAVE] or [0]
        covariance = np.linalg.inv(self.left[np.ix_(block, block)])
        std = float(np.sqrt(np.mean(np.diag(covariance)[leading])))
        unit = {name: 1.0 if k == leading[0] else 0.0 for k, name in enumerate(names)}
        small = {name: 1e-3 * value for name, value in unit.items()}
        slope = abs(effect.size(candidate[1], small, model)) / 1e-3
        needed = ENTRY * float(np.hypot(slope * std, self.evidence.floor(candidate)))
        if not effect.shaped:
            return needed
        # a shape is known to be its own only while most of it is there
        low, high = (slope * share for share in SHAPE)
        return max(needed, low) if needed <= high else None

    def alike(self, effects: set[str]) -> set[tuple[str, str]]:
        """Pairs of effects of which most forms of either are some form of the other but for a twentieth."""
        spans: dict[str, list[slice]] = {}
        rows: list[Array] = []
        for candidate in self.evidence.candidates:
            if candidate[0] in effects and (block := self.block(candidate)):
                begin = sum(map(len, rows))
                rows.append(self._directions(block))
                spans.setdefault(candidate[0], []).append(slice(begin, begin + len(rows[-1])))
        if not rows:
            return set()
        cosines = np.concatenate(rows) @ self.left @ np.concatenate(rows).T
        pairs = set()
        for one, other in combinations(sorted(spans), 2):
            # of the smallest angle between the columns of two forms
            table = np.asarray([[np.linalg.norm(cosines[p, q], 2) for q in spans[other]] for p in spans[one]])
            # a small lag is a small delay whatever the experiment: what counts is most of the sizes
            if min(np.mean(table.max(axis=1) > ALIKE), np.mean(table.max(axis=0) > ALIKE)) > 0.5:
                pairs.add((one, other))
        return pairs

    def _directions(self, block: list[int]) -> Array:
        """Combinations of all columns, a unit each, that span a candidate beyond what belongs to single runs."""
        own = [k for k in block if self.own(int(self.columns[k]))]
        kept = [k for k in block if k not in own]
        spanned = np.zeros((len(kept), len(self.columns)))
        spanned[np.arange(len(kept)), kept] = 1.0
        if own:
            spanned[:, own] = -np.linalg.solve(self.left[np.ix_(own, own)], self.left[np.ix_(own, kept)]).T
        root = np.linalg.cholesky(spanned @ self.left @ spanned.T)
        return np.asarray(np.linalg.solve(root, spanned), np.float64)
