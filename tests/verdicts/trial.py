"""One seed: draw, analyse, and hold the verdicts against the paper's; from values, or through run files."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leactl.analysis.anova.comparison import Comparison, compare, compare_all
from leactl.analysis.anova.values import Values
from tests.analysis.synthetic import Bench

from .draws import CONDITIONS, PARAMETERS, Printed

LEVELS = {"loaded": (0.76, 0.7925, 0.825, 0.8575, 0.89)}
ACTUATOR_STD = 0.1  # of the mean, between actuators as a whole, where there are two


@dataclass(frozen=True)
class Verdict:
    """What one seed gave for one parameter."""

    name: str
    as_printed: bool
    any_shown: bool


def drawn(seed: int, effect: bool, actuators: int = 1) -> list[tuple[Printed, Values]]:
    """Values of each parameter; trials take turns between the actuators."""
    rng = np.random.default_rng((seed, effect))
    results = []
    for printed in PARAMETERS:
        value = printed.draw(rng, effect)
        turn = np.arange(printed.trials) % actuators
        if actuators > 1:
            value = value + (rng.normal(0.0, ACTUATOR_STD * np.mean(printed.means), actuators))[turn]
        names = np.tile([f"a{k}" for k in turn], 3)
        conditions, run = np.repeat(CONDITIONS, printed.trials), np.repeat(np.arange(3), printed.trials)
        results.append((printed, Values(printed.name, printed.units, value.ravel(), names, conditions, run)))
    return results


def by_values(seed: int, effect: bool, actuators: int = 1) -> list[Verdict]:
    """Compare drawn values themselves."""
    return [_verdict(printed, compare(values)) for printed, values in drawn(seed, effect, actuators)]


def by_runs(seed: int, effect: bool) -> list[Verdict]:
    """Write a run for each condition and experiment, with the noise of the bench's sensors, and compare those."""
    rng = np.random.default_rng((seed, effect))
    trials = {printed.name: np.abs(printed.draw(rng, effect)) for printed in PARAMETERS}
    results = []
    with tempfile.TemporaryDirectory() as place:
        bench = Bench(Path(place), rng)
        friction, torque = [], []
        for k, condition in enumerate(CONDITIONS):
            b, f, kt = (trials[printed.name][k] for printed in PARAMETERS)
            levels = LEVELS["loaded"] if f.max() > 0.27 else (0.6, 0.635, 0.67, 0.705, 0.74)
            noise = {"q_axis_current": 0.015, "velocity": 0.002, "torque": 0.004}
            friction.append(bench.friction(b=b, f=f, trials=len(b), levels=levels, condition=condition, noise=noise))
            torque.append(bench.torque(kt=kt, trials=len(kt), condition=condition, noise=noise))
        for paths in (friction, torque):
            compared = {comparison.name: comparison for comparison in compare_all(paths)[1]}
            results += [
                _verdict(parameter, compared[parameter.name]) for parameter in PARAMETERS if parameter.name in compared
            ]
    return results


def _verdict(printed: Printed, found: Comparison) -> Verdict:
    shown = found.anova.shown
    pairs = tuple(shown and pair.shown for pair in found.pairs)
    return Verdict(printed.name, shown == any(printed.differ) and pairs == printed.differ, shown)
