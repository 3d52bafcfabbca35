"""The page says what the answer says, asks nothing of a network, and fits a telephone and a wide screen."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.gap.diagnosis import Cause, DiagnosisResult, Region, Shrinkage
from leactl.report.chart import LineMarks
from leactl.report.gap_page import page
from leactl.report.gap_text import render
from leactl.report.gap_words import three_digits
from leactl.report.plot import PlotAxis
from tests.report.answers import LOCKED, answer, picture, profile, rest, trace
from tests.report.browser import look, needs_chromium

VOID = {"meta"}


class Outline(HTMLParser):
    """Tags in the order in which they open, each closed in its turn."""

    def __init__(self):
        super().__init__()
        self.open, self.seen, self.attributes = [], [], []

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.attributes += [name for name, _ in attrs]
        self.open += [] if tag in VOID else [tag]

    def handle_startendtag(self, tag, attrs):
        self.seen.append(tag)
        self.attributes += [name for name, _ in attrs]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def tree(diagnosis):
    return ElementTree.fromstring(page(diagnosis))


def words(element):
    return " ".join("".join(element.itertext()).split())


def rows(root, heading):
    """Cells of the table whose first heading says so."""
    table = next(t for t in root.iter("table") if t.find("thead/tr/th").text == heading)
    return [[words(cell) for cell in row] for row in table.find("tbody")]


def by_class(root, name):
    return [element for element in root.iter() if name in element.get("class", "").split()]


@pytest.mark.parametrize("verdict", ["none", "calibration", "effect", "unknown"])
def test_every_tag_is_closed_and_nothing_is_fetched(verdict):
    text = page(answer(verdict=verdict))
    outline = Outline()
    outline.feed(text)
    outline.close()
    assert outline.open == []
    assert not {"script", "link", "img", "iframe", "object", "embed", "use", "image"} & set(outline.seen)
    assert not {"src", "href", "srcset", "xlink:href", "action", "onload"} & set(outline.attributes)
    assert not re.search(r"://|url\(|@import|javascript:", text)
    assert "default-src 'none'" in next(m for m in tree(answer()).iter("meta") if m.get("http-equiv")).get("content")


def test_the_same_answer_gives_the_same_page():
    assert page(answer()) == page(answer())


def test_the_verdict_names_a_class_as_one_cause():
    said = words(by_class(tree(answer()), "headline")[0])
    assert "The model lacks one of saturation / torque_sensor_gain." in said
    assert "Probability that something unexplained acts: 0.02." in said
    assert "Largest gap: torque, locked, 0.333 N*m after calibration, 0.0101 with the effects, floor 0.00912" in said


def test_causes_stand_with_probability_parameters_class_and_experiment():
    first, second, third = by_class(tree(answer()), "causes")[0]
    assert words(first).startswith("saturation0.98 The torque constant falls at high current.")
    bar = first.find("div[2]/i")
    assert bar.get("style") == "width:98.1%"
    said = words(first)
    assert "knee 21.37 ± 0.24 A" in said
    assert "order 82" in said
    assert "Cannot be told from torque_sensor_gain with these runs." in said
    assert first.find(".//code").text == "leactl run separate-by-grid"
    assert "Cannot be told from saturation" in words(second)
    assert words(third).startswith("cogging0.01")


def test_tables_have_the_numbers_of_the_answer():
    diagnosis = answer()
    root = tree(diagnosis)
    damping, ambient = rows(root, "parameter")
    assert damping == ["viscous_damping", "0.0238", "0.02514 ± 0.00021", "N*m*s/rad", "+5.62 %"]
    assert ambient == ["ambient_offset", "0", "0.0029 ± 0.0024", "K", ""]
    shrunk, located = (table for table in (rows(root, "channel"), rows_of_where(root)))
    assert [row[0] for row in shrunk] == ["torque, locked", "velocity, coupled, test", "velocity, coupled, load"]
    item = diagnosis.shrinkage[2]
    for cell, value in zip(
        shrunk[0][1:5], (item.nominal_rms, item.calibrated_rms, item.augmented_rms, item.floor_rms), strict=True
    ):
        assert float(cell) == pytest.approx(value, rel=0.006)
    assert shrunk[0][5:] == ["N*m", "100 % (98 .. 100)"]
    assert shrunk[2][-1] == "no gap"
    assert located[0][-2:] == ["36.5 x", "q_axis_current 14.0 to 24.5 A, 83 %"]
    assert located[1][-1] == "direction backward, 91 %"
    assert len(located) == 2  # the third channel has no gap


def rows_of_where(root):
    tables = [t for t in root.iter("table") if t.find("thead/tr/th").text == "channel"]
    return [[words(cell) for cell in row] for row in tables[1].find("tbody")]


def test_bars_are_logarithmic_multiples_of_the_floor():
    root = tree(answer())
    cards = [card for card in by_class(root, "card") if by_class(card, "bars")]
    assert [words(card.find("h3")).split("closed")[0] for card in cards] == [
        "torque, locked",
        "velocity, coupled, test",
    ]
    widths = [float(re.search(r"width:([\d.]+)%", i.get("style"))[1]) for i in cards[0].iter("i")]
    assert max(widths) == 100.0  # nominal, 45 floors, is the longest of the page
    nominal, calibrated, _, floor = widths
    expected = np.log(0.4118 / 0.3327) / np.log(0.4118 / 0.009123)
    assert (nominal - calibrated) / (nominal - floor) == pytest.approx(expected, rel=1e-3)


def test_curves_lie_where_the_axes_say():
    root = tree(answer(where=answer().where[:1]))
    _, figure_, residuals = root.iter("figure")
    measured = next(p for p in figure_.iter("path") if p.get("class") == "curve measured")
    after = next(p for p in figure_.iter("path") if p.get("class") == "curve augmented")
    points, shifted = (
        np.array([[float(v) for v in pair.split()] for pair in re.split("[ML]", path.get("d")) if pair])
        for path in (measured, after)
    )
    assert len(points) == 200
    assert np.all(np.diff(points[:, 0]) > 0)
    assert np.all(points[:, 1] >= shifted[:, 1])  # downwards: the augmented model is above the measurement
    shown = trace(LOCKED)
    assert np.corrcoef(points[:, 1], shown.measured)[0, 1] < -0.999
    styles = [p.get("class") for p in residuals.iter("path")]
    assert {"area region", "area calibrated", "area augmented", "area floor"} <= set(styles)


def test_an_effect_has_its_residual_over_what_it_acts_in_before_and_after():
    [card] = by_class(tree(answer()), "pictures")[0]
    said = words(card)
    assert said.startswith("saturation0.413 N*m before, 0.00130 N*m after (RMS of 12 means)")
    assert "off zero in 10 bins before, in 1 after" in said
    assert "torque, locked: residual [N*m]" in said
    assert "q-axis current [A]" in said
    drawn = {p.get("class"): p.get("d") for p in card.iter("path")}
    assert drawn["curve calibrated"].count("M") == drawn["curve augmented"].count("M") == 11  # one has too few samples
    heights = [float(part.split()[1].split("H")[0]) for part in drawn["curve calibrated"].split("M")[1:]]
    assert heights == sorted(heights, reverse=True)  # upwards, as the cube of the current


def test_an_effect_that_is_left_out_alone_is_drawn_under_words_of_its_own():
    said = answer()
    alone = replace(said.causes[0], picture=replace(picture(), refitted=False))
    shown = words(by_class(tree(replace(said, causes=(alone,))), "pictures")[0])
    assert "before: left out, else as with it" in shown
    assert "before: calibrated without it" not in shown
    assert "before is the effect left out, all else as fitted with it" in shown


def test_what_is_not_explained_has_its_shape_and_the_effects_that_come_near():
    root = tree(answer(verdict="unknown", causes=(), unexplained=rest()))
    part = next(s for s in root.iter("section") if s.find("h2").text == "What is not explained")
    said = words(part)
    assert "torque, coupled (coupled_torque): it follows velocity and q-axis current" in said
    assert "quadratic_drag: the set explains 11 %" in said
    assert part.find(".//code").text == "leactl run separate-by-grid"
    assert len(list(part.iter("svg"))) == 2
    assert said.count("beyond a free function of the state") == 2


def test_a_wave_over_the_angle_is_said_to_be_laid_on_itself():
    said = answer()
    wave = replace(said.causes[0], picture=picture("angle", 14.0, "velocity"))
    shown = words(by_class(tree(replace(said, causes=(wave,))), "pictures")[0])
    assert "angle within one of 14 periods of a turn" in shown
    assert "residual x sign of velocity" in shown


def test_without_an_effect_the_page_compares_before_and_after_calibration():
    shown = trace(LOCKED)
    same = replace(shown, augmented=shown.calibrated)
    over = profile(LOCKED)
    over = replace(over, mean=over.mean[[0, 1, 1]], std=over.std[[0, 1, 1]])
    said = page(answer(verdict="calibration", causes=(), extra={"traces": (same,), "profiles": (over,)}))
    assert said.count("before (nominal)") == said.count("after (calibrated)") == 4  # keys and descriptions
    assert "after (augmented)" not in said


@pytest.mark.parametrize(("floor", "remark"), [(0.01, "5.00 x its floor after calibration"), (0.0, "no floor")])
def test_a_channel_without_a_floor_is_no_multiple_of_it(floor, remark):
    line = replace(answer().shrinkage[0], calibrated_rms=0.05, augmented_rms=0.05, floor_rms=floor)
    said = page(DiagnosisResult("calibration", 0.0, shrinkage=(line,)))
    assert f">{remark}<" in said


@pytest.mark.parametrize(
    "diagnosis",
    [
        DiagnosisResult("none", 0.0),
        answer(extra={}),
        answer(shrinkage=(replace(answer().shrinkage[0], floor_rms=0.0, augmented_rms=0.0),)),
        answer(shrinkage=(replace(answer().shrinkage[0], nominal_rms=np.nan),), unexplained_probability=np.nan),
        answer(extra={"traces": (replace(trace(LOCKED), measured=np.full(200, np.nan)),)}),
        answer(extra={"traces": (trace(LOCKED, 0),), "profiles": ()}),
    ],
)
def test_a_page_comes_of_an_answer_with_little_in_it(diagnosis):
    root = tree(diagnosis)
    assert words(root.find("body/main/h1")) == "Gap between model and bench"
    assert "nan" not in re.sub(r"[a-z]*nan[a-z]+", "", words(root.find("body")))


@given(st.text(st.characters(exclude_characters="\r"), min_size=1))
def test_every_text_is_escaped(words_):
    said = answer()
    cause = said.causes[0]
    parameter = replace(cause.parameters[0], name=words_, units=words_)
    hostile = replace(
        said,
        where=(replace(said.where[0], quantity=words_, region=Region(words_, 0.0, 1.0, words_)), *said.where[1:]),
        causes=(replace(cause, effect=words_, parameters=(parameter,), indistinguishable_from=(words_,)),),
        calibration=(replace(said.calibration[0], parameter=words_, units=words_),),
        shrinkage=(replace(said.shrinkage[0], quantity=words_, units=words_),),
        notes=(words_,),
        extra={"traces": (trace((words_, "test", "locked"), run=words_),)},
    )
    root = tree(hostile)
    shown = re.sub("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]", "\ufffd", words_)
    assert root.find("body/main/section/ul/li").text == shown
    assert next(e for e in by_class(root, "name")).text == shown
    assert {element.tag for element in root.iter()} == {element.tag for element in tree(said).iter()}


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0"),
        (0.0216, "0.0216"),
        (0.09997, "0.100"),
        (9.994, "9.99"),
        (-9.996, "-10.0"),
        (999.6, "1000"),
        (12345.6, "12346"),
        (-14.0, "-14.0"),
        (1.5e-7, "1.50e-07"),
        (np.nan, "not known"),
    ],
)
def test_figures_have_three_digits(value, shown):
    assert three_digits(value) == shown


@needs_chromium
def test_nothing_overflows_in_a_browser(tmp_path):
    long = "a_quantity_with_a_name_that_is_longer_than_any_screen_of_a_telephone_is_wide"
    said = answer(notes=("x" * 300, *answer().notes))
    said = replace(said, where=(*said.where, replace(said.where[0], quantity=long)), unexplained=rest())
    fault, _, _ = look(tmp_path, page(said), (360, 1400), ("light",))
    assert fault == "fits"


def test_a_curve_has_a_gap_where_points_were_left_out():
    time = np.concatenate([np.arange(20.0), 300.0 + np.arange(20.0)])
    for part, strokes in ((time, 2), (time[:20], 1)):
        axes = PlotAxis(part.tolist(), 5), PlotAxis([-1.0, 1.0], 5)
        [path] = LineMarks("measured", "measured", part, np.sin(part)).paths(*axes)
        assert path.d.count("M") == strokes


@pytest.mark.parametrize("low, named", [(-16.9, True), (-0.01, True), (None, True), (0.02, False)])
def test_an_effect_that_closes_nothing_has_no_full_bar(low, named):
    held_out = (Shrinkage(*LOCKED, "N*m", 0.002, 0.006, 0.058, 0.001, None if low is None else low + 0.1, low, 0.5),)
    said = answer(shrinkage=held_out)
    bars = re.findall(r'<div class="(bar[^"]*)"><i style', page(said))
    assert bars and ("bar" not in bars) is named
    assert ("No gap of held-out runs shrinks" in page(said)) is named
    assert ("No gap of held-out runs shrinks" in " ".join(render(said).split())) is named


def test_a_fault_of_the_set_up_closes_nothing_and_its_line_is_code():
    fault = Cause("channel_sign", 0.99, 1.0, (), family="setup", change="give it `sign: <b>` in the mapping")
    text = page(answer(causes=(fault,)))
    assert "To mend it: give it <code>sign: &lt;b&gt;</code> in the mapping." in text
    assert "with the effects" not in text
    assert "Gaps are of the runs once the set-up is mended." in text
    assert ">augmented</span>" not in text
