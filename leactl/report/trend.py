"""A result over many runs as text that fits 80 columns."""

import textwrap

from leactl.analysis.estimate import Plot, Series
from leactl.analysis.statistics.control_chart import FEWEST, ON_ONE_SIDE
from leactl.analysis.trend import Trend
from leactl.report.plot import draw
from leactl.report.terminal import aligned, number, shows_all, value_text, wrapped

WIDTH = 80


def trend_text(found: Trend, encoding: str = "utf-8") -> str:
    """What the runs say together first, then each of them, then the picture."""
    of = ", ".join(filter(None, (found.actuator, found.condition)))
    head = f"{found.result} [{found.units}]{' of ' + of if of else ''}: {sentence(found)}"
    lines = [*textwrap.wrap(head, WIDTH, subsequent_indent="  "), ""]
    beyond = set(found.chart.beyond) if found.chart else set()
    shifted = set(found.chart.shifted) if found.chart else set()
    rows = [
        (
            point.created[:16].replace("T", " "),
            value_text(point.value),
            "beyond the limits" if place in beyond else f"{ON_ONE_SIDE} on one side" if place in shifted else "",
            point.run.name,
        )
        for place, point in enumerate(found.points)
    ]
    lines.append(aligned(("made (UTC)", "value ± std", "", "run"), rows))
    lines += ["", *draw(picture(found), WIDTH, ascii_only=not shows_all(encoding))]
    lines += [wrapped("left out:", [line], WIDTH) for line in found.left_out]
    return "\n".join(lines)


def sentence(found: Trend) -> str:
    """Whether anything speaks for a change."""
    chart, count = found.chart, len(found.points)
    if chart is None:
        return f"{count} run{'s' if count != 1 else ''}; limits need {FEWEST}"
    std = (chart.high - chart.low) / 6.0
    limits = f"{number(chart.low, std)} .. {number(chart.high, std)} by {chart.baseline} runs"
    if not chart.changed:
        return f"no change in {count} runs; limits {limits}"
    first = min([*chart.beyond, *chart.shifted])
    return f"changed, seen first on {found.points[first].created[:10]}; limits {limits}"


def picture(found: Trend) -> Plot:
    """Values over the number of the run, with centre and limits."""
    numbers = tuple(float(place + 1) for place in range(len(found.points)))
    values = tuple(point.value.value for point in found.points)
    ends = (numbers[0], numbers[-1])
    chart = found.chart
    lines = [Series("", ends, (at, at)) for at in (chart.low, chart.centre, chart.high)] if chart else []
    return Plot("run", f"{found.result} [{found.units}]", (Series("a run", numbers, values),), tuple(lines))
