"""A diagnosis as text: every line within its width, in the order of the questions."""

from dataclasses import replace

import pytest

from leactl.gap.diagnosis import Cause, DiagnosisResult, Shrinkage
from leactl.report import gap_words
from leactl.report.gap_text import render
from leactl.report.gap_words import closed_count_text, residual_text, rest_text
from tests.report.answers import answer, picture, rest


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
@pytest.mark.parametrize("width", [40, 60, 80, 100, 200])
def test_no_line_is_wider_than_the_terminal(width, encoding):
    said = answer(notes=("the replay of a, b and c starts again every second " * 4,))
    text = render(replace(said, unexplained=rest()), width, encoding)
    assert max(map(len, text.splitlines())) <= width
    assert text.isascii() or encoding == "utf-8"
    assert text.endswith("\n")


def test_the_parts_stand_in_the_order_of_the_questions():
    text = render(answer())
    parts = ["verdict: effect. The model lacks one of", "causes", "gap (RMS)", "where", "calibration", "note: "]
    places = [text.index(f"\n{part}" if part != parts[0] else part) for part in parts]
    assert places == sorted(places)


def test_only_channels_with_a_gap_are_listed_and_the_others_counted():
    lines = render(answer()).splitlines()
    assert "torque, locked           0.333   0.0101  0.00912  N*m    100 % (98 .. 100)" in lines
    assert "velocity, coupled, test  0.208   0.0454  0.0216   rad/s  87 % (84 .. 90)" in lines
    assert not any(line.startswith("velocity, coupled, load") for line in lines)
    assert "1 of 3 channels are within 1.1 times their floor, 1 of them by calibration" in lines


def test_a_wide_terminal_has_the_nominal_numbers_too():
    lines = render(answer(), 120).splitlines()
    row = next(line for line in lines if line.startswith("torque, locked ") and "0.412" in line)
    assert row.split()[2:6] == ["0.412", "0.333", "0.0101", "0.00912"]
    assert "viscous_damping  0.0238   0.02514 ± 0.00021  N*m*s/rad  +5.62 %" in lines


def test_without_an_effect_the_table_shows_what_calibration_did():
    lines = render(answer(verdict="calibration", causes=())).splitlines()
    assert "gap (RMS)                nominal  calibrated  floor           over floor" in lines
    assert "torque, locked           0.412    0.333       0.00912  N*m    36.5 x" in lines
    closed = replace(answer().shrinkage[1], role="test")
    lines = render(answer(verdict="calibration", causes=(), shrinkage=(closed,))).splitlines()
    assert "velocity, coupled  0.464    0.0236      0.0226  rad/s  1.04 x" in lines


def test_a_row_that_is_too_long_goes_on_below():
    long = replace(answer().shrinkage[2], quantity="housing_temperature", closed_low=-22.53, closed_high=31.0)
    lines = render(answer(shrinkage=(long, answer().shrinkage[0])), 76).splitlines()
    place = lines.index("    100 % (-2253 .. 3100)")
    assert lines[place - 1] == "housing_temperature, locked  0.333   0.0101  0.00912  N*m"
    assert lines[place + 1] == "velocity, coupled            0.208   0.0454  0.0216   rad/s  87 % (84 .. 90)"


def test_causes_have_parameters_class_and_experiment():
    text = render(answer())
    assert "  0.98  saturation\n          knee   21.37 ± 0.24 A\n          order  82\n" in text
    assert (
        "          cannot be told from torque_sensor_gain\n          to separate: leactl run separate-by-grid\n" in text
    )
    assert "          over q-axis current: 0.413 N*m before, 0.00130 N*m after" in text


def test_a_fault_of_the_set_up_is_nothing_that_the_model_lacks():
    lacking = answer().causes
    fault = Cause("channel_sign", 0.99, 1.0, (), family="setup", change="give it `sign: -1` in the mapping")
    alone, both = (render(answer(causes=causes), 120) for causes in ((fault,), (fault, *lacking)))
    assert alone.startswith("verdict: effect. The set-up has channel_sign.\n")
    assert "floor           over floor\n" in alone  # with no effect nothing is closed
    assert "with the effects" not in alone
    assert "Gaps are of the runs once the set-up is mended." in alone
    assert "Gaps are of the runs once the set-up is mended." in both
    assert "before: the calibrated model; after: with the effects" in both
    assert (
        "The set-up has channel_sign; with it mended, the model lacks one of saturation / torque_sensor_gain." in both
    )


