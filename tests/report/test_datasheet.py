"""The datasheet says what the analyses say, leaves no run out, and leads from each figure to its runs."""

import json
import re
from functools import cache
from html import escape
from importlib.metadata import EntryPoint
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.analysis import registry
from leactl.analysis.analyze import analyze_runs
from leactl.analysis.analyze import names as experiments
from leactl.analysis.estimate import Band, Estimate, Grid, Plot, Result, Series
from leactl.errors import InputError
from leactl.report.datasheet.figures import heading, pretty
from leactl.report.datasheet.make import DatasheetOutputs, make, refuse_shared
from leactl.report.datasheet.page import page
from leactl.report.datasheet.runset import GroupResult, RunEntry, RunSet, check_options, read_runs
from leactl.report.datasheet.sheet import Datasheet
from leactl.report.terminal import figures_by_condition, interval_text, units_in_paper, value_text
from tests.analysis.synthetic import Bench
from tests.report.browser import dumped, look, needs_chromium
from tests.runfile.specimen import unseal

LEA = "0.49\nname: lea"  # the value of a YAML key, and a key more
COULOMB = {"unloaded": 0.2419, "design": 0.208, "loaded": 0.3037}
NOVEL = '''"""Shakes: how often the thing shakes.

More of it.
"""

from leactl.analysis.estimate import Estimate, Plot, Result, Series


RESULTS = {"shake_rate": "Hz"}


def analyze(runs, gain=1.0):
    x = tuple(float(k) for k in range(60))
    plot = Plot("time [s]", "shake [1]", (Series("shake", x, tuple(k * k for k in x)),), ())
    rate = Estimate("shake_rate", 3.0 * gain, 0.1, 2.8, 3.2, "Hz")
    return Result("shakes", tuple(str(run.path) for run in runs), (rate,), ("said once",), (plot,))
'''


def quiet(step):
    pass


def of(*paths, options=None):
    return Datasheet((read_runs(paths, "R", options or {}, quiet),))


def tree(sheet, out):
    return ElementTree.fromstring(page(sheet, out))


def words(element):
    return " ".join(" ".join(element.itertext()).split())


