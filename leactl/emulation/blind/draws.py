"""Draw a case: its bench, its effects and their strengths, and its runs with their references and temperatures."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from leactl import yamlfile
from leactl.emulation.blind.bases import Base, draw_base
from leactl.emulation.blind.programs import PROGRAM_DRAWS, RUN_KINDS, SETUPS, heating
from leactl.emulation.plant.effects import make_effect
from leactl.emulation.plant.effects.contract import PlantEffect
from leactl.emulation.plant.effects_outside_library import unlisted_effects
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted
from leactl.emulation.plant.stepped.lanes import Array, Lane
from leactl.emulation.plant.stepped.sensors import Spread
from leactl.emulation.plant.stepped.simulation import DriveReferences
from leactl.vocabulary.effect import effect_definition, effects_on

Generator = np.random.Generator
STRENGTHS = {
    "faint": (0.0, 0.2),
    "plain": (0.4, 0.65),
    "strong": (0.8, 1.0),
}  # position between faint (0) and strong (1) of strengths.yaml
REPEATS = ("a", "b")


@dataclass(frozen=True)
class PlantedEffect:
    """One effect of a case."""

    name: str
    strength: str
    effect: PlantEffect
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class RunDraw:
    """One run of a case: its bench and temperatures at the start, and its references."""

    name: str  # kind and repeat, as locked_staircase-a
    kind: str
    lane: Lane
    program: DriveReferences | Array  # an array is the current of a heated run
    seed: int


@dataclass(frozen=True)
class BlindCase:
    """One bench, its departures from the nominal model, and its ten runs."""

    name: str
    kind: str
    effects: tuple[PlantedEffect, ...]
    base: Base
    spread: Spread
    runs: tuple[RunDraw, ...]


def draw_case(draw: Generator, name: str, kind: str, effects: Sequence[str], strength: str) -> BlindCase:
    """Draw all parts of a case.

    Parameters
    ----------
    effects : identifiers of none, one or two effects; for the kind `unknown`, the name of one outside the vocabulary.
    strength : faint, plain or strong.
    """
    unlisted = unlisted_effects()
    planted_effects = tuple(
        _draw_unlisted(draw, effect, strength) if effect in unlisted else draw_effect(draw, effect, strength)
        for effect in sorted(effects)
    )
    nominal_coefficient = 0.0 if "resistance_temperature" in effects or draw.random() < 0.15 else 0.004
    base = draw_base(draw, nominal_coefficient)
    spread = _draw_spread(draw)
    first_is_warm = {run: bool(draw.random() < 0.35) for run in RUN_KINDS}  # of the two runs of a kind, one starts warm
    runs = tuple(
        _draw_run(draw, f"{run}-{repeat}", run, first_is_warm[run] == (repeat == "a"), base, spread, planted_effects)
        for run in RUN_KINDS
        for repeat in REPEATS
    )
    return BlindCase(name, kind, planted_effects, base, spread, runs)


def draw_effect(draw: Generator, name: str, strength: str) -> PlantedEffect:
    """Draw the parameters of an effect of the vocabulary at a strength, by the rules of strengths.yaml."""
    rule, parameters = _rules()[name], {}
    for parameter, definition in effect_definition(name).parameters.items():
        if definition.default is not None:
            continue
        low, high = rule.get("others", {}).get(parameter, (definition.low, definition.high))
        if parameter == rule["size"]:
            scale_position = draw.uniform(*STRENGTHS[strength])
            faint, strong = float(rule["faint"]), float(rule["strong"])
            value = math.copysign(abs(faint) * (strong / faint) ** scale_position, strong)
            if rule.get("signed") and draw.random() < 0.5:
                value = -value
            parameters[parameter] = value + rule.get("about", 0.0)
        elif parameter == "order":
            parameters[parameter] = float(round(math.exp(draw.uniform(math.log(low), math.log(high)))))
        elif low > 0.0:
            parameters[parameter] = math.exp(draw.uniform(math.log(low), math.log(high)))
        else:
            parameters[parameter] = float(draw.uniform(low, high))
    return PlantedEffect(name, strength, make_effect(name, parameters), parameters)


def _draw_unlisted(draw: Generator, name: str, strength: str) -> PlantedEffect:
    """Draw an effect outside the vocabulary at a strength."""
    low, high = STRENGTHS[strength]
    effect = unlisted_effects()[name].drawn(draw, float(draw.uniform(low, high)))
    parameters = {key: value for key, value in vars(effect).items() if key != "role"}
    return PlantedEffect(name, strength, effect, parameters)


def _draw_spread(draw: Generator) -> Spread:
    """Draw the noise of a case's sensors: each nominal standard deviation changed by up to 15 %."""
    nominal_spread = Spread()
    return Spread(**{name: value * float(draw.uniform(0.85, 1.15)) for name, value in vars(nominal_spread).items()})


