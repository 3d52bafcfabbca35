"""Runs and a nominal model made into one regression with the columns of every effect in it.

Noise is taken from what a hypothesis leaves over, pooled over runs of one kind; rows that depend on their neighbours
count for less, so that no number of samples makes up for a model that is only roughly right.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, rfft

from leactl.effects import library
from leactl.effects.contract import Form
from leactl.gap.equations import Equation, equations
from leactl.gap.equations.contract import MEMORY
from leactl.gap.search.angle_periodogram import strongest
from leactl.gap.search.regression import (
    Candidate,
    Column,
    Fit,
    Normal,
    Rows,
    Stack,
    bare,
    effect_columns,
    make_rows,
    more_columns,
    residuals,
    stack,
)
from leactl.gap.search.stamp_fit import overdue, put_on_time, stamping
from leactl.gap.signals.record import Record
from leactl.gap.signals.scales import form_scales, visited, widest, worth_knowing
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
PRIORS = {
    "phase_resistance": 0.1,
    "phase_inductance": 0.3,
    "torque_constant": 0.1,
    "rotor_inertia": 0.15,
    "viscous_damping": 0.3,
    "coulomb_friction": 0.3,
    "resistance_coefficient": 0.008,
    "bench.shaft_stiffness": 0.08,
    "load.viscous_damping": 0.4,
    "load.coulomb_friction": 0.4,
    # a feedforward is a fit: what it leaves out moves its parameters by as much as they are
    "feedforward.kS": 1.0,
    "feedforward.kV": 1.0,
    "feedforward.kA": 1.0,
    "ambient_offset": 3.0,  # K
    "thermal.winding_ambient_resistance": 0.2,
    "thermal.winding_housing_resistance": 0.2,
    "thermal.housing_ambient_resistance": 0.2,
    "thermal.winding_capacitance": 0.2,
    "thermal.housing_capacitance": 0.2,
}
"""Physical priors of the nominal model's parameters: relative standard deviations unless a unit is given."""
GAINS = (
    "torque_sensor_gain",
    "current_sensor_gain",
)  # not to be asked where no back-EMF tells the torque constant
READINGS = {"coupled_torque", "locked_torque", "swung_torque"}  # a torque sensor taken at its word tells it then
MOST_MOVED = 1.0  # of its prior, by which sound machines may move a parameter that their runs tell
MISSED = 0.2  # of what fits to sound machines are off by alike, that may be another's: the rest is taken away
CORRECTED = 0.3  # of a parameter, the largest such error that is taken away: beyond it, the runs hardly show it
PINNED = 1e-4  # prior of a torque constant that nothing tells
ROUNDED = 0.5  # of a sound machine's noise, in squares, that rounding has to make for all of it to be known
NEGLIGIBLE = 0.05  # of the smallest size worth knowing, below which an effect is none
NO_CORRELATION = 0.02
FEW_LAGS = 6
ORDERS_TRIED = 3  # of each periodic effect


@dataclass(frozen=True)
class Null:
    """What sound machines show in the place of effects and model errors."""

    unrest: Mapping[tuple[str, str], float]  # by equation and kind of run
    left: Mapping[tuple[str, str], float]  # variance of the rows, times how many of them count for one
    white: Mapping[tuple[str, str], float]  # by equation and run: variance of the rows' noise from one to the next
    floors: Mapping[str, Sequence[float]]  # sizes of each effect in its forms, in units of its leading parameter
    alike: Mapping[str, Sequence[float]]  # those that all machines show in common, where there are several
    errors: Mapping[str, Sequence[float]]  # and their standard errors there
    lines: Mapping[tuple[str, str, str], float]  # height of the highest line in what each channel leaves over
    moved: Mapping[str, tuple[float, float]]  # of each parameter: mean and scatter of its relative change
    unidentifiable: tuple[str, ...]  # parameters that they move by themselves: these runs cannot tell them,
    kept: tuple[str, ...]  # and those of them that no fit may move

    def bias(self, parameter: str) -> float:
        """Relative change of a parameter that fits to sound machines show alike, as far as it can be taken away."""
        bias = self.moved.get(parameter, (0.0, 0.0))[0]
        return bias if abs(bias) <= CORRECTED else 0.0

    def doubt(self, parameter: str) -> float:
        """Standard deviation of a parameter's relative change once its bias is taken away."""
        return error_of(*self.moved.get(parameter, (0.0, 0.0)))


