"""A result over many runs as text that fits 80 columns."""

import textwrap

from leactl.analysis.estimate import Plot, Series
from leactl.analysis.statistics.control_chart import FEWEST, ON_ONE_SIDE
from leactl.analysis.trend import Trend
from leactl.report.plot import draw
from leactl.report.terminal import aligned, number, shows_all, value_text, wrapped

WIDTH = 80


def trend_text(trend: Trend, encoding: str = "utf-8") -> str:
    """What the runs say together first, then each of them, then the picture."""
    group = ", ".join(filter(None, (trend.actuator, trend.condition)))
    head = f"{trend.result} [{trend.units}]{' of ' + group if group else ''}: {sentence(trend)}"
    lines = [*textwrap.wrap(head, WIDTH, subsequent_indent="  "), ""]
    beyond = set(trend.chart.beyond) if trend.chart else set()
    shifted = set(trend.chart.shifted) if trend.chart else set()
    rows = [
        (
            point.created[:16].replace("T", " "),
            value_text(point.value),
            "beyond the limits" if index in beyond else f"{ON_ONE_SIDE} on one side" if index in shifted else "",
            point.run.name,
        )
        for index, point in enumerate(trend.points)
    ]
    lines.append(aligned(("made (UTC)", "value ± std", "", "run"), rows))
    lines += ["", *draw(trend_plot(trend), WIDTH, ascii_only=not shows_all(encoding))]
    lines += [wrapped("left out:", [line], WIDTH) for line in trend.left_out]
    return "\n".join(lines)


def sentence(trend: Trend) -> str:
    """Whether anything speaks for a change."""
    chart, count = trend.chart, len(trend.points)
    if chart is None:
        return f"{count} run{'s' if count != 1 else ''}; limits need {FEWEST}"
    std = (chart.high - chart.low) / 6.0
    limits = f"{number(chart.low, std)} .. {number(chart.high, std)} by {chart.baseline} runs"
    if not chart.changed:
        return f"no change in {count} runs; limits {limits}"
    first = min([*chart.beyond, *chart.shifted])
    return f"changed, seen first on {trend.points[first].created[:10]}; limits {limits}"


def trend_plot(trend: Trend) -> Plot:
    """Values over the number of the run, with centre and limits."""
    numbers = tuple(float(index + 1) for index in range(len(trend.points)))
    values = tuple(point.value.value for point in trend.points)
    ends = (numbers[0], numbers[-1])
    chart = trend.chart
    lines = [Series("", ends, (limit, limit)) for limit in (chart.low, chart.centre, chart.high)] if chart else []
    return Plot("run", f"{trend.result} [{trend.units}]", (Series("a run", numbers, values),), tuple(lines))
