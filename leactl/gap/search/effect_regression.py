"""One regression over runs and a nominal model, with the columns of every effect, and its weights.

Noise is estimated from the residuals of a hypothesis, pooled over runs of one kind. Correlated rows count for less, so
that no number of samples makes up for a model that is only roughly right.
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
from leactl.gap.equations.contract import MEMORY_ROWS
from leactl.gap.search.angle_periodogram import strongest_orders
from leactl.gap.search.regression import (
    Candidate,
    Column,
    Fit,
    Normal,
    Rows,
    Stack,
    add_columns,
    effect_columns,
    make_rows,
    residuals,
    stack,
    without_model_columns,
)
from leactl.gap.search.stamp_fit import overdue_equations, put_on_time, stamp_weights
from leactl.gap.signals.record import Record
from leactl.gap.signals.scales import angle_bounds, form_scales, widest_angle_range, worth_knowing
from leactl.gap.signals.stamps import lateness_of
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
    # a feedforward is a fit: its parameters absorb what it leaves out, and may be off by as much as their value
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
# effects that cannot be fitted where no equation but torque balances determines the scale of torques
UNDETERMINED_GAINS = ("torque_sensor_gain", "current_sensor_gain")
# without any of these equations the torque constant is held
TORQUE_SENSOR_EQUATIONS = {"coupled_torque", "locked_torque", "swung_torque"}
MOST_PRIOR_CHANGE = 1.0  # largest change of an identifiable parameter in fits to sound machines, over its prior
BIAS_DOUBT_SHARE = 0.2  # share of a bias common to sound machines that remains uncertain once it is corrected
MOST_CORRECTED_BIAS = 0.3  # relative; with a larger bias the runs hardly show a parameter, and nothing is corrected
PINNED_PRIOR = 1e-4  # prior relative change of a parameter that every fit holds at the model's value
LEAST_ROUNDING_SHARE = 0.5  # share of rounding in a sound machine's noise power above which that noise counts as known
NEGLIGIBLE_SHARE = 0.05  # share of the smallest size worth knowing below which an effect counts as absent
LEAST_CORRELATION = 0.02  # the sum over an autocorrelation ends at the first smaller value
DIRECT_LAGS = 6  # lags whose correlations are computed one by one; beyond them by one transform for all
ORDERS_TRIED = 3  # orders added for each periodic effect


@dataclass(frozen=True)
class Null:
    """Values fitted to sound machines, which have no effect: floors of effects, equations and parameters."""

    unrest: Mapping[tuple[str, str], float]  # by equation and kind of run
    residual_variances: Mapping[tuple[str, str], float]  # by equation and kind: times rows per independent row
    noise_variances: Mapping[tuple[str, str], float]  # by equation and run: variance of the noise from row to row
    floors: Mapping[str, Sequence[float]]  # by effect: its fitted size in each form, in units of its leading parameter
    common_sizes: Mapping[str, Sequence[float]]  # sizes that all machines have in common; empty for one machine
    errors: Mapping[str, Sequence[float]]  # standard errors of the sizes
    lines: Mapping[tuple[str, str, str], float]  # height of the highest line in the residuals of each channel
    parameter_changes: Mapping[str, tuple[float, float]]  # by parameter: mean and scatter of its relative change
    unidentifiable: tuple[str, ...]  # parameters that these runs do not determine
    held_parameters: tuple[str, ...]  # unidentifiable parameters that every fit holds

    def bias(self, parameter: str) -> float:
        """Return the mean relative change of a parameter in sound machines; zero above `MOST_CORRECTED_BIAS`."""
        bias = self.parameter_changes.get(parameter, (0.0, 0.0))[0]
        return bias if abs(bias) <= MOST_CORRECTED_BIAS else 0.0

    def doubt(self, parameter: str) -> float:
        """Return the standard deviation of a parameter's relative change once its bias is corrected."""
        return bias_error(*self.parameter_changes.get(parameter, (0.0, 0.0)))