def error_of(bias: float, scatter: float) -> float:
    """What is left in doubt of a relative change by a known bias, taken away where it can be, and a scatter."""
    return math.hypot(MISSED * bias if abs(bias) <= CORRECTED else bias, scatter)


class Evidence:
    """All equations of all runs, and the weights that a hypothesis gives them."""

    def __init__(
        self,
        records: Sequence[Record],
        model: Model,
        only: Sequence[Candidate] | None = None,
        kept: Sequence[str] = (),
        on_time: Sequence[str] | None = None,
    ) -> None:
        self.model, self.records = model, list(records)
        self.null: Null | None = None
        self.worth_knowing = worth_knowing(records, model)  # smallest size of each effect that is
        self.by_form: dict[str, Sequence[float]] = {}  # size of each effect that sound machines show in its forms
        self.lines: Mapping[tuple[str, str, str], float] = {}
        self.kept, self.unidentifiable = tuple(kept), tuple[str, ...]()  # parameters that stay as the model has them
        self.forms, self.travel = forms_here(records, model), widest(records)
        self.visited = visited(records)
        self.form_spread: dict[Candidate, npt.NDArray[np.float64]] = {}  # covariance of the logarithms of refined forms
        self.candidates: list[Candidate] = list(only) if only is not None else every_form(self.forms)
        self._made: list[tuple[list[Equation], list[Rows]]] = []  # of each run, equations and the rows of each
        for record in records:
            built = equations(record, model)
            rows = make_rows(record.run, record.kind, built, self.candidates)
            pairs = [(bare(equation), own) for equation, own in zip(built, rows, strict=True) if own is not None]
            self._made.append(([equation for equation, _ in pairs], [own for _, own in pairs]))
        made = self._rows()
        self.priors = dict(PRIORS)
        names = {rows.equation for rows in made}
        if unscaled(names):
            self.candidates = [c for c in self.candidates if c[0] not in GAINS]
            if not names & READINGS:
                self.priors["torque_constant"] = PINNED
        self.priors.update(dict.fromkeys(self.kept, PINNED))
        self.stack: Stack = stack(made, self.priors)
        self.weigh_as_usual()
        if on_time is None:
            on_time = overdue(self.stack, self.settle([])) if made else ()
        self.on_time = tuple(on_time)  # equations one side of which is later than stamps can be
        if self.on_time:
            put_on_time(self.stack.rows, self.on_time)
            self.stack = stack(self.stack.rows, self.priors)
        if only is None and made:
            self.add(strongest(self.stack, self.settle([]), self.weights, ORDERS_TRIED))

    def _rows(self) -> list[Rows]:
        return [rows for _, made in self._made for rows in made]

    def weigh_as_usual(self, sound: bool = False) -> None:
        """Take the noise that shows from row to row, with what a sound model usually leaves beside it.

        sound : whether that noise is a sound machine's where it has less.
        """
        for rows in self.stack.rows:
            rows.noise = self.sound_white(rows) if sound else rows.white
            rows.dependence = self.expected(rows, rows.noise)

    def compare_with(self, null: Null) -> None:
        """Take what sound machines show in these runs; a parameter that these cannot tell is not told."""
        self.null, self.lines = null, null.lines
        self.by_form = {effect: self.floors_of(effect, sizes) for effect, sizes in null.floors.items()}
        self.kept, self.unidentifiable = null.kept, null.unidentifiable
        self.priors.update(dict.fromkeys(self.kept, PINNED))
        self.stack = stack(self._rows(), self.priors)
        self.weigh_as_usual()

    def floors_of(self, effect: str, sizes: Sequence[float]) -> list[float]:
        """Floors by form: sizes by noise, at least what sound machines show in common.

        A form that some sound machine does not show takes the floor of the nearest form that all of them show.
        """
        assert self.null is not None
        forms, alike = self.forms.get(effect, ()), self.null.alike.get(effect) or [0.0] * len(sizes)
        if len(forms) != len(sizes) or len(alike) != len(sizes):  # periodic: one floor for all orders; or other forms
            return list(sizes)
        floors = [max(pair) for pair in zip(sizes, alike, strict=True)]
        seen = [place for place, error in enumerate(self.null.errors[effect]) if error < math.inf]
        if not seen:
            return floors
        seen_forms = [forms[place] for place in seen]
        return [
            floor if place in seen else floors[seen[nearest(seen_forms, forms[place])]]
            for place, floor in enumerate(floors)
        ]

    def on(self, records: Sequence[Record], hypothesis: Sequence[Candidate], model: Model | None = None) -> "Evidence":
        """Evidence of other runs for some effects, with what is known of the model and of sound machines from these.

        model : in the place of this one, where its columns are to be made of other parameters.
        """
        other = Evidence(records, model or self.model, only=hypothesis, kept=self.kept, on_time=self.on_time)
        if self.null is not None:
            other.compare_with(self.null)
        other.forms, other.by_form, other.worth_knowing = self.forms, self.by_form, self.worth_knowing
        other.form_spread = dict(self.form_spread)
        return other

    def expected(self, rows: Rows, white: float | None = None) -> float:
        """The unrest that a sound machine shows in some rows.

        Sound machines tell it as a ratio to their own noise from row to row, and as a variance: where the case has less
        noise than they, what its equations miss is as large and stands out more.

        white : noise from row to row that the unrest is a ratio to; the rows' own where left out.
        """
        if self.null is None:
            return 1.0
        key = rows.equation, rows.kind
        return max(1.0, self.null.unrest.get(key, 0.0), self.null.left.get(key, 0.0) / (white or rows.white) ** 2)

    def sound_white(self, rows: Rows) -> float:
        """Noise of rows from one to the next as a sound machine has it, where most of that is a channel's rounding.

        What swings within a few rows passes for noise by itself. How much rounding leaves is known; how much noise a
        machine makes beside that of its channels is not, so that where other noise prevails the rows' own counts.
        """
        sound = self.null.white.get((rows.equation, rows.run), 0.0) if self.null is not None else 0.0
        return min(rows.white, math.sqrt(sound)) if rows.rounding**2 > ROUNDED * sound > 0.0 else rows.white

    def is_judged(self, rows: Rows) -> bool:
        """Whether what is left over of some rows tells anything: it is known what a sound machine leaves there."""
        return not rows.rough and (self.null is None or (rows.equation, rows.kind) in self.null.unrest)

    def tells_nothing_of(self, parameter: str) -> bool:
        """Whether these runs cannot tell a parameter of the model: sound machines move it, or no fit may."""
        return parameter in self.unidentifiable or self.priors.get(parameter) == PINNED

    def floor(self, candidate: Candidate) -> float:
        """Size below which one form of an effect is model error, or too small to be one.

        Sound machines show it in the form next to it. What they cannot show, since one author wrote them and the
        equations, is left out of account up to a small share of the smallest size worth knowing.
        """
        effect, form = candidate
        shown, least = self.by_form.get(effect), NEGLIGIBLE * self.worth_knowing.get(effect, 0.0)
        if not shown:
            return least
        return max(least, shown[nearest(self.forms[effect], form) if len(shown) > 1 else 0])

    def add(self, candidates: Sequence[Candidate]) -> None:
        """Take further forms of effects into the regression."""
        fresh = [c for c in candidates if c not in self.candidates]
        if not fresh:
            return
        self.candidates += fresh
        for built, made in self._made:
            for rows, columns in zip(made, effect_columns(built, fresh), strict=True):
                more_columns(rows, columns)
        self.stack = stack(self._rows(), self.priors)

    @property
    def weights(self) -> list[float]:
        """Of each rows: one over its noise variance, for as many rows as are independent."""
        return [
            1.0 / (rows.noise**2 * max(rows.dependence, len(rows.left_over) / rows.levels)) for rows in self.stack.rows
        ]

    def normal(self) -> Normal:
        """Normal equations under the present weights."""
        return Normal(self.stack, self.weights)

    def weigh(self, fit: Fit) -> None:
        """Take noise and dependence from what a fit leaves over."""
        pools: dict[tuple[str, str], list[tuple[Array, Rows]]] = {}
        for index, rows in enumerate(self.stack.rows):
            pools.setdefault((rows.equation, rows.kind), []).append((residuals(self.stack, fit, index), rows))
        for pool in pools.values():
            noise = float(np.sqrt(np.mean(np.concatenate([left for left, _ in pool]) ** 2)))
            dependence = float(np.mean([rows_per_independent(left, rows.memory) for left, rows in pool]))
            for _, rows in pool:
                rows.noise, rows.dependence = max(noise, 1e-12), dependence

    def unrest(self) -> dict[tuple[str, str], float]:
        """Power under the present noise over that from row to row, as many rows as count for one; by equation and kind.

        Where every row is right but for noise it is about one.
        """
        return self._mean_of(lambda rows: (rows.noise / rows.white) ** 2 * rows.dependence)

    def white(self) -> dict[tuple[str, str], float]:
        """Variance of the rows' noise from one to the next, by equation and run."""
        return {(rows.equation, rows.run): rows.white**2 for rows in self.stack.rows}

    def left(self) -> dict[tuple[str, str], float]:
        """Variance of rows under the present noise, times as many rows as count for one; by equation and kind."""
        return self._mean_of(lambda rows: rows.noise**2 * rows.dependence)

    def _mean_of(self, of_rows: Callable[[Rows], float]) -> dict[tuple[str, str], float]:
        by_kind: dict[tuple[str, str], list[float]] = {}
        for rows in self.stack.rows:
            by_kind.setdefault((rows.equation, rows.kind), []).append(of_rows(rows))
        return {key: float(np.mean(values)) for key, values in by_kind.items()}

    def stamping(self, fit: Fit) -> dict[str, Array]:
        """By equation whose channels' stamps are not told: weights of neighbouring samples that a fit gives them."""
        return {equation: weights for equation, (weights, _) in stamping(self.stack, fit).items()}

    def settle(self, hypothesis: Sequence[Candidate], rounds: int = 2) -> Fit:
        """Fit a hypothesis and the noise it leaves, by turns."""
        # begin as if the hypothesis were right: from the noise that another left, a fit may not find the way
        self.weigh_as_usual()
        fit = self.normal().fit(hypothesis)
        for _ in range(rounds):
            self.weigh(fit)
            fit = self.normal().fit(hypothesis)
        return fit

    def surprise(self) -> float:
        """Twice the negative log likelihood under the present noise, up to a constant: small where all is explained."""
        total = 0.0
        for rows in self.stack.rows:
            total += len(rows.left_over) / rows.dependence * np.log(rows.noise**2)
        return float(total)

    def columns(self, candidate: Candidate) -> npt.NDArray[np.intp]:
        """Where the columns of one form of an effect stand; empty where no run shows it."""
        form = ("effect", candidate[0], repr(candidate[1]))
        places = [place for name, place in self.stack.place.items() if name[:3] == form]
        return np.asarray(sorted(places), np.intp)

    def coefficient(self, place: int) -> str:
        """Name of the coefficient of an effect's column."""
        name: Column = self.stack.names[place]
        return name[3]


