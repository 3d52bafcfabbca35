"""Analysis of variance against scipy's one-way tests, textbook ratios of mean squares, and designs drawn at random."""

import numpy as np
import pytest
from scipy import stats

from leactl.analysis.anova.comparison import compare
from leactl.analysis.anova.effect_size import omega_squared
from leactl.analysis.anova.one_way import anova, welch
from leactl.analysis.anova.pairs import pairs
from leactl.analysis.anova.values import Values
from leactl.errors import NotIdentifiable

RNG = np.random.default_rng(5)
LABELS = ("unloaded", "design", "loaded")


def values(table):
    """Values from rows of (condition, actuator, value)."""
    conditions, actuators, numbers = zip(*table, strict=True)
    cells = {cell: k for k, cell in enumerate(dict.fromkeys(zip(conditions, actuators, strict=True)))}
    run = np.array([cells[cell] for cell in zip(conditions, actuators, strict=True)])
    return Values("x", "N*m", np.array(numbers), np.array(actuators), np.array(conditions), run)


def one_way(*groups):
    return values([(label, "a1", x) for label, group in zip(LABELS, groups, strict=False) for x in group])


def crossed(cells, actuators=("a1", "a2"), conditions=LABELS):
    return values([(c, a, x) for c in conditions for a in actuators for x in cells[c, a]])


def drawn(rng, repeats, actuators=3, between=0.0, interaction=0.0, effect=(0.0, 0.0, 0.0)):
    """A design with so many repeats in each cell, which may differ."""
    names = [f"a{k}" for k in range(actuators)]
    whole = dict(zip(names, rng.normal(0.0, between, actuators), strict=True))
    cells = {}
    for label, mean in zip(LABELS, effect, strict=True):
        for name in names:
            count = repeats if isinstance(repeats, int) else repeats[label, name]
            cells[label, name] = mean + whole[name] + rng.normal(0.0, interaction) + rng.normal(0.0, 1.0, count)
    return crossed(cells, names)


@pytest.mark.parametrize("sizes", [(6, 6, 6), (10, 4, 7)])
def test_one_actuator_is_the_one_way_analysis_and_tukeys(sizes):
    groups = [RNG.normal(mean, 1.0, size) for mean, size in zip((0.0, 0.8, 1.5), sizes, strict=True)]
    data = one_way(*groups)
    result = anova(data)
    expected = stats.f_oneway(*groups)
    assert result.test.f == pytest.approx(expected.statistic)
    assert result.test.p == pytest.approx(expected.pvalue)
    tukey = stats.tukey_hsd(*groups)
    low, high = tukey.confidence_interval().low, tukey.confidence_interval().high
    for pair, (i, k) in zip(pairs(data, result), [(0, 1), (0, 2), (1, 2)], strict=True):
        assert pair.p == pytest.approx(tukey.pvalue[i, k], rel=1e-6, abs=1e-9)
        assert pair.difference == pytest.approx(-tukey.statistic[i, k])
        assert (pair.low, pair.high) == (pytest.approx(-high[i, k], rel=1e-6), pytest.approx(-low[i, k], rel=1e-6))


def test_balanced_with_actuators_it_is_the_textbooks_ratios():
    data = drawn(np.random.default_rng(2), 4, actuators=3, between=2.0, interaction=0.3, effect=(0.0, 0.5, 1.0))
    cube = data.value.reshape(3, 3, 4)  # condition, actuator, repeat
    mean, cells = cube.mean(), cube.mean(axis=2)
    rows, columns = cells.mean(axis=1), cells.mean(axis=0)
    of_conditions = 12 * np.sum((rows - mean) ** 2) / 2
    of_cells = 4 * np.sum((cells - rows[:, None] - columns + mean) ** 2) / 4
    of_error = np.sum((cube - cells[:, :, None]) ** 2) / 27
    result = anova(data)
    assert result.interaction.f == pytest.approx(of_cells / of_error)
    assert result.at_large.f == pytest.approx(of_conditions / of_cells)
    assert (result.at_large.between, result.at_large.within) == (2, pytest.approx(4))
    additive = (4 * of_cells + 27 * of_error) / 31
    assert result.test.f == pytest.approx(of_conditions / additive)
    assert result.test.within == 31
    between = 12 * np.sum((columns - mean) ** 2) / 2
    assert result.actuator.f == pytest.approx(between / additive)
    assert result.actuator_std == pytest.approx(np.sqrt((between - additive) / 12))


