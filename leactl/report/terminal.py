"""Results as text: a table for each actuator and condition with the paper's figures, the notes, and a plot.

The text has no colours, so that it reads the same in a pipe, a log and a terminal. Characters that the stream cannot
show are replaced by ASCII.
"""

import locale
import math
import os
import shutil
import sys
import textwrap
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from typing import IO, Any

from leactl import yamlfile
from leactl.analysis.estimate import Estimate, Result
from leactl.report.plot import draw

ASCII = str.maketrans({"±": "+-", "…": "..."})
WIDEST_PLOT = 100  # characters; a wider plot would show no more
SMALLEST_WIDTH = 40  # characters
TEXT_WIDTH = 80  # characters of texts that have the same width on every terminal
FEWEST_COLUMNS = 20  # for the text of an entry of a list; with fewer columns the entry is not wrapped


def print_result(result: Result, plot: bool = True) -> None:
    """Print a result in the width of the terminal, or in 80 columns into a pipe."""
    width = terminal_columns()
    sys.stdout.write(render(result, width, encoding_of_stdout(), plot))


def terminal_columns() -> int:
    """Return the width of the terminal in characters, 80 into a pipe."""
    return shutil.get_terminal_size((80, 24)).columns


def encoding_of_stdout() -> str:
    """Return the encoding of the terminal behind stdout."""
    return encoding_of(sys.stdout)


def encoding_of(stream: IO[str]) -> str:
    """Return the encoding of a stream, or that of the locale in a UTF-8 mode that the user did not ask for.

    Python turns that mode on by itself where the terminal may show ASCII alone.
    """
    is_implicit_utf8 = sys.flags.utf8_mode and not {"PYTHONUTF8", "PYTHONIOENCODING"} & os.environ.keys()
    return locale.getencoding() if is_implicit_utf8 else getattr(stream, "encoding", None) or "ascii"


def render(result: Result, width: int = 80, encoding: str = "utf-8", plot: bool = True) -> str:
    """Return the whole result as text for a stream of this width and encoding."""
    shows_unicode = shows_all(encoding)
    width = min(max(width, SMALLEST_WIDTH), WIDEST_PLOT)
    parts = [wrapped(f"{result.experiment}, {len(result.runs)} run{'s' * (len(result.runs) > 1)}:", result.runs, width)]
    for group in result.groups:
        title = ", ".join(filter(None, group))
        parts.append("\n".join(filter(None, (title, table(result, group)))))
        figures = [figure for figure in result.plots if plot and (figure.actuator, figure.condition) == group]
        parts += ["\n".join(draw(figure, width, ascii_only=not shows_unicode)) for figure in figures]
    if result.notes:
        parts.append("\n".join(wrapped("note:", [note], width) for note in result.notes))
    return encodable("\n\n".join(part for part in parts if part) + "\n", encoding)


def encodable(text: str, encoding: str) -> str:
    """Replace the characters that a stream of this encoding cannot show."""
    return text if shows_all(encoding) else text.translate(ASCII).encode(encoding, "replace").decode(encoding)


def shows_all(encoding: str) -> bool:
    """Return whether a stream of this encoding can show the characters of tables and plots."""
    try:
        "±⣿│┤└─┴".encode(encoding)
    except (UnicodeEncodeError, LookupError):
        return False
    return encoding.lower().replace("-", "").replace("_", "").startswith("utf")


def table(result: Result, group: tuple[str, str]) -> str:
    """Return a table of the estimates of one actuator and condition, with the figure of the paper below an estimate."""
    paper = paper_figures(result.experiment, group[1])
    rows, parent_name = [], ""
    for estimate in result.results:
        if (estimate.actuator, estimate.condition) != group:
            continue
        is_part = bool(parent_name) and estimate.name.startswith(f"{parent_name}_")
        parent_name = parent_name if is_part else estimate.name
        name = f"  {estimate.name.removeprefix(parent_name + '_')}" if is_part else estimate.name
        rows.append(
            (name, value_text(estimate), interval_text(estimate), estimate.units if estimate.units != "1" else "")
        )
        if estimate.name in paper:
            rows.append(("  paper", paper[estimate.name], "", ""))
    return aligned(("", "value ± std", "95 % interval", "units"), rows)


def print_summary(results: Sequence[Result], names: Sequence[str]) -> None:
    """Print a table for each named estimate, with a row for each condition, over several experiments."""
    tables = []
    for name in names:
        estimates = [
            (result.experiment, estimate) for result in results for estimate in result.results if estimate.name == name
        ]
        rows = [
            (
                estimate.condition,
                value_text(estimate),
                interval_text(estimate),
                paper_figures(experiment, estimate.condition).get(name, ""),
            )
            for experiment, estimate in estimates
        ]
        title = f"{name} [{estimates[0][1].units}]"
        tables.append(f"{title}\n{aligned(('', 'value ± std', '95 % interval', 'paper'), rows)}\n")
    sys.stdout.write(encodable("\n".join(tables), encoding_of_stdout()))