def bias_error(bias: float, scatter: float) -> float:
    """Return the uncertainty of a relative change from a bias, which is corrected where small enough, and a scatter."""
    return math.hypot(BIAS_DOUBT_SHARE * bias if abs(bias) <= MOST_CORRECTED_BIAS else bias, scatter)


class Evidence:
    """All equations of all runs as one regression, with the weights that a hypothesis gives them."""

    def __init__(
        self,
        records: Sequence[Record],
        model: Model,
        only: Sequence[Candidate] | None = None,
        held_parameters: Sequence[str] = (),
        on_time: Sequence[str] | None = None,
    ) -> None:
        self.model, self.records = model, list(records)
        self.null: Null | None = None
        self.worth_knowing = worth_knowing(records, model)  # smallest relevant size by effect
        self.by_form: dict[str, Sequence[float]] = {}  # floors of each effect by form, from sound machines
        self.lines: Mapping[tuple[str, str, str], float] = {}
        # parameters that every fit holds at the model's value, and parameters that the runs do not determine
        self.held_parameters, self.unidentifiable = tuple(held_parameters), tuple[str, ...]()
        self.forms, self.travel = forms_at_scales(records, model), widest_angle_range(records)
        self.visited = angle_bounds(records)
        self.form_spread: dict[Candidate, npt.NDArray[np.float64]] = {}  # covariance of the logarithms of refined forms
        self.candidates: list[Candidate] = list(only) if only is not None else every_form(self.forms)
        self._by_run: list[tuple[list[Equation], list[Rows]]] = []  # equations, and the rows of each
        for record in records:
            equations_of_run = equations(record, model)
            rows = make_rows(record.run, record.kind, equations_of_run, self.candidates)
            equations_with_rows = [
                (without_model_columns(equation), rows_of_equation)
                for equation, rows_of_equation in zip(equations_of_run, rows, strict=True)
                if rows_of_equation is not None
            ]
            self._by_run.append(
                (
                    [equation for equation, _ in equations_with_rows],
                    [rows_of_equation for _, rows_of_equation in equations_with_rows],
                )
            )
        all_rows = self._rows()
        self.priors = dict(PRIORS)
        equation_names = {rows.equation for rows in all_rows}
        if lacks_scale(equation_names) and not self.model.load.level_torque:  # a known weight is a scale
            self.candidates = [c for c in self.candidates if c[0] not in UNDETERMINED_GAINS]
            if not equation_names & TORQUE_SENSOR_EQUATIONS:
                self.priors["torque_constant"] = PINNED_PRIOR
        self.priors.update(dict.fromkeys(self.held_parameters, PINNED_PRIOR))
        self.stack: Stack = stack(all_rows, self.priors)
        self.weigh_as_usual()
        if on_time is None:
            on_time = overdue_equations(self.stack, self.settle([])) if all_rows else ()
        self.on_time = tuple(on_time)  # equations with a delay beyond what stamps can explain
        if self.on_time:
            put_on_time(self.stack.rows, self.on_time)
            self.stack = stack(self.stack.rows, self.priors)
        if only is None and all_rows:
            self.add(strongest_orders(self.stack, self.settle([]), self.weights, ORDERS_TRIED))

    def _rows(self) -> list[Rows]:
        """Return the rows of all runs."""
        return [rows for _, rows_of_run in self._by_run for rows in rows_of_run]

    def weigh_as_usual(self, sound_noise: bool = False) -> None:
        """Set the usual weights: noise from row to row, and the dependence of a sound model's residuals.

        sound_noise : whether the noise is a sound machine's where that is lower.
        """
        for rows in self.stack.rows:
            rows.noise = self.white_noise_of(rows) if sound_noise else rows.white_noise
            rows.dependence = self.expected_unrest(rows, rows.noise)

    def compare_with(self, null: Null) -> None:
        """Set floors, lines and held parameters from the null of these runs, then the usual weights."""
        self.null, self.lines = null, null.lines
        self.by_form = {
            effect: self.floors_of(effect, sizes, null.common_sizes.get(effect, ()))
            for effect, sizes in null.floors.items()
        }
        self.held_parameters, self.unidentifiable = null.held_parameters, null.unidentifiable
        self.priors.update(dict.fromkeys(self.held_parameters, PINNED_PRIOR))
        self.stack = stack(self._rows(), self.priors)
        self.weigh_as_usual()

    def floors_of(self, effect: str, sizes: Sequence[float], common_sizes: Sequence[float] = ()) -> list[float]:
        """Return the floors of an effect by form: the sizes, raised to those that sound machines have in common.

        A form that some sound machine does not show gets the floor of the nearest form that all of them show.
        """
        assert self.null is not None
        forms, common_sizes = self.forms.get(effect, ()), common_sizes or [0.0] * len(sizes)
        # a periodic effect has one floor for all orders
        if len(forms) != len(sizes) or len(common_sizes) != len(sizes):
            return list(sizes)
        floors = [max(pair) for pair in zip(sizes, common_sizes, strict=True)]
        shown_indices = [index for index, error in enumerate(self.null.errors[effect]) if error < math.inf]
        if not shown_indices:
            return floors
        shown_forms = [forms[index] for index in shown_indices]
        return [
            floor if index in shown_indices else floors[shown_indices[nearest_form(shown_forms, forms[index])]]
            for index, floor in enumerate(floors)
        ]

    def on(self, records: Sequence[Record], hypothesis: Sequence[Candidate], model: Model | None = None) -> "Evidence":
        """Return the evidence of other runs for some effects, with floors, forms and held parameters of this evidence.

        model : model about which the columns are taken; by default that of this evidence.
        """
        evidence = Evidence(
            records, model or self.model, only=hypothesis, held_parameters=self.held_parameters, on_time=self.on_time
        )
        if self.null is not None:
            evidence.compare_with(self.null)
        evidence.forms, evidence.by_form, evidence.worth_knowing = self.forms, self.by_form, self.worth_knowing
        evidence.form_spread = dict(self.form_spread)
        return evidence

    def expected_unrest(self, rows: Rows, white_noise: float | None = None) -> float:
        """Return the unrest that a sound machine has in some rows, at least one.

        The null holds it as a ratio to the noise of sound machines from row to row, and as a variance: in a case with
        less noise, model errors of the same size stand out more.

        white_noise : standard deviation from row to row that the unrest is relative to; by default that of the rows.
        """
        if self.null is None:
            return 1.0
        key = rows.equation, rows.kind
        return max(
            1.0,
            self.null.unrest.get(key, 0.0),
            self.null.residual_variances.get(key, 0.0) / (white_noise or rows.white_noise) ** 2,
        )

    def white_noise_of(self, rows: Rows) -> float:
        """Return the standard deviation of the noise from row to row.

        Where rounding makes most of a sound machine's noise, it is at most that noise.

        A residual that swings within a few rows passes for noise. Only the noise of rounding is known in advance: where
        other noise prevails, the noise of the rows counts.
        """
        sound_variance = self.null.noise_variances.get((rows.equation, rows.run), 0.0) if self.null is not None else 0.0
        return (
            min(rows.white_noise, math.sqrt(sound_variance))
            if rows.rounding**2 > LEAST_ROUNDING_SHARE * sound_variance > 0.0
            else rows.white_noise
        )

    def is_judged(self, rows: Rows) -> bool:
        """Return whether the residual of some rows can be judged, since a sound machine's residual there is known."""
        return not rows.rough and (self.null is None or (rows.equation, rows.kind) in self.null.unrest)

    def tells_nothing_of(self, parameter: str) -> bool:
        """Return whether these runs do not determine a parameter of the model, or every fit holds it."""
        return parameter in self.unidentifiable or self.priors.get(parameter) == PINNED_PRIOR

    def floor(self, candidate: Candidate) -> float:
        """Return the size below which one form of an effect is model error, or negligible.

        It is the floor of the nearest form, at least `NEGLIGIBLE_SHARE` of the smallest size worth knowing: sound
        machines cannot show errors that they share with the equations.
        """
        effect, form = candidate
        floors, least_floor = self.by_form.get(effect), NEGLIGIBLE_SHARE * self.worth_knowing.get(effect, 0.0)
        if not floors:
            return least_floor
        return max(least_floor, floors[nearest_form(self.forms[effect], form) if len(floors) > 1 else 0])

    def add(self, candidates: Sequence[Candidate]) -> None:
        """Add forms of effects to the regression, unless it has them."""
        further = [candidate for candidate in candidates if candidate not in self.candidates]
        if not further:
            return
        self.candidates += further
        for equations_of_run, rows_of_run in self._by_run:
            for rows, columns in zip(rows_of_run, effect_columns(equations_of_run, further), strict=True):
                add_columns(rows, columns)
        self.stack = stack(self._rows(), self.priors)

    @property
    def weights(self) -> list[float]:
        """Weight of each group of rows: one over its noise variance, less the more rows depend on each other."""
        return [
            1.0 / (rows.noise**2 * max(rows.dependence, len(rows.left_over) / rows.levels)) for rows in self.stack.rows
        ]

    def normal(self) -> Normal:
        """Return the normal equations under the present weights."""
        return Normal(self.stack, self.weights)

    def weigh(self, fit: Fit) -> None:
        """Estimate noise and dependence of the rows from the residuals of a fit, pooled by equation and kind of run."""
        pools: dict[tuple[str, str], list[tuple[Array, Rows]]] = {}
        for index, rows in enumerate(self.stack.rows):
            pools.setdefault((rows.equation, rows.kind), []).append((residuals(self.stack, fit, index), rows))
        for pool in pools.values():
            noise = float(np.sqrt(np.mean(np.concatenate([residual for residual, _ in pool]) ** 2)))
            dependence = float(np.mean([rows_per_independent(residual, rows.memory) for residual, rows in pool]))
            for _, rows in pool:
                rows.noise, rows.dependence = max(noise, 1e-12), dependence

    def unrest(self) -> dict[tuple[str, str], float]:
        """Return the unrest by equation and kind: residual power over row-to-row noise power, times the dependence.

        It is about one where white noise makes all of the residual. Both powers are means over the runs: the ratio of a
        run with little noise of its own, such as a slow ramp, says nothing of the others.
        """
        white_variances = self._mean_by_kind(lambda rows: rows.white_noise**2)
        return {key: variance / white_variances[key] for key, variance in self.residual_variances().items()}

    def noise_variances(self) -> dict[tuple[str, str], float]:
        """Return the variance of the noise from row to row, by equation and run."""
        return {(rows.equation, rows.run): rows.white_noise**2 for rows in self.stack.rows}

    def residual_variances(self) -> dict[tuple[str, str], float]:
        """Return the residual variance times the rows per independent row, by equation and kind."""
        return self._mean_by_kind(lambda rows: rows.noise**2 * rows.dependence)

    def _mean_by_kind(self, figure_of: Callable[[Rows], float]) -> dict[tuple[str, str], float]:
        """Return the mean of a figure of the rows, by equation and kind of run."""
        figures: dict[tuple[str, str], list[float]] = {}
        for rows in self.stack.rows:
            figures.setdefault((rows.equation, rows.kind), []).append(figure_of(rows))
        return {key: float(np.mean(values)) for key, values in figures.items()}

    def lateness(self, fit: Fit) -> dict[str, float]:
        """Return by how many samples one side is later than the other, by equation with stamps of unknown meaning."""
        return {equation: lateness_of(weights) for equation, (weights, _) in stamp_weights(self.stack, fit).items()}

    def settle(self, hypothesis: Sequence[Candidate], rounds: int = 2) -> Fit:
        """Return the fit of a hypothesis, with the noise estimated from its residuals; the rows keep that noise.

        rounds : rounds of estimating the noise and fitting again; with 0 the usual noise counts.
        """
        # starting from the noise of another hypothesis, a fit may not find the solution
        self.weigh_as_usual()
        fit = self.normal().fit(hypothesis)
        for _ in range(rounds):
            self.weigh(fit)
            fit = self.normal().fit(hypothesis)
        return fit

    def deviance(self) -> float:
        """Return twice the negative log likelihood under the present noise, up to a constant."""
        total = 0.0
        for rows in self.stack.rows:
            total += len(rows.left_over) / rows.dependence * np.log(rows.noise**2)
        return float(total)

    def columns(self, candidate: Candidate) -> npt.NDArray[np.intp]:
        """Return the positions of the columns of one form of an effect; empty where no run shows it."""
        effect_and_form = ("effect", candidate[0], repr(candidate[1]))
        positions = [position for name, position in self.stack.position_of.items() if name[:3] == effect_and_form]
        return np.asarray(sorted(positions), np.intp)

    def coefficient(self, column: int) -> str:
        """Return the name of the coefficient of an effect's column."""
        name: Column = self.stack.names[column]
        return name[3]


