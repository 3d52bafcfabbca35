"""Answers in a notebook: a page in a frame of its own, whose style and scripts touch nothing around it."""

from html import escape

from leactl.analysis.estimate import Result
from leactl.report.chart import chart
from leactl.report.datasheet.figures import plain, plot_layers, pretty, subject
from leactl.report.datasheet.style import STYLE
from leactl.report.html import Html, document, joined, table, tag
from leactl.report.terminal import interval_text, value_text

HEIGHT_PX = 560  # of the frame; what is longer scrolls inside


def framed(page: str) -> str:
    """A page as a notebook's cell shows it; no script of it may run."""
    return f'<iframe srcdoc="{escape(page, quote=True)}" sandbox="" width="100%" height="{HEIGHT_PX}"></iframe>'


def analysis_page(result: Result) -> str:
    """Results, plots and notes of one experiment."""
    parts = [tag("h1", f"{result.experiment}, {len(result.runs)} run{'s' if len(result.runs) != 1 else ''}")]
    for actuator, condition in result.groups:
        title = ", ".join(filter(None, (actuator, condition)))
        rows = [
            [
                plain(estimate.name),
                value_text(estimate),
                interval_text(estimate),
                "" if estimate.units == "1" else pretty(estimate.units),
            ]
            for estimate in result.results
            if (estimate.actuator, estimate.condition) == (actuator, condition)
        ]
        heading = [tag("h2", title)] if title else []
        parts += [*heading, table(["result", "value ± std", "95 % interval", "units"], rows)]
    figures = [
        tag(
            "figure",
            tag("figcaption", ", ".join(filter(None, (subject(plot), plot.actuator, plot.condition)))),
            chart(plot_layers(plot), pretty(plot.x_label), pretty(plot.y_label), x_log=plot.x_log),
        )
        for plot in result.plots
    ]
    drawn = tag("div", *figures, class_="pair") if figures else Html("")
    notes = tag("ul", *(tag("li", note) for note in result.notes)) if result.notes else Html("")
    return document(result.experiment, STYLE, tag("main", joined([*parts, drawn, notes])))
