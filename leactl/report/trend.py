"""The trend of a result over many runs as text that fits 80 columns."""

import textwrap

from leactl.analysis.estimate import Plot, Series
from leactl.analysis.statistics.control_chart import FEWEST_BASELINE_VALUES, ROW_LENGTH
from leactl.analysis.trend import Trend
from leactl.report.plot import draw
from leactl.report.terminal import TEXT_WIDTH, aligned, number, shows_all, value_text, wrapped


def trend_text(trend: Trend, encoding: str = "utf-8") -> str:
    """Return a sentence on whether the result has changed, a row for each run, and a plot."""
    group = ", ".join(filter(None, (trend.actuator, trend.condition)))
    title = f"{trend.result} [{trend.units}]{' of ' + group if group else ''}: {change_sentence(trend)}"
    lines = [*textwrap.wrap(title, TEXT_WIDTH, subsequent_indent="  "), ""]
    beyond_limits = set(trend.chart.beyond) if trend.chart else set()
    on_one_side = set(trend.chart.shifted) if trend.chart else set()
    rows = [
        (
            point.created[:16].replace("T", " "),
            value_text(point.value),
            "beyond the limits"
            if index in beyond_limits
            else f"{ROW_LENGTH} on one side"
            if index in on_one_side
            else "",
            point.run.name,
        )
        for index, point in enumerate(trend.points)
    ]
    lines.append(aligned(("made (UTC)", "value ± std", "", "run"), rows))
    lines += ["", *draw(trend_plot(trend), TEXT_WIDTH, ascii_only=not shows_all(encoding))]
    lines += [wrapped("left out:", [line], TEXT_WIDTH) for line in trend.left_out]
    return "\n".join(lines)


def change_sentence(trend: Trend) -> str:
    """Return one sentence that says whether the runs show a change of the result."""
    chart, count = trend.chart, len(trend.points)
    if chart is None:
        return f"{count} run{'s' if count != 1 else ''}; limits need {FEWEST_BASELINE_VALUES}"
    standard_deviation = (chart.high - chart.low) / 6.0
    limits = (
        f"{number(chart.low, standard_deviation)} .. {number(chart.high, standard_deviation)} by {chart.baseline} runs"
    )
    if not chart.changed:
        return f"no change in {count} runs; limits {limits}"
    first_change = min([*chart.beyond, *chart.shifted])
    return f"changed, seen first on {trend.points[first_change].created[:10]}; limits {limits}"


def trend_plot(trend: Trend) -> Plot:
    """Return a plot of the values over the runs' numbers, with centre line and limits."""
    numbers = tuple(float(index + 1) for index in range(len(trend.points)))
    values = tuple(point.value.value for point in trend.points)
    end_numbers = (numbers[0], numbers[-1])
    chart = trend.chart
    limit_lines = (
        [Series("", end_numbers, (limit, limit)) for limit in (chart.low, chart.centre, chart.high)] if chart else []
    )
    return Plot("run", f"{trend.result} [{trend.units}]", (Series("a run", numbers, values),), tuple(limit_lines))