def test_what_is_not_explained_is_described():
    text = render(answer(verdict="unknown", causes=(), unexplained=rest()), 120)
    assert "\nnot explained: torque, coupled (coupled_torque)\n" in text
    assert "it follows velocity and q-axis current: a free function closes 97 % of the gap on held-out runs" in text
    assert "near: quadratic_drag, refused: the set explains 11 %" in text
    assert "to decide: leactl run separate-by-grid" in text


@pytest.mark.parametrize(
    ("depends_on", "closable", "words"),
    [
        (("time",), 0.0, "it changes slowly with time, each stretch of a run like its neighbours"),
        (
            (),
            0.02,
            "nor changes slowly with time; a free function of the logged state closes 2 %",
        ),
        ((), None, "held-out runs leave no gap beyond noise there"),
        (
            ("angle", "time"),
            0.4,
            "closes 40 % of the gap on held-out runs; what that leaves changes slowly",
        ),
    ],
)
def test_time_and_nothing_logged_are_answers_too(depends_on, closable, words):
    assert words in rest_text(rest(depends_on=depends_on, closable=closable))


def test_what_repeats_in_time_is_told_with_how_often():
    alone = rest_text(rest(depends_on=("time",), repeats_Hz=1.6967, closable=0.01))
    assert "it repeats in time, 1.697 times a second, whatever the state is; a free function" in alone
    beside = rest_text(rest(depends_on=("angle", "time"), repeats_Hz=1.6967, closable=0.4))
    assert "on held-out runs; what that leaves repeats in time, 1.697 times a second" in beside


@pytest.mark.parametrize(
    ("along", "sign"),
    [
        (None, ""),
        ("velocity", " x sign of velocity"),
        ("rate of change of the angle", " x sign of rate of change of the angle"),
    ],
)
def test_a_residual_names_what_its_sign_is_from(along, sign):
    assert residual_text(picture(along=along)) == f"torque, locked: residual{sign}"


def test_a_channel_that_never_had_a_gap_is_not_closed_by_calibration():
    still = Shrinkage("velocity", "test", "free", "rad/s", 0.0, 0.0, 0.0, 0.0)
    assert closed_count_text([still]) == "1 of 1 channels are within 1.1 times their floor"


def test_the_multiple_of_the_floor_that_is_printed_is_the_one_that_decides(monkeypatch):
    monkeypatch.setattr(gap_words, "LEAST_GAP_FLOORS", 1.25)
    assert closed_count_text([]) == "0 of 0 channels are within 1.25 times their floor"


def test_five_regions_at_most():
    first = answer().where[0]
    many = tuple(replace(first, quantity=f"q{k}") for k in range(8))
    text = render(answer(where=many))
    assert sum(line.startswith("q") and "0.333 N*m" in line for line in text.splitlines()) == 5
    assert "and 3 more with a smaller gap" in text


def test_an_answer_without_a_gap_is_short():
    assert render(DiagnosisResult("none", 0.003)) == (
        "verdict: none. The model explains these runs; no effect is missing.\n"
        "probability that something unexplained acts: < 0.01\n"
    )


@pytest.mark.parametrize(("floors", "told"), [(5.0, False), (7.0, True)])
def test_a_replay_that_stands_farther_off_than_a_right_model_s_may_is_said_beside_a_sound_verdict(floors, told):
    line = Shrinkage("velocity", "test", "free", "rad/s", 0.02 * floors, 0.01 * floors, 0.01 * floors, 0.01)
    for verdict in ("none", "calibration"):
        text = " ".join(render(DiagnosisResult(verdict, 0.003, shrinkage=(line,))).split())
        assert (f"but a replay of velocity, free stands {floors:.3g} floors off." in text) is told


def test_a_name_cannot_steer_the_terminal():
    assert "\x1b" not in render(answer(notes=("\x1b[2J\udcff",)))
    render(answer(notes=("\udcff",))).encode("utf-8")
