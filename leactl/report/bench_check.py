"""What a check of a bench has shown: a line for each statement of its file, and below it what to change."""

import math
from collections.abc import Iterator, Sequence

from leactl.report.terminal import list_line, number
from leactl.runner.bench_check.statement import Statement, StatementVerdict

DEVICE_WIDTH = 14


def lines(statements: Sequence[Statement]) -> Iterator[str]:
    """Return the lines, the verdict first, and how many have which verdict as the last."""
    for each in statements:
        head = f"{each.verdict:<11}  {each.device:<{DEVICE_WIDTH}}  "
        text = "; ".join(filter(None, (_numbers(each), each.why)))
        yield list_line(head, ": ".join(filter(None, (each.about, text))))
        if each.change:
            yield list_line(" " * 13, each.change)
    counts = [(verdict, sum(each.verdict is verdict for each in statements)) for verdict in StatementVerdict]
    yield f"{len(statements)} checks: {', '.join(f'{count} {verdict}' for verdict, count in counts)}"


def _numbers(each: Statement) -> str:
    """The measured value with its deviation and unit, and what was expected."""
    if math.isnan(each.measured):
        return ""
    unit = "" if each.units == "1" else f" {each.units}"
    deviation = "" if math.isnan(each.std) else f" ± {number(each.std, each.std)}"
    shown = number(each.measured, each.std) if each.std > 0.0 else f"{each.measured:.4g}"
    low, high = (f"{end:.4g}" for end in (each.low, each.high))
    if math.isnan(each.low):
        return f"{shown}{deviation}{unit}"
    return f"{shown}{deviation}{unit}, expected {f'above {low}' if math.isnan(each.high) else f'{low} to {high}'}{unit}"
