"""What is not explained, described: what it depends on, how much of it a function of state closes, what comes nearest.

The equation that is farthest from what a sound machine leaves is looked at. A free additive function of the logged
state is learnt on the fitted runs and tried on the held-out ones; what it leaves is tried for a slow change with time,
and for a frequency by which it repeats.
"""

from collections.abc import Collection, Sequence

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.gap.diagnosis import Near, Picture, Rest
from leactl.gap.search.angle_periodogram import periodogram, turns
from leactl.gap.search.confirm import transferred
from leactl.gap.search.evidence import Evidence
from leactl.gap.search.regression import Candidate, Fit, Rows, Stack, residuals
from leactl.gap.search.sets import ENTRY, EffectSet, FurtherEffect
from leactl.gap.signals.effect_variables import state_in
from leactl.gap.signals.record import Record
from leactl.gap.verdict.decision import NAMED
from leactl.gap.verdict.judge import HALF, Channel, Judged, presence
from leactl.gap.verdict.picture import Part, channel_of, picture_of, view_of
from leactl.gap.verdict.residual_frequency import ResidualCourse, gains, strongest_frequency
from leactl.gap.verdict.state_regression import SURE, Function, Groups, Sample, borne_out, certainty, learn, slow_gain
from leactl.protocol import protocolfile, shipped
from leactl.vocabulary.effect import effect_definition
from leactl.vocabulary.variable import Variable

Array = npt.NDArray[np.float64]
STRETCHES = 24  # of a run
FEWEST = 4  # rows in a stretch, below which a run says nothing
LOW_ORDERS, STRONG_ORDERS, HIGHEST = 6, 4, 250  # of an angle: the first few, the strongest, and the last one tried
LEAST_CLOSED = 0.05  # of the gap, below which nothing is said to depend
VISIBLE = 1.0  # times its uncertainty and floor, from which on an effect is near at all
NEAREST = 4  # effects that are listed
LEAST_SLOW = 0.2  # of the gap, that neighbouring stretches or one sine must explain for it to be one of time


def describe(
    evidence: Evidence,
    standing: Sequence[Candidate],
    channel: Channel | None,
    held_out: Sequence[Record],
    nearest: Sequence[Near],
) -> Rest | None:
    """Describe what a set leaves over of one channel; None where no equation of the held-out runs has it.

    Parameters
    ----------
    evidence : of the fitted runs.
    standing : effects of the augmented model.
    channel : equation, quantity and set-up that are farthest from a sound machine's.
    """
    others = evidence.on(held_out, standing)
    fit = evidence.settle(standing)
    here = of_channel(evidence.stack, channel)
    there = of_channel(others.stack, channel)
    if not here or not there:
        return None
    others.settle(standing)
    fitted = sample_of(evidence.stack, fit, here)
    tried = sample_of(others.stack, transferred(others.normal(), evidence, fit), there)
    common = fitted.state.keys() & tried.state.keys()
    fitted, tried = (
        Sample(one.left, {name: one.state[name] for name in common}, one.stretch) for one in (fitted, tried)
    )
    orders = orders_of(evidence.stack, fit, here)
    trial, chosen, ridge = learn(fitted, orders, beyond_noise(evidence.stack, here, fitted))
    kept = borne_out(trial, chosen, ridge, tried)
    free = trial.function(kept, ridge)
    gap = beyond_noise(others.stack, there, tried)
    closable, after = closed_share(tried, free, trial.function([], ridge), gap)
    variables = free.variables if closable is not None and closable >= LEAST_CLOSED else ()
    rest = after if variables else tried.left
    known = free.of(fitted) if variables else 0.0
    slow = is_slow(rest, tried, gap)
    learnt = courses(evidence.stack, here, fitted.left - known, fitted.stretch)
    tone = None if slow else tone_of(learnt, courses(others.stack, there, rest, tried.stretch), gap)
    depends_on = (*variables, "time") if slow or tone else variables
    rows = others.stack.rows[there[0]]
    touching = {name[1] for index in here for name in evidence.stack.rows[index].columns if name[0] == "effect"}
    near = tuple(one for one in nearest if one.effect in touching)[:NEAREST]
    shapes = [shape(rows, tried, free, name) for name in variables if name in tried.state]
    return Rest(
        depends_on,
        tone,
        closable,
        rows.quantity,
        rows.role,
        rows.mechanical,
        rows.equation,
        tuple(one for one in shapes if one is not None),
        near,
        deciding(depends_on, near, touching),
    )


def of_channel(stacked: Stack, channel: Channel | None) -> list[int]:
    """Rows of an equation in a set-up."""
    keys = [(rows.equation, rows.quantity, rows.mechanical) for rows in stacked.rows]
    return [
        index
        for index, key in enumerate(keys)
        if key == channel and len(stacked.rows[index].index) >= FEWEST * STRETCHES
    ]


def sample_of(stacked: Stack, fit: Fit, indices: Sequence[int]) -> Sample:
    """What a fit leaves over of some rows, with the state; stretches of two runs are no neighbours."""
    several = [stacked.rows[index] for index in indices]
    states = [state_in(rows.equation, rows.signals) for rows in several]
    state = {
        name: np.concatenate([one[name][rows.index] for one, rows in zip(states, several, strict=True)])
        for name in states[0]
        if all(name in one for one in states)
    }
    stretch = [
        run * (STRETCHES + 1) + np.arange(len(rows.index)) * STRETCHES // len(rows.index)
        for run, rows in enumerate(several)
    ]
    left = np.concatenate([residuals(stacked, fit, index) for index in indices])
    return Sample(left, state, np.concatenate(stretch))