def _draw_run(
    draw: Generator,
    name: str,
    kind: str,
    warm: bool,
    base: Base,
    spread: Spread,
    planted_effects: Sequence[PlantedEffect],
) -> RunDraw:
    """Draw a run of a kind; it starts warm or close to ambient."""
    ambient = base.bench.ambient_temperature
    if kind == "heating":
        housing = ambient + draw.uniform(0.0, 1.0)
        winding = housing + draw.uniform(0.0, 0.5)
    else:
        housing = ambient + (draw.uniform(20.0, 52.0) if warm else draw.uniform(0.0, 3.0))
        winding = housing + (draw.uniform(-1.0, 12.0) if warm else draw.uniform(0.0, 1.5))
    lane = Lane(
        setup=SETUPS[kind],
        test=base.test,
        load=base.load,
        bench=base.bench,
        effects=tuple(_draw_for_run(draw, planted.effect) for planted in planted_effects),
        angle=float(draw.uniform(0.0, 2 * math.pi)),
        winding=float(winding),
        housing=float(housing),
        fixture=float(ambient + (housing - ambient) * draw.uniform(0.3, 0.9)),
    )
    seed = int(draw.integers(0, 2**63))
    if kind == "heating":
        return RunDraw(name, kind, lane, heating(draw, warm), seed)
    program = _with_stable_gain(PROGRAM_DRAWS[kind](draw), planted_effects)
    return RunDraw(name, kind, lane, replace(program, velocity_noise=spread.velocity, seed=seed), seed)


def _draw_for_run(draw: Generator, effect: PlantEffect) -> PlantEffect:
    """Return an effect as it acts in another run."""
    return effect.afresh(draw) if isinstance(effect, Unlisted) else effect


def _with_stable_gain(program: DriveReferences, planted_effects: Sequence[PlantedEffect]) -> DriveReferences:
    """Lower a servo's gain if an effect makes its loop slow or springy, as a person who tunes it would."""
    if program.servo == "load":
        is_springy = any(planted.name in ("shaft_compliance", "backlash") for planted in planted_effects)
        return _limit_gain(program, 70.0) if is_springy else program
    if program.servo != "test":
        return program
    delay = 0.0
    for planted in planted_effects:
        if planted.name in ("transport_delay", "velocity_filter_lag"):
            delay += planted.parameters.get("delay", 0.0) + planted.parameters.get("time_constant", 0.0)
        if planted.name == "command_slew_limit":
            delay += 5.0 / planted.parameters["rate"]  # s that a step of 5 A takes
    return _limit_gain(program, 0.35 / delay) if delay else program


def _limit_gain(program: DriveReferences, highest_gain: float) -> DriveReferences:
    """Lower the gain of a servo to `highest_gain` [1/s], and its integral gain by the square of the same ratio."""
    gain = min(program.velocity_gain, highest_gain)
    gain_ratio = gain / program.velocity_gain
    return replace(program, velocity_gain=gain, velocity_integral=program.velocity_integral * gain_ratio * gain_ratio)


def usual_effects() -> tuple[str, ...]:
    """Return the names of the effects that are drawn by default: those of a bench, except for those marked `asked`."""
    return tuple(name for name in effects_on("bench") if not _rules()[name].get("asked"))


@cache
def _rules() -> dict[str, dict[str, Any]]:
    """Return the rules of strengths.yaml by effect.

    Raises
    ------
    ValueError : the file and the vocabulary do not have the same effects.
    """
    text = (resources.files("leactl.emulation.blind") / "strengths.yaml").read_text(encoding="utf-8")
    rules: dict[str, dict[str, Any]] = yamlfile.parse(text, "strengths.yaml").data
    if one_sided_names := set(rules) ^ set(effects_on("bench")):
        raise ValueError(f"strengths.yaml: {sorted(one_sided_names)} on one side only")
    return rules
