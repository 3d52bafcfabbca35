"""Numbers as the GUM rounds them, and plots a person can read."""

import math

import pytest

from leactl.analysis.estimate import NAN, Estimate, Plot, Result, Series
from leactl.report.plot import draw
from leactl.report.terminal import aligned, interval_text, render, value_text


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (100.02147, 0.00035, "100.02147 ± 0.00035"),  # GUM 7.2.2
        (0.49, 0.0996, "0.49 ± 0.10"),
        (0.4851, 0.00104, "0.4851 ± 0.0010"),
        (12345.6, 234.0, "12350 ± 230"),
        (9.97, 9.96, "10 ± 10"),
        (-0.000036, 0.000061, "-0.000036 ± 0.000061"),
        (0.5, 0.0, "0.5 ± 0"),
        (-4e-9, 5.2e-6, "0.0000000 ± 0.0000052"),
        (5.0, NAN, "5.0000"),
        (NAN, NAN, "not known"),
    ],
)
def test_values_have_two_digits_of_their_uncertainty(value, std, text):
    assert value_text(Estimate("x", value, std, NAN, NAN, "A")) == text


def test_tiny_uncertainties_are_written_with_exponents():
    assert value_text(Estimate("x", 0.25, 1.5e-12, NAN, NAN, "A")) == "2.500000000000e-01 ± 1.5e-12"


def test_r_squared_is_never_rounded_to_one():
    assert value_text(Estimate("r_squared", 1 - 3.2e-7, NAN, NAN, NAN, "1")) == "0.9999997"
    assert value_text(Estimate("r_squared", 0.93214, NAN, NAN, NAN, "1")) == "0.9321"


def test_intervals_have_the_digits_of_the_value():
    assert interval_text(Estimate("x", 0.49, 0.0012, 0.48764, 0.49236, "A")) == "0.4876 .. 0.4924"
    assert interval_text(Estimate("x", 0.49, NAN, NAN, NAN, "A")) == ""


def test_a_text_that_nothing_follows_widens_no_column():
    rows = [("a", "1.0", "0 .. 2"), ("  paper", "a long remark of the paper's", "")]
    assert aligned(("", "value", "interval"), rows).splitlines() == [
        "         value  interval",
        "a        1.0    0 .. 2",
        "  paper  a long remark of the paper's",
    ]


def test_a_logarithmic_axis_spaces_decades_evenly_and_takes_zero_to_its_edge():
    response = Series("gain", (1.0, 10.0, 100.0), (0.0, 1.0, 2.0))
    lines = draw(
        Plot("frequency [Hz]", "gain [dB]", (response,), (Series("level", (0.0, 100.0), (1.0, 1.0)),), x_log=True), 60
    )
    columns = [line.index("o", 4) for line in reversed(lines[1:]) if "o" in line[4:]]
    assert abs((columns[1] - columns[0]) - (columns[2] - columns[1])) <= 1
    assert lines[-1].split() == ["1", "3", "10", "30", "100"]


LINE = Plot(
    "current [A]",
    "torque [N*m]",
    (Series("rising", (0.0, 10.0), (0.0, 5.0)), Series("falling", (0.0, 5.0), (0.0, math.nan))),
    (Series("rising", (0.0, 10.0), (0.0, 5.0)),),
)


@pytest.mark.parametrize("ascii_only", [False, True])
@pytest.mark.parametrize("width", [40, 80])
def test_points_lie_where_the_axes_say(width, ascii_only):
    lines = draw(LINE, width, ascii_only=ascii_only)
    assert max(map(len, lines)) <= width
    assert "".join(lines).isascii() == ascii_only
    floor = next(k for k, line in enumerate(lines) if line.lstrip().startswith("+-" if ascii_only else "└"))
    assert "* several" in " ".join(lines[:2])
    body = lines[floor - 16 : floor]
    column_of_o = next(line.index("o") for line in body if "o" in line)
    row_of_o = next(k for k, line in enumerate(body) if "o" in line)
    assert abs(lines[floor + 1].index("10") - column_of_o) <= 1
    assert body[row_of_o].startswith("5")
    row_of_zero = next(k for k, line in enumerate(body) if line.startswith("0"))
    assert "*" in body[row_of_zero]


def test_a_plot_without_points_is_left_out():
    nothing = Series("x", (math.nan,), (1.0,))
    assert draw(Plot("a", "b", (nothing,), ()), 80) == []


def test_one_point_has_a_plot():
    assert any("o" in line for line in draw(Plot("a", "b", (Series("x", (2.0,), (0.0,)),), ()), 80)[1:])


def test_a_path_is_not_broken(tmp_path):
    path = "runs/" + "long-name-" * 12 + "7f3a.h5"
    result = Result("a trial", (path, "b.h5"), (Estimate("x", 1.0, 0.1, 0.8, 1.2, "A"),))
    assert path in render(result, 80)
