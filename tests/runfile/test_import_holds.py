"""Holds are found in setpoints exactly, in readings above their noise of whatever colour, or refused."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.signal import lfilter

from leactl.errors import InputError
from leactl.runfile.importing.holds import NotDistinct, find_holds

from .test_import_steps import SMALL, imported, steps_in

ROWS = 400  # of a hold
RATE = 100.0
levels_that_differ = st.lists(st.integers(-9, 9), min_size=2, max_size=7).map(
    lambda levels: [level for level, before in zip(levels, [None, *levels], strict=False) if level != before]
)
seeds = st.integers(0, 2**32 - 1)


def stamps(values, rate=RATE):
    return np.arange(len(values)) / rate


def coloured(count, lifetime, random):
    """Noise of unit scatter whose autocorrelation falls to 1/e within so many rows."""
    kept = math.exp(-1.0 / lifetime) if lifetime else 0.0
    white = random.standard_normal(count + 20 * math.ceil(lifetime))
    return lfilter([math.sqrt(1.0 - kept * kept)], [1.0, -kept], white)[len(white) - count :]


@given(levels_that_differ, seeds, st.sampled_from([1e-6, 1.0, 1e5]), st.booleans())
def test_a_setpoint_holds_exactly_but_for_strays_and_what_is_missing(levels, seed, size, is_setpoint):
    random = np.random.default_rng(seed)
    values = size * np.repeat(np.asarray(levels, float), ROWS)
    strays = np.concatenate([np.arange(7, ROWS - 7, 13) + ROWS * k for k in range(len(levels))])
    values[strays] += size * random.integers(-3, 4, len(strays))
    missing = (random.random(len(values)) < 0.05) & (np.arange(len(values)) % ROWS > 2)
    values[missing] = np.nan
    result = find_holds(stamps(values), values, 3.9, 1.0, is_setpoint)
    expected = [(ROWS * k, ROWS * (k + 1), size * level) for k, level in enumerate(levels)]
    assert [(hold.first, hold.after, hold.level) for hold in result] == expected
    assert [hold.before for hold in result[1:]] == pytest.approx([size * level for level in levels[:-1]])


@pytest.mark.parametrize(("rows", "holds"), [(1, [(0, 900)]), (2, [(0, 400), (402, 900)]), (9, [(0, 400), (409, 900)])])
def test_two_rows_off_a_setpoint_end_its_hold_and_one_does_not(rows, holds):
    values = np.full(900, 2.0)
    values[400 : 400 + rows] = 2.1
    assert [(hold.first, hold.after) for hold in find_holds(stamps(values), values, 3.0, 0.5, True)] == holds


@pytest.mark.parametrize("is_setpoint", [True, False])
def test_a_long_silence_ends_a_hold_and_a_short_one_does_not(is_setpoint):
    values = np.repeat([1.0, 2.0, 2.0], ROWS)
    values[100:110] = values[300:500] = values[795:1000] = values[1190:] = np.nan
    result = find_holds(stamps(values), values, 1.8, 0.5, is_setpoint)
    assert [(hold.first, hold.after) for hold in result] == [(0, 300), (500, 795), (1000, 1200)]
    assert all(math.isnan(hold.before) for hold in result)


@given(
    levels_that_differ,
    st.sampled_from([0.0, 0.05]),  # of the distance between levels
    st.sampled_from([0, 1, 4]),
    st.sampled_from([0.0, 1e-3, 1.0]),
    seeds,
    st.sampled_from([1e-4, 1.0, 1e4]),
)
def test_levels_of_a_reading_are_found_whatever_the_colour_of_its_noise(levels, noise, lifetime, speed, seed, size):
    assume(len(levels) > 1)
    random = np.random.default_rng(seed)
    true = np.repeat(np.asarray(levels, float), ROWS)
    loud = 1.0 + speed * np.abs(true) / 9.0  # it grows with the level
    values = size * (true + noise * loud * coloured(len(true), lifetime, random))
    values[random.random(len(values)) < 0.05] = np.nan
    result = find_holds(stamps(values), values, 3.5, 1.0, False)
    assert [hold.level / size for hold in result] == pytest.approx(levels, abs=0.1)
    for number, hold in enumerate(result):
        assert abs(hold.first - number * ROWS) <= 0.05 * ROWS
        assert abs(hold.after - (number + 1) * ROWS) <= 0.05 * ROWS
    assert [hold.before < hold.level for hold in result[1:]] == [before < level for before, level in pairwise(levels)]


@given(levels_that_differ, st.sampled_from([0, 4]), seeds)
def test_ramps_between_levels_are_in_no_hold(levels, lifetime, seed):
    assume(len(levels) > 1)
    random = np.random.default_rng(seed)
    parts = [np.full(ROWS, float(levels[0]))]
    for before, level in pairwise(levels):
        parts += [np.linspace(before, level, ROWS // 4), np.full(ROWS, float(level))]
    values = np.concatenate(parts)
    values = values + 0.02 * coloured(len(values), lifetime, random)
    result = find_holds(stamps(values), values, 3.5, 1.0, False)
    assert [hold.level for hold in result] == pytest.approx(levels, abs=0.05)
    begins = [number * (ROWS + ROWS // 4) for number in range(len(levels))]
    for begin, hold in zip(begins, result, strict=True):
        assert abs(hold.first - begin) <= 0.1 * ROWS
        assert abs(hold.after - begin - ROWS) <= 0.1 * ROWS


def test_a_reading_that_flickers_by_one_count_is_held():
    random = np.random.default_rng(4)
    true = np.repeat([0.0, 20.0, 40.0, 20.0], ROWS)
    for share in (0.003, 0.03, 0.3):
        result = find_holds(stamps(true), true + (random.random(len(true)) < share), 3.5, 1.0, False)
        assert [hold.first for hold in result] == pytest.approx([0, 400, 800, 1200], abs=0.05 * ROWS)


def test_a_level_that_comes_again_and_drifts_a_little_is_held():
    random = np.random.default_rng(2)
    parts = [[0.0] * 100 + [2.0] * ROWS for _ in range(8)]
    values = np.concatenate([parts[0][100:], *parts[1:]])
    values += 0.02 * random.standard_normal(len(values))
    values[500 * 3 : 500 * 3 + ROWS] += np.linspace(0.0, 0.05, ROWS)
    holds = find_holds(stamps(values), values, 3.5, 0.5, False)
    assert [hold.first for hold in holds] == pytest.approx([500 * number for number in range(8)], abs=0.05 * ROWS)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kind", ["walk", "coloured", "white", "small steps", "drift", "drift and a step"])
def test_levels_that_noise_hides_are_refused(kind, seed):
    random = np.random.default_rng(seed)
    levels = np.repeat([0.0, 1.0, 2.0, 1.0, 0.0, 1.0], ROWS)
    values = {
        "walk": np.cumsum(random.standard_normal(len(levels))),
        "coloured": levels + 1.0 * coloured(len(levels), 100, random),
        "white": levels + 30.0 * random.standard_normal(len(levels)),
        "small steps": levels + 3.0 * random.standard_normal(len(levels)),
        "drift": np.linspace(0.0, 1.0, len(levels)) + 0.1 * random.standard_normal(len(levels)),
        "drift and a step": np.concatenate([np.linspace(0.0, 0.4, 5 * ROWS), np.full(ROWS, 0.8)]),
    }[kind]
    if kind == "drift and a step":
        values += 0.02 * random.standard_normal(len(values))
    with pytest.raises(NotDistinct):
        find_holds(stamps(values), values, 3.5, 1.0, False)


HOLDS = "steps_by_holds: {channel: loop/iq, parameter: current_A, least_s: 1.9, settle_s: 0.2}"


def test_a_direction_is_that_of_the_last_row_that_was_read(tmp_path):
    levels = np.repeat([1.0, 2.0, 3.0, 2.0], 100)
    levels[[99, 100, 199, 298, 299]] = np.nan
    cells = ["" if math.isnan(level) else repr(level) for level in levels.tolist()]
    rows = [f"{k * 0.02:.2f};{cell}" for k, cell in enumerate(cells)]
    (tmp_path / "log.csv").write_text("\n".join(["t;iq", *rows, ""]))
    steps = steps_in(imported(tmp_path, tmp_path / "log.csv", SMALL.format(decimal=".", steps=HOLDS)))
    assert [about.get("direction") for *_, about in steps] == [None, "rising", "rising", "falling"]


def test_an_import_whose_levels_noise_hides_is_one_line(tmp_path):
    walk = np.cumsum(np.random.default_rng(1).standard_normal(2000))
    rows = [f"{k * 0.02:.2f};{value:.6g}" for k, value in enumerate(walk.tolist())]
    (tmp_path / "log.csv").write_text("\n".join(["t;iq", *rows, ""]))
    with pytest.raises(InputError) as refused:
        imported(tmp_path, tmp_path / "log.csv", SMALL.format(decimal=".", steps=HOLDS))
    [line] = refused.value.faults
    assert f"{tmp_path / 'map.yaml'}:8:27  steps_by_holds.channel: " in line
    assert "levels of loop/iq are not distinct from noise" in line
