"""The page of a run as it goes: its elements without a value; `page.js` asks for the values and fills them in.

No text of a run stands in the page's source. The script sets texts as text, so that none becomes an element.
"""

from leactl.report.html import Html, document, scripts, tag
from leactl.report.page_style import CHANNELS, PAGE

STYLE = (
    PAGE
    + CHANNELS
    + """
:root { --stop: #b3141b; --alarm: #fff1d6; --alarm-ink: #5c3b00; }
@media (prefers-color-scheme: dark) { :root { --alarm: #45330a; --alarm-ink: #ffe2a6; } }
[hidden] { display: none !important; }
.top { position: sticky; top: 0; z-index: 1; background: var(--ground); padding: 0.5rem 0; display: grid;
  gap: 0.25rem 1rem; align-items: center; border-bottom: 1px solid var(--line); }
.top h1 { margin: 0; }
#stop { font: inherit; font-size: 1.75rem; font-weight: 700; letter-spacing: 0.08em; min-height: 4.5rem; width: 100%;
  color: #ffffff; background: var(--stop); border: 0; border-radius: 8px; cursor: pointer; }
#stop:focus-visible { outline: 4px solid var(--ink); outline-offset: 2px; }
#stop:disabled { opacity: 0.5; cursor: default; }
meter { width: 4rem; vertical-align: middle; }
@media (min-width: 45rem) { meter { width: 12rem; } .top { grid-template-columns: minmax(0, 1fr) 18rem; }
  .top > .what { grid-column: 1; grid-row: 1; } .top > #stop { grid-column: 2; grid-row: 1; } }
#notice:not(:empty), .warning { background: var(--alarm); color: var(--alarm-ink); border-radius: 6px;
  padding: 0.5rem 0.75rem; margin: 0.5rem 0; max-width: none; }
#warnings { list-style: none; margin: 0; padding: 0; }
progress { width: 100%; height: 1rem; accent-color: var(--reading); }
.what { margin-top: 0.25rem; }
details { margin-bottom: 0.75rem; }
.figures { font-variant-numeric: tabular-nums; }
.choice { display: flex; flex-wrap: wrap; gap: 0.25rem 1.25rem; border: 0; margin: 0; padding: 0.5rem 0; }
.choice label { display: inline-flex; gap: 0.4rem; align-items: center; min-height: 1.75rem; }
.charts { display: grid; gap: 1rem; grid-template-columns: repeat(auto-fit, minmax(min(100%, 28rem), 1fr)); }
.charts .card { margin: 0; }
td.value { text-align: right; }
"""
)


def page(bench: str) -> str:
    """Return the page of a run on this bench."""
    command = f"leactl bench stop {bench}"
    top = tag(
        "div",
        tag("button", "STOP", id="stop", type="button"),
        tag(
            "div",
            tag("h1", "leactl run", id="title"),
            tag("p", "waits for the run", id="state", role="status"),
            class_="what",
        ),
        class_="top",
    )
    body = tag(
        "main",
        top,
        tag("p", id="notice", role="alert", data_stop=command),
        tag("p", tag("strong", "starting", id="step"), " ", tag("span", id="pause")),
        tag("progress", max="1", value="0", id="share", aria_label="part of the run that is done"),
        tag("p", id="times", class_="figures"),
        tag("h2", "Warnings"),
        tag("p", "none", id="no-warnings"),
        tag("ul", id="warnings", role="log", aria_live="polite", aria_label="warnings"),
        tag("h2", "Windings"),
        _table(["winding", "at most", "limit", "limit in", "estimate"], "windings"),
        tag("h2", "Channels"),
        tag("details", tag("summary", "Which channels are drawn"), tag("fieldset", id="choice", class_="choice")),
        tag("div", id="charts", class_="charts"),
        tag("h2", "Newest values"),
        _table(["channel", "value", "unit"], "values"),
        _empty_chart(),
    )
    script = scripts("axes.js", "web/page.js")
    return document("leactl run", STYLE, body, script, asks_its_server=True)


def _table(headings: list[str], name: str) -> Html:
    """Return a table whose rows come later."""
    head = tag("thead", tag("tr", *(tag("th", heading, scope="col") for heading in headings)))
    return tag("div", tag("table", head, tag("tbody", id=name)), class_="scroll", tabindex="0")


def _empty_chart() -> Html:
    """Return what each chart is made from, in the form of `leactl.report.chart`."""
    drawing = tag(
        "svg",
        tag("path", class_="grid"),
        tag("path", class_="curve setpoint"),
        tag("path", class_="curve reading"),
        viewBox="0 0 1000 1000",
        preserveAspectRatio="none",
        role="img",
    )
    chart = tag(
        "div",
        tag("div", class_="legend"),
        tag("div", class_="y-label"),
        tag("div", class_="y"),
        tag("div", drawing, class_="drawing"),
        tag("div", class_="x"),
        tag("div", "time of the run in s", class_="x-label"),
        class_="chart",
    )
    return tag("template", tag("figure", tag("h3"), chart, class_="card"), id="chart")