def test_an_actuator_that_differs_as_a_whole_takes_nothing_from_the_conditions():
    data = drawn(np.random.default_rng(3), {(c, a): 2 + k for k, (c, a) in enumerate(_cells())}, effect=(0, 1, 2))
    moved = data.value + 50.0 * (data.actuator == "a1") - 9.0 * (data.actuator == "a2")
    first, second = compare(data), compare(Values("x", "N*m", moved, data.actuator, data.condition, data.run))
    assert second.anova.test.f == pytest.approx(first.anova.test.f)
    for one, other in zip(first.pairs, second.pairs, strict=True):
        assert (other.difference, other.std, other.p) == pytest.approx((one.difference, one.std, one.p))


def _cells():
    return [(c, a) for c in LABELS for a in ("a0", "a1", "a2")]


def test_of_two_conditions_welchs_test_is_his_t_test():
    groups = [np.array([1.0, 2.5, 3.0, 7.0]), np.array([4.0, 4.2, 4.1, 4.4, 4.0])]
    expected = stats.ttest_ind(*groups, equal_var=False)
    result = welch(groups)
    assert result.f == pytest.approx(expected.statistic**2)
    assert result.within == pytest.approx(expected.df)
    assert result.p == pytest.approx(expected.pvalue)
    assert welch([groups[0], groups[1][:3]]) is None


def test_unequal_scatter_does_not_pass_for_an_effect():
    """Few values scatter widely: F takes the scatter of the many and shows an effect in a third of such experiments."""
    rng = np.random.default_rng(10)
    data = [one_way(rng.normal(0, 5, 4), rng.normal(0, 1, 12), rng.normal(0, 1, 12)) for _ in range(300)]
    assert np.mean([anova(item).test.shown for item in data]) > 0.15
    assert np.mean([anova(item).shown for item in data]) < 0.08
    lone = next(found for found in map(compare, data) if found.anova.test.shown and not found.anova.shown)
    assert lone.sentence.startswith("No effect of the condition on x is shown")
    assert "by Welch's test" in lone.sentence


@pytest.mark.parametrize("uneven", [False, True])
def test_without_an_effect_one_in_twenty_is_shown(uneven):
    rng = np.random.default_rng(7)
    repeats = {(c, a): (5, 2, 3)[(i + k) % 3] for i, c in enumerate(LABELS) for k, a in enumerate(("a0", "a1", "a2"))}
    p = [anova(drawn(rng, repeats if uneven else 3, between=3.0)).test.p for _ in range(400)]
    assert 0.03 < np.mean(np.array(p) < 0.05) < 0.085  # a twentieth by the error, and whatever shows an interaction


@pytest.mark.parametrize("uneven", [False, True])
def test_actuators_that_answer_differently_do_not_pass_for_an_effect_at_large(uneven):
    rng = np.random.default_rng(8)
    repeats = {(c, a): (6, 2, 3)[(i + k) % 3] for i, c in enumerate(LABELS) for k, a in enumerate(("a0", "a1", "a2"))}
    results = [anova(drawn(rng, repeats if uneven else 4, interaction=1.5)) for _ in range(400)]
    assert np.mean([result.at_large.p < 0.05 for result in results]) < 0.09
    assert np.mean([result.interaction.shown for result in results]) > 0.8


def test_pairs_at_large_have_the_scatter_of_the_interaction():
    rng = np.random.default_rng(9)
    differences, errors = [], []
    for _ in range(300):
        data = drawn(rng, 4, interaction=2.0)
        result = anova(data)
        if result.interaction.shown:
            pair = pairs(data, result)[0]
            differences.append(pair.difference)
            errors.append(pair.std**2)
    assert len(differences) > 250
    assert np.mean(errors) == pytest.approx(np.var(differences), rel=0.25)


