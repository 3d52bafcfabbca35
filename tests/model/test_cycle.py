"""Cycles from CSV: units by column name, one whole cycle, and everything else refused in one line."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.errors import InputError
from leactl.model.cycle import POINTS_PER_CYCLE, _residual_and_notes, _series, read_cycle


@pytest.fixture
def written(tmp_path):
    def write(header="cycle_percent,angle_deg,torque_Nm", end=100.0, rows=101, edit=None, closed=True):
        phase = np.linspace(0.0, end, rows, endpoint=closed)
        part = 2.0 * np.pi * phase / end
        table = np.column_stack([phase, 20.0 * np.sin(part) + 5.0 * np.cos(2.0 * part), 40.0 * np.cos(part) - 10.0])
        if edit is not None:
            table = edit(table)
        path = tmp_path / "walk.csv"
        path.write_text(header + "\n" + "\n".join(",".join(f"{x:.9g}" for x in row) for row in table) + "\n")
        return path

    return write


@pytest.mark.parametrize("closed", [True, False])
def test_derivatives_are_those_of_the_motion(written, closed):
    cycle = read_cycle(written(closed=closed), stride_time=1.25)
    part, rate = 2.0 * np.pi * np.arange(POINTS_PER_CYCLE) / POINTS_PER_CYCLE, 2.0 * np.pi / 1.25
    np.testing.assert_allclose(cycle.angle, np.radians(20.0 * np.sin(part) + 5.0 * np.cos(2 * part)), atol=1e-7)
    velocity = np.radians(20.0 * np.cos(part) - 10.0 * np.sin(2 * part)) * rate
    acceleration = np.radians(-20.0 * np.sin(part) - 20.0 * np.cos(2 * part)) * rate**2
    np.testing.assert_allclose(cycle.velocity, velocity, atol=1e-6)
    np.testing.assert_allclose(cycle.acceleration, acceleration, atol=1e-5)
    np.testing.assert_allclose(cycle.torque, 40.0 * np.cos(part) - 10.0, atol=0.05)
    assert cycle.relative_residual < 1e-6


def test_rows_that_are_not_even_leave_nothing_free(written):
    """As digitised from a figure: every second row of the first half, every seventh of the other."""

    def digitised(table):
        return np.vstack([table[:50:2], table[50::7], table[-1:]])

    whole, thinned = (read_cycle(written(edit=edit), stride_time=1.25) for edit in (None, digitised))
    assert thinned.harmonics == 7
    assert thinned.notes == ("7 harmonics of the angle are kept: its rows are too far apart for 10",)
    np.testing.assert_allclose(thinned.velocity, whole.velocity, atol=1e-4)
    assert not whole.notes


@pytest.mark.parametrize("away", [slice(40, 55), slice(88, 100)])
def test_a_gap_in_which_the_angle_could_go_anywhere_is_refused(written, away):
    def dropped(table):
        return np.delete(table, away, axis=0)

    with pytest.raises(InputError, match=r"nothing is told from .* of the cycle; rows less than 12.5% apart"):
        read_cycle(written(edit=dropped, rows=101, closed=False), stride_time=1.25)


def test_other_units_say_the_same(written):
    first = read_cycle(written(), stride_time=1.25)

    def other(table):
        return table * [1.25 / 100.0, np.pi / 180.0, 1.0 / 80.0]

    path = written("time_s,angle_rad,torque_Nm_per_kg", edit=other)
    second = read_cycle(path, body_mass=80.0)  # closed, so that it tells its own period
    assert second.period == pytest.approx(1.25)
    np.testing.assert_allclose(second.velocity, first.velocity, atol=1e-6)
    np.testing.assert_allclose(second.torque, first.torque, atol=1e-6)


def test_noise_of_an_angle_does_not_become_acceleration(written):
    rng = np.random.default_rng(1)

    def shaken(table):
        table[:-1, 1] += rng.normal(0.0, 0.1, len(table) - 1)
        return table

    clean = read_cycle(written(), stride_time=1.0)
    noisy = read_cycle(written(edit=shaken), stride_time=1.0)
    assert np.std(noisy.acceleration - clean.acceleration) < 0.2 * np.std(clean.acceleration)
    assert 0.001 < noisy.relative_residual < 0.01
    assert not noisy.notes


def slipped(*rows, by):
    def edit(table):
        table[list(rows), 1] += by
        return table

    return edit


@pytest.mark.parametrize("closed", [True, False])
def test_a_single_sample_that_the_series_smooths_away_is_told_with_its_line(written, closed):
    cycle = read_cycle(written(edit=slipped(50, by=80.0), closed=closed), stride_time=1.1)
    (note,) = cycle.notes
    assert note.startswith(f"10 harmonics leave out {100.0 * cycle.relative_residual:.1f} % of the angle's range (rms)")
    assert "; line 52 alone is " in note


def test_samples_that_are_many_are_told_without_a_line(written):
    (note,) = read_cycle(written(edit=slipped(*range(5, 100, 10), by=20.0)), stride_time=1.1).notes
    assert "line" not in note
    assert "10 harmonics leave out" in note


def test_a_small_slip_of_one_sample_is_told_too(written):
    cycle = read_cycle(written(edit=slipped(50, by=6.0)), stride_time=1.1)
    assert cycle.relative_residual < 0.02
    assert "; line 52 alone is 15% of it off what the others tell" in cycle.notes[0]  # 6 of 40 deg


def test_an_angle_that_begins_again_sharply_is_no_slip_of_a_sample(written):
    """A heel strike: from one row to the next the angle turns, and within 3 % of the cycle back."""

    def struck(table):
        table[:, 1] += 15.0 * np.exp(-table[:, 0] / 15.0) * (1.0 - np.exp(-table[:, 0] / 1.5))
        return table

    assert not read_cycle(written(edit=struck), stride_time=1.1).notes


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), rows=st.integers(22, 101))
def test_noise_is_no_slip(seed, rows):
    rng = np.random.default_rng(seed)
    part = np.arange(rows) / rows
    angle = np.sin(2.0 * np.pi * part) + rng.normal(0.0, 0.1, rows)
    assert "line" not in "".join(
        _residual_and_notes(part, angle, _series(part, angle, 10, part)[3], list(range(rows)), 10)[1]
    )


def cut(table):
    return table[:60]


def beyond(table):
    table[:, 0] *= 1.09
    return table


def jump(table):
    table[50:, 1] += 15.0
    return table


@pytest.mark.parametrize(
    ("how", "options", "message"),
    [
        ({"header": "cycle_percent,angle,torque_Nm"}, {}, ": line 1: one column angle_rad or angle_deg was expected"),
        ({"header": "cycle_percent,angle_deg,torque"}, {}, "torque_Nm or torque_Nm_per_kg was expected for torque"),
        ({"header": "t,angle_deg,torque_Nm"}, {}, "cycle_percent or time_s was expected for phase"),
        ({"header": "cycle_percent,angle_rad,torque_Nm"}, {}, "angle_rad ranges over 40"),
        ({"header": "cycle_percent,angle_deg,torque_Nm_per_kg"}, {"body_mass": 70.0}, "is it torque_Nm or another"),
        ({"edit": lambda table: table * [1, 1, 1000]}, {}, "torque_Nm reaches 50000, at most 2000"),
        ({}, {"stride_time": None}, "cycle_percent needs --stride-time"),
        ({}, {"stride_time": 0.0}, "stride time 0 s: from 0.05 to 60 s"),
        ({"edit": cut}, {}, "cycle_percent goes from 0 to 59 %: one whole cycle of 100 % was expected"),
        ({"edit": beyond, "rows": 100_000}, {}, "goes from 0 to 109 %: one whole cycle of 100 % was expected"),
        (
            {"header": "time_s,angle_deg,torque_Nm", "end": 90.0},
            {"stride_time": None},
            "a cycle of 90 s; from 0.05 to 60",
        ),
        ({"edit": jump}, {}, "angle ends 0.262 rad from where it began"),
        ({"edit": lambda table: table[::-1]}, {}, "walk.csv: line 3, column 'cycle_percent': 99 is not after 100"),
        ({"edit": lambda table: table * [1, np.nan, 1]}, {}, "walk.csv: line 2, column 'angle_deg': nan: a number"),
        ({"rows": 5}, {}, "5 rows below the header"),
        ({"edit": lambda table: table * [1, 1, 0]}, {}, "torque_Nm is 0 throughout"),
    ],
    ids=lambda value: "" if callable(value) else None,
)
def test_what_is_no_cycle_is_refused(written, how, options, message):
    with pytest.raises(InputError) as caught:
        read_cycle(written(**how), **({"stride_time": 1.0} | options))
    assert message in str(caught.value)
    assert len(caught.value.faults) == 1


def test_of_a_row_without_numbers_the_first_cell_is_told(written):
    path = written()
    path.write_text("cycle_percent,angle_deg,torque_Nm\n0,1,2\nx,y,z\n")
    with pytest.raises(InputError) as caught:
        read_cycle(path, stride_time=1.0)
    (fault,) = caught.value.faults
    assert "line 3, column 'cycle_percent': 'x' is not a number" in fault


def test_torque_per_mass_needs_a_mass(written):
    path = written("cycle_percent,angle_deg,torque_Nm_per_kg", edit=lambda table: table / [1, 1, 80])
    with pytest.raises(InputError, match="needs --body-mass, from 1 to 500 kg; found none"):
        read_cycle(path, stride_time=1.0)
    with pytest.raises(InputError, match="from 1 to 500 kg; found -1 kg"):
        read_cycle(path, stride_time=1.0, body_mass=-1.0)


def test_cells_that_decimal_commas_have_moved_are_refused(written):
    path = written()
    path.write_text(path.read_text().replace("\n", ",0\n").replace(",0\n", "\n", 1))
    with pytest.raises(InputError, match=r"line 2: 4 cells where 3 were expected; is a decimal comma"):
        read_cycle(path, stride_time=1.0)


def test_a_file_that_is_not_there_or_no_text(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_cycle(tmp_path / "walk.csv", 1.0)
    (tmp_path / "walk.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not utf-8-sig at byte 0"):
        read_cycle(tmp_path / "walk.csv", 1.0)
    (tmp_path / "walk.csv").write_text("")
    with pytest.raises(InputError, match="one column cycle_percent or time_s was expected for phase"):
        read_cycle(tmp_path / "walk.csv", 1.0)
