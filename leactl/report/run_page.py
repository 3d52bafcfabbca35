"""A run's channels over time as one page: linked charts that zoom, steps shaded, every step in a table.

A reading and its setpoint share a chart. The page has at most `BINS` bins a channel and says how many samples each
stands for; a short part of the run is drawn with all its samples.
"""

from collections.abc import Sequence

import numpy as np

from leactl.report.chart import AxisRange, Layer, LineMarks, chart
from leactl.report.html import Html, document, scripts, table, tag
from leactl.report.page_style import CHANNELS, PAGE
from leactl.runfile.read.reader import Run, Step
from leactl.runfile.read.traces import ChannelTrace

BINS = 2000  # of a channel: more than the pixels of a wide screen
STYLE = (
    PAGE
    + CHANNELS
    + """
:root { --step: #8a94a0; }
@media (prefers-color-scheme: dark) { :root { --step: #7d8894; } }
svg path.step { fill: var(--step); fill-opacity: 0.15; }
.swatch.step { background: var(--step); opacity: 0.3; }
.drawing { touch-action: pan-y; cursor: crosshair; }
.selection { position: absolute; top: 0; bottom: 0; background: var(--reading); opacity: 0.2; }
.zoom { position: sticky; top: 0; z-index: 1; background: var(--ground); padding: 0.4rem 0; display: flex;
  flex-wrap: wrap; gap: 0.4rem; align-items: center; font-size: 0.875rem; }
.zoom button, .zoom select { font: inherit; }
.zoom output { font-variant-numeric: tabular-nums; }
@media print { .zoom { display: none; } }
"""
)


def page(run: Run, traces: Sequence[ChannelTrace], start: float, stop: float) -> str:
    """Return the page of these channels between two times [s] of the run."""
    steps = [step for step in run.steps if step.stop > start and step.start < stop]
    title = f"{run.attributes.get('protocol', '') or 'Run'} {run.path.name}"
    about = ", ".join(
        f"{name} {value}"
        for name in ("actuator", "condition", "bench", "status")
        if (value := str(run.attributes.get(name, "")))
    )
    charts = [figure(pair, steps, start, stop) for pair in pairs(traces)]
    rows = [[step.name, f"{step.start:.3f}", f"{step.stop:.3f}", f"{step.settle:.3f}"] for step in steps]
    body = tag(
        "main",
        tag("h1", title),
        tag("p", about, class_="about"),
        controls(steps),
        *charts,
        tag("h2", "Steps"),
        table(["name", "start [s]", "stop [s]", "settle [s]"], rows),
    )
    return document(title, STYLE, body, scripts("axes.js", "zoom.js"))


def controls(steps: Sequence[Step]) -> Html:
    """Return the row of buttons, the list of steps to zoom to, and the readout of what the pointer is on."""
    spans = [
        tag("option", f"{step.name}, {step.start:.3f} s", value=f"{step.start:.9g} {step.stop:.9g}") for step in steps
    ]
    buttons = [("whole", "Whole"), ("in", "Zoom in"), ("out", "Zoom out"), ("earlier", "Earlier"), ("later", "Later")]
    return tag(
        "div",
        *(tag("button", label, type="button", data_zoom=action) for action, label in buttons),
        tag("select", tag("option", "Zoom to a step", value=""), *spans, aria_label="Zoom to a step"),
        tag("output", "Drag over a chart to zoom into it."),
        class_="zoom",
    )


def pairs(traces: Sequence[ChannelTrace]) -> list[list[ChannelTrace]]:
    """Return the traces chart by chart: a setpoint joins the reading of its quantity, role and stream."""
    charts: dict[tuple[str, str, str, str], list[ChannelTrace]] = {}
    for trace in traces:
        channel = trace.channel
        quantity = channel.quantity.removesuffix("_reference")
        named = bool(quantity) and not channel.location
        key = (quantity, channel.role, channel.units, "") if named else (trace.name, "", "", "")
        charts.setdefault(key, []).append(trace)
    return list(charts.values())


def figure(traces: Sequence[ChannelTrace], steps: Sequence[Step], start: float, stop: float) -> Html:
    """Return the chart of a reading, its setpoint, or both, over the shaded steps."""
    shades = [AxisRange("every other step", "step", step.start, step.stop) for step in steps[1::2]]
    layers: list[Layer] = [*shades]
    for trace in traces:
        style = "setpoint" if trace.channel.quantity.endswith("_reference") else "reading"
        layers.append(LineMarks(trace.name, style, trace.time, trace.values, whole=True))
    whole = LineMarks("", "", np.asarray([start, stop]), np.full(2, np.nan))
    channel = traces[-1].channel
    quantity = channel.quantity.removesuffix("_reference").replace("_", " ") or traces[-1].name
    units = channel.units if channel.units not in ("", "1") else "no unit"
    bin_notes = [
        f"{trace.name}: the range of about {trace.samples_per_bin:.0f} samples at each point"
        for trace in traces
        if trace.samples_per_bin > 1
    ]
    return tag(
        "figure",
        tag("h3", f"{quantity}, {channel.role}" if channel.role else quantity, tag("small", channel.long_name)),
        chart(layers, "time in s", f"{quantity} in {units}", beside=[whole]),
        tag("figcaption", "; ".join(bin_notes)),
        class_="card",
    )
