"""The page and the panels of a run's channels: a real run file in, what a reader and a browser see out."""

import re
from html import escape, unescape
from xml.etree import ElementTree

import numpy as np
import pytest

from leactl.quantities import ChannelSpec
from leactl.report.run_page import page
from leactl.report.run_plot import panels
from leactl.runfile.read.reader import Run
from leactl.runfile.read.traces import channel_names, channel_trace, part_of_run
from leactl.runfile.write.run_info import RunInfo
from leactl.runfile.write.writer import RunWriter
from tests.report.browser import dumped, look, needs_chromium

CHANNELS = [
    ChannelSpec("iq_ref", "q_axis_current_reference", "test", "drive"),
    ChannelSpec("iq", "q_axis_current", "test", "drive"),
    ChannelSpec("torque", "torque", "test", "sensor"),
    ChannelSpec("dead", "angle", "test", "drive"),
]
LABEL = "\x1b[31m<b>&"


@pytest.fixture
def run(tmp_path):
    info = RunInfo(
        run_id="20261121T100000Z-own-0001",
        protocol="own",
        bench="emulated",
        actuator=LABEL,
        condition="",
        operator="",
        simulated=True,
        mechanical="coupled",
        software="leactl 0.1.0",
        created="2026-11-21T10:00:00Z",
    )
    time = np.arange(0.0, 20.0, 1e-3)
    level = np.where(time < 10.0, 2.0, 5.0)
    torque = 0.5 * level + 0.01 * np.sin(40.0 * time)
    torque[15000] = 9.0  # one sample, which no thinning may lose
    with RunWriter(tmp_path, info, {"loop": CHANNELS}) as writer:
        writer.append("loop", time, np.stack([level, level, torque, np.full_like(time, np.nan)], axis=1))
        writer.step("low", 0.0, 10.0, 1.0, {})
        writer.step("high" + LABEL, 10.0, 20.0, 1.0, {})
    with Run.open(writer.path) as run:
        yield run


def traces(run, words, bins):
    return [channel_trace(run, name, *part_of_run(run, "", None, None), bins) for name in channel_names(run, words)]


@pytest.mark.parametrize("width", [40, 80, 200])
def test_panels_fit_their_width_and_keep_the_peak(run, width):
    lines = panels(traces(run, ["torque"], width), run.steps, (0.0, 20.0), width, 8)
    assert max(map(len, lines)) <= width
    assert lines[0] == "loop/torque: torque of test [N*m]"
    column = 4 + round((width - 4) * (15.0 + 0.8) / 21.6)  # the axis has 4 % more on either side
    assert any(0x2800 < ord(mark) <= 0x28FF for mark in lines[1][column - 3 : column + 3])
    assert "low" in lines[-3]
    assert "░" in lines[-3]
    assert "\x1b" not in "".join(lines)


def test_panels_of_ascii_hold_nothing_else(run):
    lines = panels(traces(run, ["iq"], 80), run.steps[:1], (0.0, 20.0), 80, 8, ascii_only=True)
    assert "\n".join(lines).isascii()


def test_a_channel_without_a_value_says_so(run):
    assert "  no value in this part of the run" in panels(traces(run, ["dead"], 80), run.steps, (0.0, 20.0), 80, 8)


def test_the_page_is_xml_and_pairs_a_setpoint_with_its_reading(run):
    root = ElementTree.fromstring(page(run, traces(run, [], 500), 0.0, 20.0).split("\n", 1)[1])
    assert [heading.text for heading in root.iter("h3")] == ["q axis current, test", "torque, test", "angle, test"]
    keys = [[key[0].tail for key in chart.iter("span") if key.get("class") == "key"] for chart in root.iter("figure")]
    assert keys[0] == ["every other step", "loop/iq_ref", "loop/iq"]
    assert "range of about 40 samples" in next(root.iter("figcaption")).text
    assert "\x1b" not in "".join(root.itertext())


PROBE = """<!DOCTYPE html><meta charset="utf-8"><body>
<iframe style="height:3000px;width:900px" srcdoc="%s"></iframe><pre id="out">waiting</pre><script>
addEventListener("load", () => {
  const inner = document.querySelector("iframe").contentDocument, said = [];
  const charts = [...inner.querySelectorAll(".chart")];
  const times = () => [...charts[1].querySelectorAll(".x span")].map(span => span.textContent).join(" ");
  const tell = name => said.push(name + ": " + times() + " / " +
    charts.slice(0, 2).map(chart => Number(chart.querySelector("svg").getAttribute("viewBox").split(" ")[2])
    .toFixed(0)).join(" "));
  tell("start");
  inner.querySelector("[data-zoom=in]").click(); tell("in");
  inner.querySelector("[data-zoom=whole]").click(); tell("whole");
  const list = inner.querySelector("select");
  list.selectedIndex = 2; list.dispatchEvent(new Event("change")); tell("step");
  inner.querySelector("[data-zoom=whole]").click();
  const area = charts[1].querySelector(".drawing"), box = area.getBoundingClientRect();
  area.setPointerCapture = () => {};
  const send = (type, share) => area.dispatchEvent(new PointerEvent(type,
    { clientX: box.left + share * box.width, clientY: box.top + 5, pointerId: 1 }));
  send("pointerdown", 0.6); send("pointermove", 0.7);
  said.push("readout: " + inner.querySelector("output").textContent);
  send("pointermove", 0.8); send("pointerup", 0.8); tell("drag");
  area.dispatchEvent(new Event("dblclick")); tell("double click");
  document.getElementById("out").textContent = said.join("\\n");
});
</script>"""


@needs_chromium
def test_the_charts_zoom_together_in_a_browser(tmp_path, run):
    shown = page(run, traces(run, ["iq", "iq_ref", "torque"], 500), 0.0, 20.0)
    said, console = dumped(tmp_path, PROBE % escape(shown, quote=True), 1000)
    steps = dict(item.split(": ", 1) for item in unescape(said).splitlines())
    assert steps["start"] == steps["whole"] == steps["double click"]
    assert steps["start"] == "0 5 10 15 20 / 1000 1000"
    assert steps["in"].endswith("/ 500 500")
    first, *_, last = steps["step"].split(" / ")[0].split()
    assert (float(first), float(last)) == (10.0, 20.0)
    seen = re.fullmatch(r"(\S+) s, high.*: (\S+)", steps["readout"])
    assert float(seen[1]) == pytest.approx(-0.8 + 0.7 * 21.6, abs=0.02)
    assert float(seen[2]) == pytest.approx(2.5, abs=0.1)
    assert steps["drag"].endswith("/ 200 200")
    assert console == []


@needs_chromium
def test_the_page_fits_a_telephone_and_a_wide_screen(tmp_path, run):
    fault, _, console = look(tmp_path, page(run, traces(run, [], 500), 0.0, 20.0), (360, 1400), ("light", "dark"))
    assert (fault, console) == ("fits", [])
