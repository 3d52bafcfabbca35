"""Errata of the print on statistics: what its means and +- give as three standard deviations, and what its F say."""

import numpy as np
import pytest
from scipy.stats import f

from leactl.analysis.anova.comparison import compare
from leactl.analysis.anova.one_way import anova
from leactl.analysis.anova.values import Values

CONDITIONS = ("unloaded", "design", "loaded")
DAMPING = ((18.2, 9.7), (23.8, 8.0), (25.5, 11.1))  # mN*m*s/rad, mean and +-
COULOMB = ((241.9, 43.4), (208.0, 38.4), (303.7, 73.5))  # mN*m
PRINTED_F = {"damping": 14.09, "coulomb": 72.47}
N = 10


def values_of(figures, parts, count=N, actuators=1):
    """Values whose means are the printed ones and whose standard deviations are the printed +- over so many parts."""
    shape = np.linspace(-1.0, 1.0, count)
    shape = (shape - shape.mean()) / shape.std(ddof=1)
    value = np.concatenate([mean + plus / parts * shape for mean, plus in figures])
    return Values(
        "damping",
        "mN*m*s/rad",
        value,
        np.array([f"a{k % actuators}" for _ in figures for k in range(count)]),
        np.repeat(CONDITIONS, count),
        np.zeros(len(value), np.int64),
    )


@pytest.mark.parametrize(("figures", "name", "f_of_three"), [(DAMPING, "damping", 14.00), (COULOMB, "coulomb", 72.57)])
def test_printed_plus_minus_is_three_standard_deviations(figures, name, f_of_three):
    result = anova(values_of(figures, 3)).test
    assert result.f == pytest.approx(f_of_three, abs=0.005)
    assert result.f == pytest.approx(PRINTED_F[name], rel=0.01)
    assert (result.between, result.within) == (2, 27)


@pytest.mark.parametrize(("figures", "f_of_one"), [(DAMPING, 1.56), (COULOMB, 8.06)])
def test_taken_as_one_standard_deviation_the_printed_f_is_not_met(figures, f_of_one):
    assert anova(values_of(figures, 1)).test.f == pytest.approx(f_of_one, abs=0.005)


def test_printed_p_values_are_those_of_the_printed_f():
    assert f.sf(14.09, 2, 27) == pytest.approx(6.5e-5, rel=0.02)
    assert f.sf(72.47, 2, 27) == pytest.approx(1.4e-11, rel=0.05)
    assert f.sf(0.02, 2, 15) == pytest.approx(0.98, abs=0.002)


def test_tukey_verdicts_of_the_print_come_out_of_its_means():
    damping, coulomb = compare(values_of(DAMPING, 3)), compare(values_of(COULOMB, 3))
    shown = {(pair.first, pair.second): pair.shown for pair in damping.pairs}
    assert shown == {("unloaded", "design"): True, ("unloaded", "loaded"): True, ("design", "loaded"): False}
    assert all(pair.shown for pair in coulomb.pairs)


def test_f_2_27_is_30_pooled_values_and_has_no_random_factor():
    """With two actuators there are 26 degrees of freedom left, or 2 where actuators may answer differently."""
    pooled = anova(values_of(DAMPING, 3))
    assert (pooled.test.within, pooled.at_large) == (27, None)
    two = anova(values_of(DAMPING, 3, actuators=2))
    assert (two.test.between, two.test.within) == (2, 26)
    assert (two.at_large.between, two.at_large.within) == (2, pytest.approx(2))


def test_f_2_15_is_18_pooled_values():
    result = anova(values_of(((0.49, 0.06), (0.49, 0.06), (0.4905, 0.06)), 3, count=6)).test
    assert (result.between, result.within) == (2, 15)
    assert not result.shown