def aligned(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return rows under headings, in columns as wide as their longest cell; nothing is cut or folded.

    A cell at the end of its row does not widen its column.
    """
    widths = [
        max(len(row[column]) for row in (headings, *rows) if row is headings or any(row[column + 1 :]))
        for column in range(len(headings))
    ]
    lines = ("  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)) for row in (headings, *rows))
    return "\n".join(line.rstrip() for line in lines)


def paper_figures(experiment: str, condition: str) -> Mapping[str, str]:
    """Return the figures of the paper for an experiment and condition, by result; empty if the paper has none."""
    by_condition = figures_by_condition(experiment)
    return {**by_condition.get("any", {}), **by_condition.get(condition, {})}


@cache
def figures_by_condition(experiment: str) -> Mapping[str, Mapping[str, str]]:
    """Return the paper's figures of an experiment by condition; those of `any` hold under every condition."""
    entry = resources.files("leactl.report") / "paper" / f"{experiment}.yaml"
    if not entry.is_file():
        return {}
    return yamlfile.parse(entry.read_text(encoding="utf-8"), entry.name).data  # type: ignore[no-any-return]


@cache
def units_in_paper() -> Mapping[str, str]:
    """Return the units of the paper's figures by the names of results."""
    entry = resources.files("leactl.report") / "units_in_paper.yaml"
    return yamlfile.parse(entry.read_text(encoding="utf-8"), entry.name).data  # type: ignore[no-any-return]


def value_text(estimate: Estimate) -> str:
    """Return value ± standard uncertainty, both rounded to two significant digits of the uncertainty (GUM, 7.2.6)."""
    if not math.isfinite(estimate.std):
        return without_uncertainty(estimate.value)
    return f"{number(estimate.value, estimate.std)} ± {number(estimate.std, estimate.std)}"


def interval_text(estimate: Estimate) -> str:
    """Return the 95 % interval as text: a lower bound if its upper end is infinite, empty if an end is not known."""
    if estimate.low > 0.0 and math.isinf(estimate.high):
        return f"> {estimate.low:.6g}"
    if not (math.isfinite(estimate.low) and math.isfinite(estimate.high)):
        return ""
    return f"{number(estimate.low, estimate.std)} .. {number(estimate.high, estimate.std)}"


def number(value: float, std: float) -> str:
    """Return a value rounded to two significant digits of its uncertainty."""
    if not (0.0 < std < math.inf and math.isfinite(value)):
        return f"{value:.6g}"
    exponent = math.floor(math.log10(float(f"{std:.1e}")))
    if exponent < -8:
        return f"{value:.{max(math.floor(math.log10(abs(value) or std)) - exponent + 1, 1)}e}"
    return f"{round(value, 1 - exponent) + 0.0:.{max(1 - exponent, 0)}f}"  # no negative zero


def without_uncertainty(value: float) -> str:
    """Return a value that has no uncertainty, with four decimals, or with more if it would look like 1."""
    if not math.isfinite(value):
        return "not known"
    decimals = next((count for count in range(4, 12) if value == 1.0 or float(f"{value:.{count}f}") != 1.0), 12)
    return f"{value:.{decimals}f}"


def wrapped(head: str, items: Any, width: int) -> str:
    """Return a head and its items as lines of at most `width` characters; long words such as paths stay whole."""
    text = f"{head} {', '.join(items)}"
    return textwrap.fill(text, width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)


def list_line(head: str, text: str) -> str:
    """Return one entry of a list as a single line, which is wrapped if stdout is a terminal that is too narrow.

    The wrapped lines are indented by the length of `head`.
    """
    line = f"{head}{text}".rstrip()
    if not sys.stdout.isatty():
        return line
    width = terminal_columns()
    if len(line) <= width or width < len(head) + FEWEST_COLUMNS:
        return line
    return textwrap.fill(
        text,
        width,
        initial_indent=head,
        subsequent_indent=" " * len(head),
        break_long_words=False,
        break_on_hyphens=False,
    )


def duration(seconds: float, always_hours: bool = False) -> str:
    """Return a time [s] as minutes and seconds, with hours from one hour on: `75` as `1:15`, `4000` as `1:06:40`.

    With `always_hours`, 75 s are `0:01:15`.
    """
    minutes, whole_seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours or always_hours:
        return f"{hours}:{minutes:02d}:{whole_seconds:02d}"
    return f"{minutes}:{whole_seconds:02d}"
