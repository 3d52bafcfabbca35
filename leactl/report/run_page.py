"""The channels of a run over time as one page: linked charts that zoom, with shaded steps, and a table of all steps.

A reading and its setpoint share a chart. The page has at most `MOST_BINS` bins for a channel and gives the number of
samples in each; a short part of a run is drawn with all its samples.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from leactl.report.chart import AxisRange, Layer, LineMarks, chart
from leactl.report.html import render
from leactl.runfile.read.reader import Run, Step
from leactl.runfile.read.traces import ChannelTrace

MOST_BINS = 2000  # of a channel: more than the pixels of a wide screen


def page(run: Run, traces: Sequence[ChannelTrace], start: float, stop: float) -> str:
    """Return the page of these channels from `start` to `stop` [s] of the run."""
    steps = [step for step in run.steps if step.stop > start and step.start < stop]
    title = f"{run.attributes.get('protocol', '') or 'Run'} {run.path.name}"
    description = ", ".join(
        f"{name} {value}"
        for name in ("actuator", "condition", "bench", "status")
        if (value := str(run.attributes.get(name, "")))
    )
    return render(
        "run.html",
        scripts=("axes.js", "zoom.js"),
        title=title,
        about=description,
        spans=[(f"{step.name}, {step.start:.3f} s", f"{step.start:.9g} {step.stop:.9g}") for step in steps],
        figures=[figure(chart_traces, steps, start, stop) for chart_traces in traces_by_chart(traces)],
        steps=[[step.name, f"{step.start:.3f}", f"{step.stop:.3f}", f"{step.settle:.3f}"] for step in steps],
    )


def traces_by_chart(traces: Sequence[ChannelTrace]) -> list[list[ChannelTrace]]:
    """Return the traces of each chart: a setpoint shares the chart of the reading of its quantity, role and units."""
    charts: dict[tuple[str, str, str, str], list[ChannelTrace]] = {}
    for trace in traces:
        channel = trace.channel
        quantity = channel.quantity.removesuffix("_reference")
        may_share = bool(quantity) and not channel.location
        key = (quantity, channel.role, channel.units, "") if may_share else (trace.name, "", "", "")
        charts.setdefault(key, []).append(trace)
    return list(charts.values())


def figure(traces: Sequence[ChannelTrace], steps: Sequence[Step], start: float, stop: float) -> dict[str, Any]:
    """Return the chart of a reading, its setpoint, or both, over the shaded steps."""
    shades = [AxisRange("every other step", "step", step.start, step.stop) for step in steps[1::2]]
    layers: list[Layer] = [*shades]
    for trace in traces:
        style = "setpoint" if trace.channel.quantity.endswith("_reference") else "reading"
        layers.append(LineMarks(trace.name, style, trace.time, trace.values, connected=True))
    time_span = LineMarks("", "", np.asarray([start, stop]), np.full(2, np.nan))
    channel = traces[-1].channel
    quantity = channel.quantity.removesuffix("_reference").replace("_", " ") or traces[-1].name
    units = channel.units if channel.units not in ("", "1") else "no unit"
    bin_notes = [
        f"{trace.name}: the range of about {trace.samples_per_bin:.0f} samples at each point"
        for trace in traces
        if trace.samples_per_bin > 1
    ]
    return {
        "title": f"{quantity}, {channel.role}" if channel.role else quantity,
        "remark": channel.long_name,
        "chart": chart(layers, "time in s", f"{quantity} in {units}", included_in_axes=[time_span]),
        "caption": "; ".join(bin_notes),
    }
