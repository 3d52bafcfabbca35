"""The paper's verdicts from its own figures, with fewer seeds than the command, and through run files once."""

import numpy as np
import pytest

from leactl.analysis.anova.one_way import anova

from .trial import by_runs, by_values, drawn


@pytest.mark.parametrize(("actuators", "least"), [(1, 0.75), (2, 0.70)])
def test_the_papers_verdicts_come_out(actuators, least):
    """Of damping and Coulomb friction; with two actuators a twentieth shows an interaction that is not there."""
    printed = [all(item.as_printed for item in by_values(seed, True, actuators)[:2]) for seed in range(120)]
    assert np.mean(printed) >= least


@pytest.mark.parametrize("actuators", [1, 2])
def test_few_false_verdicts_without_an_effect(actuators):
    results = [[anova(values).shown for _, values in drawn(seed, False, actuators)] for seed in range(600)]
    false = np.mean(results, axis=0)
    assert (false <= 0.08).all()
    assert (false >= 0.015).all()  # a test that never shows anything would pass the line above


def test_run_files_say_what_the_drawn_values_say():
    for seed in (1,):
        through_runs = {item.name: item.any_shown for item in by_runs(seed, True)}
        assert through_runs["viscous_damping"]
        assert through_runs["coulomb_friction"]