def table(root, cls="datasheet"):
    result = next(item for item in root.iter("table") if item.get("class") == cls)
    return [[words(cell) for cell in row] for row in result.iter("tr")]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Friction under three conditions, torque of two actuators, and files of which nothing comes."""
    folder = tmp_path_factory.mktemp("spring")
    bench = Bench(folder)
    for condition, f in COULOMB.items():
        trials = f + bench.rng.normal(0.0, 0.002, 3)
        bench.friction(f=trials, condition=condition, torque_constant=LEA)
    bench.torque(kt=0.485, actuator="a1", torque_constant=LEA, scatter=0.01)
    bench.torque(kt=0.495, actuator="a2", torque_constant=LEA, scatter=0.01)
    juggled = bench.torque(protocol="name: x\nanalysis: juggling\n", torque_constant=LEA)
    juggled.rename(folder / 'a "b" <c>&#1?%20é.h5')
    damaged = bench.torque(torque_constant=LEA)
    damaged.write_bytes(damaged.read_bytes()[:-2000])
    (folder / "notes.h5").write_text("no run at all")
    return folder


@pytest.fixture(scope="module")
def sheet(campaign):
    return of(campaign)


def test_rows_are_the_answers_of_the_analyses_beside_the_paper(campaign, sheet):
    rows = table(tree(sheet, campaign / "out.html"))
    paths = sorted(campaign.glob("*friction*.h5"))
    result = analyze_runs(paths)
    for number, condition in enumerate(COULOMB, start=1):
        item = result.find("coulomb_friction", "a1", condition)
        row = next(row for row in rows if row[:2] == ["Coulomb friction", condition])
        assert row[2:6] == ["a1", value_text(item), interval_text(item), "N·m"]
        assert row[6].startswith(f"{COULOMB[condition]:.4f} ± ")
        assert row[7] == sheet.sets[0].entries[number - 1].label
    assert ["winding capacitance", "", "", "not measured", "", "J/K", "22.9", ""] in rows


def test_what_was_measured_stands_before_what_was_not(campaign, sheet):
    values = [row[3] for row in table(tree(sheet, campaign / "out.html")) if len(row) > 3][1:]
    lacking = [value == "not measured" for value in values]
    assert True in lacking
    assert lacking == sorted(lacking)
    assert [*sheet.sections[0].rows][:2] == ["friction", "torque-constant"]


def test_several_actuators_have_a_row_each_and_one_together(campaign, sheet):
    rows = [row for row in table(tree(sheet, campaign / "out.html")) if row[0] == "torque constant" and len(row) > 2]
    assert [row[2] for row in rows] == ["a1", "a2", "2 actuators"]
    values = [float(row[3].split()[0]) for row in rows]
    assert values[2] == pytest.approx((values[0] + values[1]) / 2, abs=1e-4)
    low, high = (float(word) for word in rows[2][4].split(" .. "))
    half = 12.706 * abs(values[1] - values[0]) / 2.0  # Student's t of one degree of freedom, std over the root of two
    assert (high - low) / 2.0 == pytest.approx(half, rel=0.01)


def test_what_gave_nothing_is_listed_with_its_reason(campaign, sheet):
    root = tree(sheet, campaign / "out.html")
    runs = {row[1]: row[-1] for row in table(root, "runs")[1:]}
    assert len(runs) == 8 == len(list(campaign.glob("*.h5")))
    assert "not analysed: no analysis 'juggling' is known; known: back-" in " ".join(runs.values())
    assert runs["notes.h5"].startswith("not analysed: not a")
    lost = [entry.label for entry in sheet.sets[0].entries if entry.fault]
    assert len(lost) == 3
    assert f"nothing came of {', '.join(lost)}" in words(root.find("body"))


def test_a_run_that_spoils_its_group_is_left_out_alone(tmp_path):
    bench = Bench(tmp_path)
    bench.friction(f=0.25)
    spoilt = bench.run("friction", [(0.6, "")], {"q_axis_current": [0.6]}, mechanical="free")
    result = of(tmp_path).sets[0]
    assert [entry.fault for entry in result.entries if entry.path == spoilt] == [
        "no velocity of test; the run has q_axis_current of test"
    ]
    assert result.results[0].result.find("coulomb_friction").value == pytest.approx(0.25)
    assert [entry.path for entry in result.results[0].entries] == [
        path for path in tmp_path.iterdir() if path != spoilt
    ]


def test_values_that_are_not_those_of_their_checksums_give_nothing(tmp_path):
    path = Bench(tmp_path).torque()
    with h5py.File(path, "r+") as file:
        file["streams/loop/torque"][3] = 9.0
    sheet = of(path)
    assert "checksum mismatch" in sheet.sets[0].entries[0].fault
    with pytest.raises(InputError, match=r"torque-constant-0001\.h5: .*checksum mismatch"):
        sheet.refuse_empty()


def test_a_copy_of_a_run_counts_once(tmp_path):
    path = Bench(tmp_path).torque()
    (tmp_path / "copy.h5").write_bytes(path.read_bytes())
    entries = of(tmp_path).sets[0].entries
    assert [entry.fault for entry in entries] == ["", "the same run as R1"]


def test_of_two_copies_the_one_that_is_whole_counts(tmp_path):
    path = Bench(tmp_path).torque()
    (tmp_path / "whole.h5").write_bytes(path.read_bytes())
    with h5py.File(path, "r+") as file:
        file["streams/loop/torque"][3] = 9.0
    damaged, whole = of(tmp_path).sets[0].entries
    assert (whole.path.name, whole.fault) == ("whole.h5", "")
    assert "checksum mismatch" in damaged.fault


def test_motors_have_a_section_each_and_the_sheet_says_so(tmp_path):
    bench = Bench(tmp_path)
    bench.torque(torque_constant=LEA)
    bench.torque(torque_constant="0.14\nname: u8", kt=0.14)
    bench.friction()
    sheet = of(tmp_path)
    assert [section.title for section in sheet.sections] == ["motor not named", "lea", "u8"]
    assert "runs are of 3 motors: motor not named, lea, u8" in sheet.notes[0]
    values = [section.rows["torque-constant"][0].cells[0].estimate for section in sheet.sections]
    assert [value and round(value.value, 2) for value in values] == [None, 0.49, 0.14]


def test_an_experiment_is_taken_by_what_its_result_says(tmp_path, monkeypatch):
    (tmp_path / "plugged").mkdir()
    (tmp_path / "plugged" / "shakes.py").write_text(NOVEL)
    monkeypatch.syspath_prepend(tmp_path / "plugged")
    monkeypatch.setattr(
        registry, "foreign", lambda: {"shakes": EntryPoint("shakes", "shakes", registry.ENTRY_POINT_GROUP)}
    )
    path = Bench(tmp_path).torque(protocol="name: x\nanalysis: shakes\n")
    check_options({"gain": 2.0})
    root = tree(of(path, options={"gain": 2.0}), tmp_path / "out.html")
    row = next(row for row in table(root) if row[0] == "shake rate")
    assert row == ["shake rate", "design", "a1", "6.00 ± 0.10", "2.80 .. 3.20", "Hz", "", "R1"]
    section = next(item for item in root.iter("section") if item.get("id") == "m0-shakes")
    assert [words(item) for item in section.iter("h3")] == ["Shakes"]
    assert words(section.find("p")) == "Shakes: how often the thing shakes."
    assert words(section.find(".//figcaption")) == "shake over time, a1, design; R1"
    with pytest.raises(InputError, match="--set gaim: no analysis takes it"):
        check_options({"gaim": 2.0})


def test_two_sets_stand_side_by_side_with_their_difference(tmp_path):
    for name, f in (("spring", 0.20), ("autumn", 0.23)):
        (tmp_path / name).mkdir()
        bench = Bench(tmp_path / name, np.random.default_rng(len(name)))
        bench.count = len(name) + 10 * (name == "autumn")
        bench.friction(f=f, scatter=0.001, torque_constant=LEA)
    sets = tuple(read_runs([tmp_path / name], label, {}, quiet) for name, label in (("spring", "A"), ("autumn", "B")))
    sheet = Datasheet(sets)
    root = tree(sheet, tmp_path / "out.html")
    head = table(root)[0]
    assert head[2:5] == ["spring", "autumn", "difference"]
    row = next(row for row in table(root) if row[:2] == ["Coulomb friction", "design"])
    assert float(row[4].split()[0]) == pytest.approx(0.03, abs=0.003)
    assert row[-1] == "A1 , B1"
    result = next(
        item for item in sheet.sections[0].rows["friction"] if item.name == "coulomb_friction" and item.difference
    )
    first, second = (cell.estimate for cell in result.cells)
    assert result.difference.std == pytest.approx(np.hypot(first.std, second.std))
    captions = [words(item) for item in root.iter("figcaption")]
    assert captions[:2] == [
        "spring: torque of the current over speed, a1, design; A1",
        "autumn: torque of the current over speed, a1, design; B1",
    ]
    charts = [item for item in root.iter("div") if item.get("class") == "chart"][:2]
    assert len({words(chart.find("div[@class='x']")) for chart in charts}) == 1
    assert len({words(chart.find("div[@class='y']")) for chart in charts}) == 1
    with pytest.raises(InputError, match=r"the same run as .* of the other set"):
        refuse_shared((sets[0], sets[0]))
    json.dumps(sheet.as_json(), allow_nan=False)


def test_sets_under_different_conditions_are_not_compared_and_the_sheet_says_so(tmp_path):
    for name, condition in (("spring", ""), ("autumn", "design")):
        (tmp_path / name).mkdir()
        bench = Bench(tmp_path / name)
        bench.count = len(name)
        bench.friction(condition=condition, torque_constant=LEA)
    sets = tuple(read_runs([tmp_path / name], label, {}, quiet) for name, label in (("spring", "A"), ("autumn", "B")))
    line = "friction: not compared, measured in spring under no condition and autumn under design; "
    assert sum(note.startswith(line) for note in Datasheet(sets).notes) == 1
    assert not any("not compared" in note for note in Datasheet((sets[0], sets[0])).notes)


def one_set(prefix, *told):
    """A set of runs with an estimate for each actuator; None for one that has none."""
    entries = [
        RunEntry(Path(f"{prefix}{k}.h5"), f"{prefix}{k}", "", "lea", "no-load-loss", {"actuator": f"LEA-{k}"})
        for k in range(1, len(told) + 1)
    ]
    answers = []
    for entry, item in zip(entries, told, strict=True):
        result = Result("no-load-loss", (str(entry.path),), () if item is None else (item,))
        answers.append(GroupResult("lea", "no-load-loss", entry.group[0], "design", result, (entry,)))
    return RunSet(prefix, tuple(entries), tuple(answers), {})


def bound(low, high):
    return Estimate("hysteresis_torque", float("nan"), float("nan"), low, high, "N*m")


def known(value):
    return Estimate("hysteresis_torque", value, 0.01, value - 0.02, value + 0.02, "N*m")


def beside(*told):
    """The row of a set with these estimates, beside a set of one actuator with a bound."""
    sheet = Datasheet((one_set("A", *told), one_set("B", bound(0.0, 0.2))))
    [row] = [item for item in sheet.sections[0].rows["no-load-loss"] if item.name == "hysteresis_torque"]
    said = next(row for row in sheet.as_json()["sections"][0]["rows"] if row["name"] == "hysteresis_torque")
    cells = next(item for item in table(tree(sheet, Path("out.html"))) if item[0] == "hysteresis torque")
    return row, said["values"][0], cells


def test_bounds_of_several_actuators_are_compared_by_the_widest():
    _, told, _ = beside(bound(0.01, 0.3), bound(0.0, 0.2))
    assert (told["value"], told["low"], told["high"]) == (None, 0.0, 0.3)
    assert told["runs"] == ["A1", "A2"]
    assert told["actuators"] == ["LEA-1", "LEA-2"]
    alone = Datasheet((one_set("A", bound(0.01, 0.3), bound(0.0, 0.2)),)).sections[0].rows["no-load-loss"]
    assert [row.actuator for row in alone if row.name == "hysteresis_torque"] == ["LEA-1", "LEA-2", "2 actuators"]


@pytest.mark.parametrize("other", [bound(0.0, 0.2), bound(np.nan, np.nan), None])
def test_what_one_actuator_alone_knows_is_compared_and_said_to_be_its_own(other):
    row, said, cells = beside(known(0.1), other)
    assert row.cells[0].estimate.value == 0.1
    assert (said["runs"], said["actuators"]) == (["A1"], ["LEA-1"])
    assert cells[2].endswith("of LEA-1 alone")
    assert "alone" not in cells[3]


def test_a_mean_over_some_actuators_says_of_which():
    row, said, cells = beside(known(0.1), bound(0.0, 0.2), known(0.3))
    assert row.cells[0].estimate.value == pytest.approx(0.2)
    assert (said["runs"], said["actuators"]) == (["A1", "A3"], ["LEA-1", "LEA-3"])
    assert cells[2].endswith("of LEA-1, LEA-3 alone")


def test_points_lie_where_the_axes_say_and_captions_name_their_runs(campaign, sheet):
    root = tree(sheet, campaign / "out.html")
    section = next(item for item in root.iter("section") if item.get("id") == "m0-friction")
    figure = section.find(".//figure")
    assert [match.text for match in figure.findall("figcaption/a")] == ["R1", "R2", "R3"]
    answers = [result for result in sheet.sets[0].results if result.experiment == "friction"]
    drawn = [item for item in figure.iter("path") if item.get("class").startswith("marks dot s")]
    assert [case.get("class") for case in drawn] == [f"marks dot s{k}" for k in range(3)]
    shown = np.concatenate([places(case.get("d")) for case in drawn])
    points = np.concatenate([np.transpose([item.x, item.y]) for a in answers for item in a.result.plots[0].points[:1]])
    for k, sign in ((0, 1.0), (1, -1.0)):
        assert np.corrcoef(shown[:, k], points[:, k])[0, 1] == pytest.approx(sign, abs=1e-4)
    strips = [item for item in section.iter("svg") if item.get("class") == "strip"]
    assert len(strips) == 6
    assert strips[0].get("aria-label").startswith("unloaded, a1: 0.0")


def places(path):
    return np.array([[float(v) for v in pair.split()] for pair in re.findall(r"M([\d. ]+)h0", path)])


def test_every_link_leads_somewhere_and_nothing_is_fetched(campaign, sheet):
    out = campaign.parent / "page.html"
    text = page(sheet, out)
    root = ElementTree.fromstring(text)
    ids = [element.get("id") for element in root.iter() if element.get("id")]
    assert len(ids) == len(set(ids))
    targets = [element.get("href") for element in root.iter("a")]
    inside, outside = ([item for item in targets if item.startswith("#") == kind] for kind in (True, False))
    assert {item[1:] for item in inside} <= set(ids)
    files = [f"{campaign.name}/{item.name}" for item in campaign.glob("*.h5")]
    assert sorted(unquote(item) for item in outside) == sorted(files)
    assert not {"script", "link", "img", "iframe", "object", "embed"} & {element.tag for element in root.iter()}
    assert not re.search(r"://|url\(|@import|javascript:", text)


def with_sensor(path, created, **facts):
    with h5py.File(path, "r+") as file:
        unseal(file)
        file.attrs["created"] = created
        group = file.require_group("instruments/sensor")
        for name, value in facts.items():
            group.attrs[name] = value


def test_instruments_are_listed_with_their_runs_and_what_was_overdue(tmp_path, capsys):
    bench = Bench(tmp_path)
    paths = [bench.torque(kt=0.49, actuator="a1", torque_constant=LEA, scatter=0.01) for _ in range(3)]
    old = {"model": "TRD605", "serial": "815", "calibrated": "2025-01-31", "calibration_due": "2026-01-31"}
    with_sensor(paths[0], "2026-01-31T23:59:00Z", **old)
    with_sensor(paths[1], "2026-02-01T00:01:00Z", **old)
    with_sensor(
        paths[2], "2026-02-03T00:01:00Z", **(old | {"calibrated": "2026-02-02", "calibration_due": "2027-02-02"})
    )
    sheet = make(paths, [], {}, DatasheetOutputs(tmp_path / "sheet.html", False, False))
    labels = {entry.path: entry.label for entry in sheet.sets[0].entries}
    first, second, third = (labels[path] for path in paths)
    rows = table(ElementTree.fromstring((tmp_path / "sheet.html").read_text()), "instruments")
    assert rows[0] == ["device", "model", "serial number", "firmware", "calibrated", "due", "runs"]
    assert rows[1] == [
        "sensor", "TRD605", "815", "", "2025-01-31", f"2026-01-31 overdue in {second}", f"{first} , {second}",
    ]  # fmt: skip
    assert rows[2] == ["sensor", "TRD605", "815", "", "2026-02-02", "2027-02-02", third]
    told = f"sensor: calibration was due 2026-01-31, before {second}"
    assert capsys.readouterr().err.splitlines()[-1] == f"leactl: warning: {told}"
    assert told in sheet.notes
    assert sheet.as_json()["sets"][0]["instruments"][0] == {
        "device": "sensor", **old, "runs": [first, second], "overdue": [second],
    }  # fmt: skip


def test_runs_that_tell_of_no_instrument_have_no_table_of_them(sheet, campaign):
    assert "Instruments" not in page(sheet, campaign / "sheet.html")


def test_the_same_runs_give_the_same_page_however_they_are_given(campaign, sheet):
    files = sorted(campaign.glob("*.h5"), reverse=True)
    assert page(of(*files), campaign / "out.html") == page(sheet, campaign / "out.html")


def sheet_that_says(said):
    """A page whose every text from outside is this one."""
    about = dict.fromkeys(("run_id", "actuator", "condition", "bench", "status", "created", "mechanical"), said)
    entry = RunEntry(Path("x.h5"), "R1", f"name: {json.dumps(said)}\n", said, "friction", about)
    name = re.sub("[/\0\ud800-\udfff]", "", said)  # what no name of a file can hold
    lost = RunEntry(Path(f"{name}.h5"), "R2", fault=said)
    points = Series(said, (0.0, 1.0), (1.0, 2.0))
    estimates = (Estimate(said, 1.0, 0.1, 0.8, 1.2, said),)
    result = Result("friction", ("x.h5",), estimates, (said,), (Plot(said, said, (points,), ()),))
    own = RunSet(said, (entry, lost), (GroupResult(said, "friction", said, said, result, (entry,)),), {})
    return tree(Datasheet((own,)), Path("out.html"))


@cache
def tags_of_a_sheet():
    return {element.tag for element in sheet_that_says("word").iter()}


@given(st.text(st.characters(exclude_characters="\r"), min_size=1))
def test_every_text_is_escaped(hostile):
    root = sheet_that_says(hostile)
    assert {element.tag for element in root.iter()} == tags_of_a_sheet()
    shown = re.sub("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]", "\ufffd", hostile)
    assert root.find("body/main/section/section/details/ul/li").text == shown


@needs_chromium
def test_it_fits_a_telephone_and_a_screen_light_and_dark_and_asks_for_nothing(campaign, sheet, tmp_path):
    text = page(sheet, campaign / "out.html")
    said, tags, complaints = look(tmp_path, text, (420, 1400), ("light", "dark"))
    assert said == "fits"
    assert complaints == []
    assert tags == [element.tag for element in ElementTree.fromstring(text).iter()]


def test_contours_are_told_on_the_longest_of_their_name_and_fitted_lines_have_no_holes(tmp_path):
    x = tuple(float(k) for k in range(50))
    shown = Series("all", x, x)
    lines = [Series("20%", (0.0, 0.001, 0.002, 40.0), (1.0, 2.0, 3.0, 4.0)), Series("20%", (5.0, 6.0), (1.0, 1.5))]
    lines += [Series(f"{k}0%", (1.0, 2.0, 3.0), (k, k + 1.0, k)) for k in (4, 6)]
    entry = RunEntry(Path("x.h5"), "R1", "", "lea", "friction")
    result = Result("friction", ("x.h5",), (), (), (Plot("x [1]", "y [1]", (shown,), tuple(lines)),))
    own = RunSet("s", (entry,), (GroupResult("lea", "friction", "", "", result, (entry,)),), {})
    root = tree(Datasheet((own,)), tmp_path / "out.html")
    on_line = [item for item in root.iter("span") if item.get("class") == "on-line"]
    assert [item.text for item in on_line] == ["20%", "40%", "60%"]
    assert [words(item) for item in root.iter("div") if item.get("class") == "legend"] == ["all"]
    drawn = [item.get("d") for item in root.iter("path") if item.get("class") == "curve line thin other"]
    assert [path.count("M") for path in drawn] == [1, 1, 1, 1]


def drawn(plot, folder):
    """The page of one experiment with one plot."""
    entry = RunEntry(Path("x.h5"), "R1", "", "lea", "friction")
    result = Result("friction", ("x.h5",), (), (), (plot,))
    own = RunSet("s", (entry,), (GroupResult("lea", "friction", "", "", result, (entry,)),), {})
    return tree(Datasheet((own,)), folder / "out.html")


def test_a_frequency_is_drawn_by_decades(tmp_path):
    gain = Series("5 A", (1.0, 10.0, 100.0, 1000.0), (0.0, 0.0, -3.0, -20.0))
    root = drawn(Plot("frequency [Hz]", "gain [dB]", (gain,), (), x_log=True), tmp_path)
    marks = next(item.get("d") for item in root.iter("path") if item.get("class") == "marks dot s0")
    across = [float(mark.split()[0]) for mark in marks.split("M")[1:]]
    assert np.ptp(np.diff(across)) <= 0.2  # tenths are what a drawing is rounded to
    ticks = next(item for item in root.iter("div") if item.get("class") == "x")
    assert [item.text for item in ticks] == ["1", "10", "100", "1000"]


def test_a_map_is_filled_by_bands_with_a_key_each(tmp_path):
    corners = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))
    bands = (Band("below 0%", (corners,)), Band("0% to 50%", ()), Band("50% and more", (corners,)))
    points = Series("0 to 50 %", (0.5,), (0.5,))
    line = Series("50%", (0.0, 0.5, 1.0), (0.0, 0.5, 1.0))
    root = drawn(Plot("speed [rad/s]", "torque [N*m]", (points,), (line,), bands=bands), tmp_path)
    assert [item.get("class") for item in root.iter("path") if "band" in item.get("class", "")] == [
        "band b0",
        "band b2",
    ]
    legend = next(item for item in root.iter("div") if item.get("class") == "legend")
    assert [words(key) for key in legend] == ["below 0%", "50% and more", "measured"]


@needs_chromium
def test_a_telephone_shows_every_value(campaign, sheet, tmp_path):
    probe = """<!DOCTYPE html><meta charset="utf-8"><iframe style="border:0;width:420px;height:3000px" srcdoc="%s">
    </iframe><pre id="out">waiting</pre><script>addEventListener("load", () => {
    const cells = [...document.querySelector("iframe").contentDocument.querySelectorAll(".datasheet td")];
    const outside = cells.filter(cell => cell.getBoundingClientRect().right > 420).length;
    document.getElementById("out").textContent = cells.length + " " + outside; });</script>"""
    text, _ = dumped(tmp_path, probe % escape(page(sheet, campaign / "out.html"), quote=True), 500)
    cells, outside = map(int, text.split())
    assert cells > 100
    assert outside == 0


def test_a_condition_has_one_colour_however_the_order_of_its_runs_was_drawn(tmp_path):
    orders = {"spring": ("loaded", "design", "unloaded"), "autumn": ("design", "unloaded", "loaded")}
    for number, (name, order) in enumerate(orders.items()):
        (tmp_path / name).mkdir()
        bench = Bench(tmp_path / name)
        bench.count = 10 * number
        for condition in order:
            bench.friction(f=COULOMB[condition], condition=condition, scatter=0.001, torque_constant=LEA)
    sets = tuple(read_runs([tmp_path / name], label, {}, quiet) for name, label in (("spring", "A"), ("autumn", "B")))
    root = tree(Datasheet(sets), tmp_path / "out.html")
    legends = [item for item in root.iter("div") if item.get("class") == "legend"][:2]
    keys = [[(key.find("i").get("class"), words(key)) for key in item][:3] for item in legends]
    assert keys[0] == keys[1] == [(f"swatch line s{k}", name) for k, name in enumerate(COULOMB)]


def test_a_sentence_comes_with_what_it_holds_for_in_words(campaign, sheet):
    section = next(
        item for item in tree(sheet, campaign / "out.html").iter("section") if item.get("id") == "m0-friction"
    )
    said = [words(match) for match in section.findall("p")]
    assert any(item.startswith("Coulomb friction differs between conditions (F(2, 6) = ") for item in said)
    remarks = [words(match) for match in section.findall("ul/li")]
    assert remarks.count("one actuator ('a1'): no random factor; what is found holds for it and for no other") == 1
    assert any(item.startswith("each condition was set once an actuator") for item in remarks)
    assert "_" not in " ".join(said)


def test_every_figure_of_the_paper_has_the_unit_that_a_measured_one_has(sheet):
    of_paper = {name for each in experiments() for figures in figures_by_condition(each).values() for name in figures}
    assert of_paper == units_in_paper().keys()
    for one in (item for own in sheet.sections[0].rows.values() for item in own if item.name in of_paper):
        for item in (cell.estimate for cell in one.cells if cell.estimate is not None):
            assert item.units == units_in_paper()[one.name]


def test_a_map_has_a_folded_table_with_the_longer_axis_downwards(tmp_path):
    nan = float("nan")
    grid = Grid(
        "driving_map",
        {"velocity_rad_s": (5.0, 10.0), "current_A": (3.0, 6.0, 9.5)},
        {"efficiency_1": ((0.51234567, 0.4, -0.0), (0.6, nan, -1.5)), "torque_Nm": ((1.5, 0.0, 1.0), (1.4, nan, 2.0))},
    )
    square = Plot("x [1]", "y [1]", tuple(Series(name, (1.0, 2.0), (3.0, 4.0)) for name in "abc"), ())
    entry = RunEntry(Path("x.h5"), "R1", "", "lea", "efficiency")
    result = Result("efficiency", ("x.h5",), (), (), (square,), (), (grid,))
    own = RunSet("s", (entry,), (GroupResult("lea", "efficiency", "LEA-1", "design", result, (entry,)),), {})
    root = tree(Datasheet((own,)), tmp_path / "out.html")
    folded = next(item for item in root.iter("details") if words(item.find("summary")).startswith("Values at"))
    assert words(folded.find("summary")) == "Values at every setpoint: driving map, LEA-1, design"
    assert folded.get("open") is None
    assert [match.get("href") for match in folded.findall("p/a")] == ["#R1"]
    assert table(root, "map") == [
        ["current [A] \\ velocity [rad/s]", "5", "10"],
        ["3", "0.512", "0.600"],
        ["6", "0.400", "-"],
        ["9.5", "0.00", "-1.50"],
    ]
    marks = next(item.get("d") for item in root.iter("path") if item.get("class") == "marks square s2")
    assert "h0M" not in marks  # a PDF paints no stroke without a length and with square ends
    assert not marks.endswith("h0")


def test_units_and_names_are_printed_as_people_write_them():
    assert pretty("N*m*s/rad, kg*m^2, 1 ohm at 25 degC [1]") == "N·m·s/rad, kg·m², 1 Ω at 25 °C"
    assert pretty("256 uH, 528 mohm, uHx and johm") == "256 µH, 528 mΩ, uHx and johm"
    assert [heading(name) for name in ("back-emf", "coulomb_friction", "thermal")] == [
        "Back EMF",
        "Coulomb friction",
        "Thermal",
    ]
