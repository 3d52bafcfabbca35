"""The stacked regression: hypotheses from Gram matrices are those of an ordinary solve, priors and weights included."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from leactl.effects.contract import Signals
from leactl.gap.search.effect_regression import rows_per_independent
from leactl.gap.search.regression import Normal, Rows, disagreement, gain_of, residuals, stack, white_noise
from leactl.model.nominal import Model

TRUE = {("calibration", "a"): 0.3, ("calibration", "b"): -0.2, ("effect", "e", "()", "c"): 0.7}


def rows(seed, run="r", noise=0.05, names=tuple(TRUE)):
    random = np.random.default_rng(seed)
    columns = {name: random.normal(size=200) for name in names}
    left = sum(TRUE[name] * column for name, column in columns.items()) + noise * random.normal(size=200)
    index = np.arange(200)
    bare = Signals("free", index * 0.01, Model(name="m"), 0.01)
    made = Rows(run, "k", "free", "eq", "torque", "test", "N*m", left, columns, {}, index, index // 40, bare, noise)
    made.noise = noise
    return made


@pytest.fixture
def stacked():
    return stack([rows(1), rows(2, "s")], {"a": 0.5, "b": 0.5})


def test_a_fit_finds_the_coefficients_and_their_spread(stacked):
    fit = Normal(stacked, [1 / 0.05**2] * 2).fit([("e", ())])
    for place, value, variance in zip(fit.columns, fit.values, np.diag(fit.covariance), strict=True):
        assert value == pytest.approx(TRUE[stacked.names[place]], abs=5 * np.sqrt(variance))
        assert np.sqrt(variance) == pytest.approx(0.05 / np.sqrt(400), rel=0.2)


def test_a_gain_is_the_difference_of_two_misfits(stacked):
    normal = Normal(stacked, [300.0, 500.0])
    base, added = stacked.columns_of([]), np.array([stacked.position_of["effect", "e", "()", "c"]])
    gain, values, _covariance = gain_of(normal, base, added)
    assert gain == pytest.approx(normal.fit().misfit - normal.fit([("e", ())]).misfit, rel=1e-6)
    assert values[0] == pytest.approx(0.7, abs=0.02)


def test_misfit_is_the_weighted_squares_left_and_the_priors_paid(stacked):
    normal = Normal(stacked, [300.0, 500.0])
    fit = normal.fit()
    paid = sum((value / 0.5) ** 2 for value in fit.values)
    squares = sum(w * np.sum(residuals(stacked, fit, k) ** 2) for k, w in enumerate([300.0, 500.0]))
    assert fit.misfit == pytest.approx(squares + paid, rel=1e-6)
    assert normal.residual_rms(fit, 0) == pytest.approx(np.sqrt(np.mean(residuals(stacked, fit, 0) ** 2)), rel=1e-6)


def test_what_no_row_shows_and_no_prior_bounds_may_be_anything():
    unseen = rows(1)
    unseen.columns["calibration", "a"] = np.zeros(200)
    silent = stack([unseen], {"b": 0.5})
    normal = Normal(silent, [400.0])
    fit = normal.fit()
    assert [disagreement(normal, fit, index) for index in range(len(fit.columns))] == [1.0, 1.0]
    variance = dict(zip((silent.names[place] for place in fit.columns), np.diag(fit.covariance), strict=True))
    assert variance["calibration", "a"] == np.inf
    assert variance["calibration", "b"] < 0.1


@given(st.floats(0.0, 0.9), st.integers(0, 2**20))
def test_rows_that_lean_on_their_neighbours_count_for_less(lean, seed):
    random = np.random.default_rng(seed)
    noise = random.normal(size=40000)
    series = lfilter([1.0], [1.0, -lean], noise)
    assert rows_per_independent(series) == pytest.approx((1 + lean) / (1 - lean), rel=0.5)


def test_white_noise_is_blind_to_what_is_slow():
    random = np.random.default_rng(3)
    slow = 10 * np.sin(np.linspace(0, 6, 5000))
    assert white_noise(slow + 0.1 * random.normal(size=5000)) == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("seed", range(20))
def test_runs_that_tell_nothing_of_a_parameter_do_not_disagree_about_it(seed):
    """Of two columns alike only the sum is told, and rounding may make less than nothing of the rest."""
    twins = [rows(seed, "r"), rows(seed + 100, "s")]
    for twin in twins:
        twin.columns["calibration", "b"] = twin.columns["calibration", "a"].copy()
    normal = Normal(stack(twins, {"a": 0.5, "b": 0.5}), [1e20, 1e20])
    fit = normal.fit()
    assert np.isfinite(disagreement(normal, fit, 0))


def test_runs_that_contradict_each_other_widen_the_standard_error_and_others_do_not():
    agreeing = stack([rows(seed, str(seed)) for seed in range(6)], {})
    contrary = [rows(seed, str(seed)) for seed in range(6)]
    for place, each in enumerate(contrary):
        each.left_over = each.left_over + (-1) ** place * 0.02 * each.columns["calibration", "a"]
    contrary = stack(contrary, {})
    widened = {}
    for name, stacked in (("agreeing", agreeing), ("contrary", contrary)):
        normal = Normal(stacked, [1 / 0.05**2] * 6)
        fit = normal.fit([("e", ())])
        place = stacked.names.index(("calibration", "a"))
        widened[name] = disagreement(normal, fit, int(np.flatnonzero(fit.columns == place)[0]))
    # each run's own standard error is 0.05 / sqrt(200), 5.7 times less than what sets them apart
    assert widened["agreeing"] < 1.8
    assert widened["contrary"] == pytest.approx(np.sqrt(6 / 5) * 0.02 * np.sqrt(200) / 0.05, rel=0.3)