def rows_per_independent(left: Array, memory: int = MEMORY) -> float:
    """How many neighbouring rows carry the information of one, from their autocorrelation (Bartlett, 1946).

    memory : rows, within which one may depend on another.
    """
    left = left - left.mean()
    power = float(left @ left)
    if power == 0.0 or len(left) < 8:
        return 1.0
    longest = min(memory, len(left) // 4)
    total = 1.0
    for lag in range(1, longest):
        if lag == FEW_LAGS:  # beyond a few, all at once costs less than one by one
            rest = correlations(left, longest)[lag:] / power
            ends = np.flatnonzero(rest <= NO_CORRELATION)
            return max(total + 2.0 * float(rest[: ends[0] if len(ends) else None].sum()), 1.0)
        correlation = float(left[lag:] @ left[:-lag]) / power
        if correlation <= NO_CORRELATION:
            break
        total += 2.0 * correlation
    return max(total, 1.0)


def correlations(values: Array, lags: int) -> Array:
    """Sums of products with what comes so many rows later, from none on."""
    size = next_fast_len(len(values) + lags, real=True)
    spectrum = rfft(values, size)
    return np.asarray(irfft(spectrum * np.conj(spectrum), size)[:lags], np.float64)


def unscaled(names: set[str]) -> bool:
    """Whether torques are balanced against each other alone: zero of everything would satisfy that too."""
    return "voltage" not in names and "axis_torque" not in names and any(name.endswith("_torque") for name in names)


def forms_here(records: Sequence[Record], model: Model) -> dict[str, list[Form]]:
    """Forms of every effect that a model of this kind can lack, at the scales of the machine and these runs."""
    own = form_scales(records, model)
    return {effect.name: effect.forms_at(own) for effect in library().values() if effect.applies(model)}


def nearest(forms: Sequence[Form], form: Form) -> int:
    """Which of several forms lies next to one, by the ratios of their numbers."""
    apart = [
        sum(abs(a - b) / max(abs(a) + abs(b), 1e-300) for a, b in zip(other, form, strict=True)) for other in forms
    ]
    return int(np.argmin(apart))


def every_form(forms: Mapping[str, Sequence[Form]]) -> list[Candidate]:
    """Every form of every effect that does not wait for an order to be found."""
    return [(name, form) for name, several in forms.items() if not library()[name].periodic for form in several]
