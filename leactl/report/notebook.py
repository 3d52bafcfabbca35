"""Answers in a notebook: each page is in a frame, so that its style and scripts do not affect the notebook."""

from html import escape

from leactl.analysis.estimate import Result
from leactl.report.chart import CaptionedChart, chart
from leactl.report.datasheet.figures import plain, plot_layers, pretty, subject
from leactl.report.html import render
from leactl.report.terminal import interval_text, value_text

HEIGHT_PX = 560  # of the frame; what is longer scrolls inside


def framed(page: str) -> str:
    """Return a page as a frame for a notebook's cell; no script of it may run."""
    return f'<iframe srcdoc="{escape(page, quote=True)}" sandbox="" width="100%" height="{HEIGHT_PX}"></iframe>'


def analysis_page(result: Result) -> str:
    """Return a page with results, plots and notes of one experiment."""
    groups = []
    for actuator, condition in result.groups:
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
        groups.append((", ".join(filter(None, (actuator, condition))), rows))
    figures = [
        CaptionedChart(
            ", ".join(filter(None, (subject(plot), plot.actuator, plot.condition))),
            chart(plot_layers(plot), pretty(plot.x_label), pretty(plot.y_label), x_log=plot.x_log),
        )
        for plot in result.plots
    ]
    return render(
        "notebook.html",
        title=result.experiment,
        runs=f"{len(result.runs)} run{'s' if len(result.runs) != 1 else ''}",
        groups=groups,
        figures=figures,
        notes=result.notes,
    )