def test_omega_squared_holds_the_true_share_in_19_of_20():
    rng = np.random.default_rng(11)
    effect = np.array([0.0, 0.7, 1.1])
    true = effect.var() / (effect.var() + 1.0)
    held, found = 0, []
    for _ in range(300):
        share = omega_squared(anova(one_way(*rng.normal(effect[:, None], 1.0, (3, 8)))).test)
        held += share.low <= true <= share.high
        found.append(share.value)
    assert 0.92 <= held / 300 <= 0.98
    assert np.mean(found) == pytest.approx(true, abs=0.02)


def test_the_smallest_effect_is_seen_in_four_of_five():
    rng = np.random.default_rng(12)
    size = pairs(flat := one_way(*np.tile(_unit(6), (3, 1))), anova(flat))[0].smallest_seen
    seen = 0
    for _ in range(300):
        data = one_way(*rng.normal([[0.0], [size], [0.0]], 1.0, (3, 6)))
        seen += pairs(data, anova(data))[0].shown
    assert 0.74 < seen / 300 < 0.86


def _unit(count):
    shape = np.linspace(-1.0, 1.0, count)
    return shape / shape.std(ddof=1)


def test_one_value_a_cell_is_a_block_design():
    rng = np.random.default_rng(13)
    table = rng.normal(0.0, 1.0, (3, 4))
    names = [f"a{k}" for k in range(4)]
    result = anova(crossed({(c, a): [table[i, k]] for i, c in enumerate(LABELS) for k, a in enumerate(names)}, names))
    assert (result.test.between, result.test.within) == (2, 6)
    assert result.interaction is None
    assert result.at_large == result.test


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (values([("design", "a1", 1.0), ("design", "a1", 2.0)]), "found one condition, 'design'"),
        (values([("design", "a1", 1.0), ("loaded", "a1", 2.0)]), "2 values of 2 conditions give no scatter"),
        (one_way([1.0, 1.0], [2.0, 2.0]), "equal to the last digit"),
        (
            values([(c, a, x) for c, a in (("design", "a1"), ("loaded", "a2")) for x in (1.0, 2.0, 3.0)]),
            "conditions and actuators cannot be told apart",
        ),
    ],
)
def test_what_cannot_be_judged_is_refused(data, message):
    with pytest.raises(NotIdentifiable, match=message):
        anova(data)


def test_broken_assumptions_are_said_with_what_another_test_gives():
    rng = np.random.default_rng(14)
    result = compare(one_way(rng.normal(0, 1, 10), rng.normal(0, 20, 10), rng.normal(5, 1, 10)))
    assert any(note.startswith("equal scatter") and "Welch" in note for note in result.notes)
    skewed = compare(one_way(*np.exp(rng.normal(0, 1.5, (3, 20)))))
    assert any(note.startswith("normal residuals") and "Kruskal-Wallis" in note for note in skewed.notes)
    drifting = compare(one_way(*(np.arange(10) + rng.normal(0, 0.5, (3, 10)))))
    assert any(note.startswith("no drift over the trials: doubtful") for note in drifting.notes)
    clean = compare(one_way(*rng.normal(0, 1, (3, 10))))
    assert not any("doubtful" in note for note in clean.notes)


def test_runs_of_a_condition_that_differ_are_said():
    rng = np.random.default_rng(15)
    data = one_way(*rng.normal(0, 1, (3, 10)))
    runs = np.repeat(np.arange(6), 5)
    apart = Values("x", "N*m", data.value + 4.0 * (runs % 2), data.actuator, data.condition, runs)
    assert any("--by-run" in note for note in compare(apart).notes)
    alike = Values("x", "N*m", data.value, data.actuator, data.condition, runs)
    assert not any("--by-run" in note for note in compare(alike).notes)


def test_the_sentence_says_what_is_shown_and_what_is_not():
    rng = np.random.default_rng(16)
    nothing = compare(one_way(*rng.normal(10, 1, (3, 6)))).sentence
    assert nothing.startswith("No effect of the condition on x is shown (F(2, 15) = ")
    assert "That does not show that there is none" in nothing
    something = compare(one_way(*rng.normal([[0], [0.2], [9]], 1, (3, 6)))).sentence
    assert something.startswith("x differs between conditions (F(2, 15) = ")
    assert "loaded is above unloaded by" in something
    assert "Between unloaded and design no difference is shown; one of" in something
