"""`leactl report`, as a shell sees it."""

import json
import os
import signal
import stat
import sys
from pathlib import Path

import pytest

from leactl.errors import DeviceError, InputError, Stopped
from leactl.report.datasheet.make import DatasheetOutputs, make
from leactl.report.pdf import print_pdf
from leactl.report.progress_line import ProgressLine
from tests.analysis.synthetic import Bench
from tests.cli.terminal import leactl
from tests.report.browser import needs_chromium


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for number, name in enumerate(("spring", "autumn")):
        (tmp_path / name).mkdir()
        bench = Bench(tmp_path / name)
        bench.count = 10 * number
        bench.friction(f=0.2 + 0.03 * number, scatter=0.001)
        bench.torque(scatter=0.01)
    return tmp_path


def test_a_shell_gets_the_page_the_table_and_what_was_left_out(here):
    (here / "spring" / "broken.h5").write_text("none")
    done = leactl("report", "spring", "--html", "out.html", "--json")
    assert done.returncode == 0
    assert "not analysed: spring/broken.h5: not a" in done.stderr
    body = json.loads(done.stdout, parse_constant=lambda name: pytest.fail(name))
    rows = {(row["name"], row["condition"]): row for row in body["sections"][0]["rows"]}
    result = rows["coulomb_friction", "design"]["values"][0]
    assert result["value"] == pytest.approx(0.2, abs=0.002)
    assert result["runs"] == ["R1"]
    assert rows["coulomb_friction", "loaded"]["values"][0]["lacks"] == "not measured"
    assert [run["fault"] is None for run in body["sets"][0]["runs"]] == [True, True, False]
    assert (here / "out.html").read_text().startswith("<!DOCTYPE html>")
    assert sorted(path.name for path in here.iterdir()) == ["autumn", "out.html", "spring"]


def test_what_follows_compare_is_the_other_set_up_to_the_next_option(here):
    others = sorted(str(path) for path in (here / "autumn").glob("*.h5"))
    done = leactl("report", "spring", "--compare", *others, "--json")
    sets = json.loads(done.stdout)["sets"]
    assert [(item["name"], len(item["runs"])) for item in sets] == [("spring", 2), ("autumn", 2)]


@pytest.mark.parametrize(
    ("given", "how", "fault"),
    [
        (["spring"], {}, "--html OUT.html: where the datasheet goes is missing"),
        (["spring"], {"pdf": True, "json": True}, "--html OUT.html: where the datasheet goes is missing"),
        (["spring"], {"html": "out.pdf"}, "--html out.pdf: a name that ends in .html was expected"),
        (["spring"], {"html": "no/out.html"}, "no/out.html: no folder no"),
        (["spring"], {"html": "/proc/out.html"}, "/proc/out.html: cannot be written: "),
        (["spring", "out.html"], {"html": "out.html"}, "out.html: is an input"),
        (["summer"], {"html": "out.html"}, "summer: no such file or folder"),
        (["empty"], {"html": "out.html"}, "empty: no run files in this folder"),
        ([], {"html": "out.html"}, "no runs; give run files, or folders of them"),
        (["broken.h5"], {"html": "out.html"}, "broken.h5: not a"),
    ],
)
def test_what_cannot_be_done_is_one_line_each_and_writes_nothing(here, given, how, fault):
    (here / "empty").mkdir()
    (here / "broken.h5").write_text("none")
    html = Path(how["html"]) if "html" in how else None
    with pytest.raises(InputError) as raised:
        make(
            [Path(item) for item in given],
            [],
            {},
            DatasheetOutputs(html, how.get("pdf", False), how.get("json", False)),
        )
    assert raised.value.faults[0].startswith(fault)
    assert not (here / "out.html").exists()


def test_compare_without_runs_is_said_as_such(here):
    done = leactl("report", "spring", "--compare", "--html", "out.html")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "leactl: --compare: no runs after it; give run files, or folders of them\n"


def test_without_a_chromium_a_pdf_is_refused_before_any_analysis(here):
    done = leactl("report", "spring", "--html", "out.html", "--pdf", PATH=str(here))
    assert done.returncode == 2
    assert done.stderr.startswith("leactl: --pdf: needs a Chromium to print with, and none of chromium, ")
    assert len(done.stderr.splitlines()) == 1
    assert not (here / "out.html").exists()


@pytest.mark.parametrize("ending", ["echo it broke >&2; exit 3", "echo it broke >&2"])
def test_a_chromium_that_prints_nothing_is_a_device_that_failed(tmp_path, monkeypatch, ending):
    browser = tmp_path / "chromium"
    browser.write_text(f"#!/bin/sh\n{ending}\n")
    browser.chmod(browser.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    (tmp_path / "page.html").write_text("<!DOCTYPE html>")
    (tmp_path / "page.pdf").write_text("an earlier one")
    with pytest.raises(DeviceError, match=r"page\.pdf: .*chromium did not print: it broke"):
        print_pdf(tmp_path / "page.html", tmp_path / "page.pdf")
    assert (tmp_path / "page.pdf").read_text() == "an earlier one"


@needs_chromium
def test_the_pdf_lies_beside_the_page(here):
    done = leactl("report", "spring", "--html", "out.html", "--pdf", **os.environ)
    assert done.returncode == 0, done.stderr
    assert (here / "out.pdf").read_bytes().startswith(b"%PDF-")
    assert sorted(path.name for path in here.iterdir()) == ["autumn", "out.html", "out.pdf", "spring"]


class Interrupted:
    """Somebody presses Ctrl-C while this is let go of, where Python drops exceptions."""

    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        list(range(100))  # the handler runs between two instructions of this


def test_a_ctrl_c_that_a_finalizer_swallows_ends_at_the_next_step_without_a_trace(capsys):
    before = sys.unraisablehook
    with pytest.raises(Stopped), ProgressLine() as step:
        held = [Interrupted()]
        held.clear()
        step("fitting")
    assert "Traceback" not in capsys.readouterr().err
    assert sys.unraisablehook is before