def beyond_noise(stacked: Stack, indices: Sequence[int], sample: Sample) -> float:
    """Squares beyond what changes from one row to the next by noise."""
    white = sum(len(stacked.rows[index].left_over) * stacked.rows[index].white ** 2 for index in indices)
    return max(float(np.sum(sample.left**2)) - white, 0.0)


def orders_of(stacked: Stack, fit: Fit, indices: Sequence[int]) -> list[float]:
    """Orders of the angle that a function may have: the first few, and the strongest of a periodogram."""
    power = np.zeros(HIGHEST + 1)
    for index in indices:
        rows = stacked.rows[index]
        if turns(rows, "drag") and rows.signals.velocity is not None:
            power += periodogram(rows, residuals(stacked, fit, index), "drag", HIGHEST)
    strongest = [float(order) for order in np.argsort(-power)[:STRONG_ORDERS] if power[order] > 0.0]
    return sorted({float(order) for order in range(1, LOW_ORDERS + 1)} | set(strongest))


def closed_share(sample: Sample, free: Function, constant: Function, gap: float) -> tuple[float | None, Array]:
    """Share of a gap that a function closes on runs that it was not learnt on, and what it leaves over."""
    after = sample.left - free.of(sample)
    if gap <= 0.0:
        return None, after
    gained = float(np.sum((sample.left - constant.of(sample)) ** 2 - after**2))
    return min(max(gained / gap, 0.0), 1.0), after


def is_slow(left: Array, sample: Sample, gap: float) -> bool:
    """Whether stretches of a run are like their neighbours beyond what the state explains."""
    gained = slow_gain(left, sample.stretch)
    return float(gained.sum()) > LEAST_SLOW * gap > 0.0 and certainty(gained, sample.stretch) >= SURE


def courses(stacked: Stack, indices: Sequence[int], left: Array, stretch: Groups) -> list[ResidualCourse]:
    """What is left over of some rows, run by run over time."""
    several = [stacked.rows[index] for index in indices]
    ends = np.cumsum([len(rows.index) for rows in several])[:-1]
    parts = zip(several, np.split(left, ends), np.split(stretch, ends), strict=True)
    return [ResidualCourse(rows.signals.time[rows.index], own, place) for rows, own, place in parts]


def tone_of(fitted: Sequence[ResidualCourse], held_out: Sequence[ResidualCourse], gap: float) -> float | None:
    """The frequency by which what is left over repeats, on held-out runs too [Hz]; None where it does not."""
    frequency = strongest_frequency(fitted)
    if frequency is None:
        return None
    gained = np.concatenate([gains(course, frequency) for course in held_out])
    stretch = np.concatenate([course.stretch for course in held_out])
    repeats = float(gained.sum()) > LEAST_SLOW * gap > 0.0 and certainty(gained, stretch) >= SURE
    return frequency if repeats else None


def shape(rows: Rows, sample: Sample, free: Function, name: Variable) -> Picture | None:
    """The rest over one variable, before and after the whole function."""
    part = free.of(sample)
    independent = len(sample) / rows.dependence
    after = sample.left - part
    gain = float(np.sum(sample.left**2 - after**2))
    periods = free.strongest_order() if name == "angle" else 1.0
    whole = Part(channel_of(rows), sample.left, after, part, sample.stretch, dict(sample.state), independent, gain)
    view = view_of(whole, [name], periods)
    return None if view is None else picture_of(view)


def deciding(depends_on: Sequence[str], nearest: Sequence[Near], touching: Collection[str]) -> str | None:
    """The shipped protocol that separates most of what comes into question, the shortest of several.

    In question are the nearest effects and those of the channel that act in what it depends on.
    """
    near = {one.effect for one in nearest}
    acting = {name for name in touching if set(effect_definition(name).acts_over) & set(depends_on)}
    plans = [protocolfile.load(name) for name in shipped.names()]
    best = max(
        plans,
        key=lambda plan: (
            *(len(among.intersection(plan.separates)) for among in (near | acting, near)),
            -plan.duration_s,
        ),
    )
    return best.name if (near | acting).intersection(best.separates) else None


def nearest_effects(result: EffectSet, judged: Sequence[Judged], refused: Sequence[Near]) -> tuple[Near, ...]:
    """Effects that were refused, the nearest first: fitted and taken back, fitted and doubted, not entered."""
    near = {one.effect: one for one in refused}
    for item in judged:
        if item.probability < NAMED and item.finding.effect not in near:
            near[item.finding.effect] = Near(item.finding.effect, doubt(item))
    for further in sorted(result.rest, key=lambda one: -one.height):
        if further.effect not in near and further.height > VISIBLE:
            near[further.effect] = Near(further.effect, kept_out(further))
    return tuple(near.values())


def doubt(item: Judged) -> str:
    """Why an effect that was fitted is not named."""
    needed = library()[item.finding.effect].explains
    if item.explained < needed:
        shares = f"{100 * item.explained:.0f} % of the gap where it acts; a form of it explains {100 * needed:.0f} %"
        return f"the set explains {shares} or more"
    if presence(item.finding.height) < NAMED:
        return f"its size is {item.finding.height:.3g} times its uncertainty and floor; even odds need {HALF:g}"
    if item.rivals:
        return f"{item.rivals[0][0].effect} explains as much"
    return "held-out runs do not bear it out"


def kept_out(item: FurtherEffect) -> str:
    """Why an effect did not enter the set."""
    if item.height <= ENTRY:
        return f"its size is {item.height:.3g} times its uncertainty and floor; {ENTRY:g} are needed"
    return "what it takes away is no more than the set's own forms may miss"
