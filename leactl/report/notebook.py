"""Results as pages in a notebook; each page is in a frame, so that its style and scripts do not affect the notebook."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from leactl.analysis.estimate import Result
from leactl.driver.contract import Confirmation
from leactl.report.chart import CaptionedChart, LineMarks, chart
from leactl.report.datasheet.figures import plain, plot_layers, pretty, subject
from leactl.report.html import render
from leactl.report.terminal import interval_text, value_text
from leactl.runfile.read.reader import Channel, Run
from leactl.runfile.read.traces import trace_of

HEIGHT_PX = 560  # of the frame; a longer page scrolls in it
MOST_BINS = 1000  # of a channel's curve: more than the pixels of a cell


def framed(page: str) -> str:
    """Return a page in an HTML frame for a cell of a notebook; its scripts cannot run."""
    return f'<iframe srcdoc="{escape(page, quote=True)}" sandbox="" width="100%" height="{HEIGHT_PX}"></iframe>'


def analysis_page(result: Result) -> str:
    """Return a page with results, plots and notes of one experiment."""
    tables = []
    for actuator, condition in result.groups:
        rows = [
            [plain(estimate.name), value_text(estimate), interval_text(estimate), _unit_text(estimate.units)]
            for estimate in result.results
            if (estimate.actuator, estimate.condition) == (actuator, condition)
        ]
        heading = ", ".join(filter(None, (actuator, condition)))
        tables.append((heading, ["result", "value ± std", "95 % interval", "units"], rows))
    figures = [
        CaptionedChart(
            ", ".join(filter(None, (subject(plot), plot.actuator, plot.condition))),
            chart(plot_layers(plot), pretty(plot.x_label), pretty(plot.y_label), x_log=plot.x_log),
        )
        for plot in result.plots
    ]
    runs = f"{len(result.runs)} run{'s' if len(result.runs) != 1 else ''}"
    return _page(f"{result.experiment}, {runs}", tables=tables, figures=figures, notes=result.notes)


def run_page(run: Run) -> str:
    """Return a page with the channels of a run; its file may be closed."""
    attributes = ("protocol", "actuator", "condition", "bench", "status", "status_reason")
    rows = [
        [
            f"{stream}/{spec.name}",
            plain(spec.quantity),
            spec.role,
            spec.location,
            _unit_text(spec.units),
            run.rows[stream],
        ]
        for stream, specs in run.streams.items()
        for spec in specs
    ]
    headings = ["channel", "quantity", "role", "location", "units", "samples"]
    description = ", ".join(filter(None, (str(run.attributes.get(name, "")) for name in attributes)))
    return _page(f"Run {run.path.name}", description, [("", headings, rows)])


def channel_page(channel: Channel) -> str:
    """Return a page with the curve of a channel; each point of a long curve is the range of several samples."""
    title = " ".join(filter(None, (plain(channel.quantity) or "channel", "of", channel.role, channel.location)))
    facts = (channel.long_name, channel.device, f"{len(channel)} samples")
    description = ", ".join(filter(None, facts))
    if not len(channel):
        return _page(title, description)
    trace = trace_of("", channel, float(channel.time[0]), float(channel.time[-1]), MOST_BINS)
    style = "setpoint" if channel.quantity.endswith("_reference") else "reading"
    y_label = f"{plain(channel.quantity)} [{channel.units}]"
    drawn_chart = chart([LineMarks("", style, trace.time, trace.values)], "time [s]", pretty(y_label))
    caption = f"the range of about {trace.samples_per_bin:.0f} samples at each point"
    return _page(
        title, description, figures=[CaptionedChart(caption if trace.samples_per_bin > 1 else "", drawn_chart)]
    )


def ending_page(
    run: Path,
    ending: str,
    acceptance: Sequence[Mapping[str, Any]],
    safe: Mapping[str, Confirmation],
    notes: Sequence[str],
) -> str:
    """Return a page that says how a run ended.

    Parameters
    ----------
    ending : text on status, reason and duration.
    acceptance : the acceptance limits of the protocol, as `leactl run --json` prints them.
    """
    tables = []
    if acceptance:
        rows = [
            [_limit_name(row), _value_text(row["value"]), _unit_text(row["units"]), _yes_or_no(row["met"])]
            for row in acceptance
        ]
        tables.append(("Limits", ["limit on", "value", "units", "met"], rows))
    if safe:
        rows = [[name, _yes_or_no(confirmation.safe), confirmation.detail] for name, confirmation in safe.items()]
        tables.append(("Safe state", ["device", "confirmed", "what it answered"], rows))
    return _page(f"Run {run.name}", ending, tables, notes=notes)


def _page(
    title: str,
    description: str = "",
    tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[object]]]] = (),
    figures: Sequence[CaptionedChart] = (),
    notes: Sequence[str] = (),
) -> str:
    """Return a page from the template of a notebook; a table is its title, headings and rows."""
    return render("notebook.html", title=title, about=description, tables=tables, figures=figures, notes=notes)


def _limit_name(limit: Mapping[str, Any]) -> str:
    """Return the name of the value that a limit judges: a result, a bisection, or a channel's statistic in a step."""
    names = (limit.get(key, "") for key in ("result", "bisect", "statistic", "channel", "role", "step"))
    return " ".join(plain(str(name)) for name in names if name)


def _value_text(value: float | None) -> str:
    """Return a value with six significant digits; empty for None."""
    return "" if value is None else f"{value:.6g}"


def _unit_text(units: str) -> str:
    """Return units as they are printed; empty for a ratio."""
    return "" if units == "1" else pretty(units)


def _yes_or_no(value: bool) -> str:
    return "yes" if value else "no"
