"""Fits against certified figures, quantiles against printed tables."""

import numpy as np
import pytest

from leactl.analysis.statistics.regression import indicator_columns, least_squares, partial_f_test, t_quantile
from leactl.errors import NotIdentifiable

# NIST Statistical Reference Datasets, Norris: ozone monitors, y over x
NORRIS = """
0.1 0.2 338.8 337.4 118.1 118.2 888.0 884.6 9.2 10.1 228.1 226.5 668.5 666.3 998.5 996.3 449.1 448.6 778.9 777.0
559.2 558.2 0.3 0.4 0.1 0.6 778.1 775.5 668.8 666.9 339.3 338.0 448.9 447.5 10.8 11.6 557.7 556.0 228.3 228.1
998.0 995.8 888.8 887.6 119.6 120.2 0.3 0.3 0.6 0.3 557.6 556.8 339.3 339.1 888.0 887.2 998.5 999.0 778.9 779.0
10.2 11.1 117.6 118.3 228.9 229.2 668.4 669.1 449.2 448.9 0.2 0.5
"""


def test_norris_has_its_certified_line():
    y, x = np.array(NORRIS.split(), float).reshape(-1, 2).T
    design = np.column_stack([x, np.ones_like(x)])
    fit = least_squares(design, y, design, "norris")
    slope = fit.estimate("slope", "1", np.array([1.0, 0.0]))
    intercept = fit.estimate("intercept", "1", np.array([0.0, 1.0]))
    assert slope.value == pytest.approx(1.00211681802045, rel=1e-11)
    assert slope.std == pytest.approx(0.429796848199937e-3, rel=1e-10)
    assert intercept.value == pytest.approx(-0.262323073774029, rel=1e-9)
    assert intercept.std == pytest.approx(0.232818234301152, rel=1e-10)
    assert fit.r_squared == pytest.approx(0.999993745883712, rel=1e-12)
    assert fit.variance**0.5 == pytest.approx(0.884796396144373, rel=1e-10)
    assert (slope.high - slope.low) / 2 / slope.std == pytest.approx(2.032, abs=5e-4)  # t table, 34 degrees of freedom


@pytest.mark.parametrize(("dof", "quantile"), [(1, 12.706), (2, 4.303), (5, 2.571), (30, 2.042), (float("inf"), 1.960)])
def test_quantiles_are_those_of_the_table(dof, quantile):
    assert t_quantile(dof) == pytest.approx(quantile, abs=5e-4)


def test_an_instrument_takes_out_what_errors_in_a_regressor_do():
    rng = np.random.default_rng(2)
    true = np.tile(np.arange(5.0), 4000)
    measured = true + rng.normal(0.0, 1.0, true.size)
    design, known = (np.column_stack([x, np.ones_like(x)]) for x in (measured, true))
    response = 3.0 * true
    # errors of variance 1 in a regressor of variance 2 lower the slope to two thirds
    assert least_squares(design, response, design, "x").coefficients[0] == pytest.approx(2.0, abs=0.05)
    assert least_squares(design, response, known, "x").coefficients[0] == pytest.approx(3.0, abs=0.05)


def test_lack_of_fit_is_found_as_often_as_its_probability_says():
    rng = np.random.default_rng(3)
    level = np.tile(np.arange(5.0), 6)
    line = np.column_stack([level, np.ones_like(level)])
    results = [partial_f_test(line, 2.0 * level + rng.normal(size=30), indicator_columns(level)) for _ in range(1000)]
    assert np.mean([item.p_value < 0.25 for item in results]) == pytest.approx(0.25, abs=0.04)
    assert {item.dof for item in results} == {3}
    curved = partial_f_test(line, level**2 + rng.normal(0.0, 0.1, 30), indicator_columns(level))
    assert curved.is_significant


def test_what_leaves_nothing_to_test_has_no_departure():
    level = np.arange(5.0)
    line = np.column_stack([level, np.ones_like(level)])
    assert partial_f_test(line, level**2, indicator_columns(level)) is None  # no repeats
    twice = np.tile(line, (2, 1))
    assert partial_f_test(twice, 3.0 * twice[:, 0], indicator_columns(twice[:, 0])) is None  # exact


@pytest.mark.parametrize(
    ("x", "words"),
    [((1.0, 2.0), "2 points for 2 unknowns"), ((1.0, 1.0, 1.0, 1.0), "do not tell 2 unknowns apart")],
)
def test_what_cannot_be_told_apart_is_refused(x, words):
    design = np.column_stack([x, np.ones(len(x))])
    with pytest.raises(NotIdentifiable, match=f"run: .*{words}"):
        least_squares(design, np.arange(len(x), dtype=float), design, "run")
