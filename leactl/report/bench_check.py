"""Results of a check of a bench as text.

Each statement of the bench file and each notice of a device has a line, and a second one if the bench file needs a
change. The last line counts the verdicts.
"""

import math
from collections.abc import Iterator, Sequence

from leactl.report.terminal import list_line, number
from leactl.runner.bench_check.statement import Statement, StatementVerdict

DEVICE_WIDTH = 14  # characters
VERDICT_WIDTH = 11  # characters; "cannot tell" fills it


def lines(statements: Sequence[Statement]) -> Iterator[str]:
    """Yield the verdict on each statement with the change that it needs, and at the end the number of each verdict."""
    for statement in statements:
        head = f"{statement.verdict:<{VERDICT_WIDTH}}  {statement.device:<{DEVICE_WIDTH}}  "
        text = "; ".join(filter(None, (_measurement(statement), statement.why)))
        yield list_line(head, ": ".join(filter(None, (statement.about, text))))
        if statement.change:
            yield list_line(" " * (VERDICT_WIDTH + 2), statement.change)
    counts = [(verdict, sum(statement.verdict is verdict for statement in statements)) for verdict in StatementVerdict]
    yield f"{len(statements)} checks: {', '.join(f'{count} {verdict}' for verdict, count in counts)}"


def _measurement(statement: Statement) -> str:
    """Return the measured value with its deviation and unit, and the expected range; empty if the value is NaN."""
    if math.isnan(statement.measured):
        return ""
    unit = "" if statement.units == "1" else f" {statement.units}"
    deviation = "" if math.isnan(statement.std) else f" ± {number(statement.std, statement.std)}"
    value = number(statement.measured, statement.std) if statement.std > 0.0 else f"{statement.measured:.4g}"
    measurement = f"{value}{deviation}{unit}"
    if math.isnan(statement.low):
        return measurement
    expected = (
        f"above {statement.low:.4g}" if math.isnan(statement.high) else f"{statement.low:.4g} to {statement.high:.4g}"
    )
    return f"{measurement}, expected {expected}{unit}"