def rows_per_independent(residual: Array, memory: int = MEMORY_ROWS) -> float:
    """Return the number of rows per independent row, from their autocorrelation (Bartlett, 1946).

    memory : rows within which one may depend on another.
    """
    residual = residual - residual.mean()
    power = float(residual @ residual)
    if power == 0.0 or len(residual) < 8:
        return 1.0
    longest_lag = min(memory, len(residual) // 4)
    correlation_sum = 1.0
    for lag in range(1, longest_lag):
        if lag == DIRECT_LAGS:  # beyond a few lags, one transform for all costs less
            later_correlations = correlations(residual, longest_lag)[lag:] / power
            ends_of_sum = np.flatnonzero(later_correlations <= LEAST_CORRELATION)
            return max(
                correlation_sum + 2.0 * float(later_correlations[: ends_of_sum[0] if len(ends_of_sum) else None].sum()),
                1.0,
            )
        correlation = float(residual[lag:] @ residual[:-lag]) / power
        if correlation <= LEAST_CORRELATION:
            break
        correlation_sum += 2.0 * correlation
    return max(correlation_sum, 1.0)


def correlations(values: Array, lags: int) -> Array:
    """Return the autocorrelation sums of values at lags 0 to `lags` - 1."""
    size = next_fast_len(len(values) + lags, real=True)
    spectrum = rfft(values, size)
    return np.asarray(irfft(spectrum * np.conj(spectrum), size)[:lags], np.float64)


def lacks_scale(equation_names: set[str]) -> bool:
    """Return whether the equations only balance torques against each other: torques of zero would satisfy them."""
    return (
        "voltage" not in equation_names
        and "axis_torque" not in equation_names
        and any(name.endswith("_torque") for name in equation_names)
    )


def forms_at_scales(records: Sequence[Record], model: Model) -> dict[str, list[Form]]:
    """Return the forms of every effect that applies to a model, at the scales of the machine and these runs."""
    scales = form_scales(records, model)
    return {effect.name: effect.forms_at(scales) for effect in library().values() if effect.applies(model)}


def nearest_form(forms: Sequence[Form], form: Form) -> int:
    """Return the index of the form that is nearest to `form` by the relative differences of their numbers."""
    distances = [
        sum(abs(a - b) / max(abs(a) + abs(b), 1e-300) for a, b in zip(other, form, strict=True)) for other in forms
    ]
    return int(np.argmin(distances))


def every_form(forms: Mapping[str, Sequence[Form]]) -> list[Candidate]:
    """Return every form of every effect that is not periodic; orders are searched by a periodogram."""
    return [
        (name, form)
        for name, forms_of_effect in forms.items()
        if not library()[name].periodic
        for form in forms_of_effect
    ]
