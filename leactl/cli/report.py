"""`leactl report`: a datasheet from runs."""

import json
from itertools import takewhile
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand

from leactl.cli.helptext import examples, single_command
from leactl.errors import InputError

app = single_command()

COMPARED = "--compare"


class SeveralCompared(TyperCommand):
    """A command whose `--compare` takes all paths up to the next option, as a shell expands a pattern."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert `--compare` before each of its paths after the first, and parse.

        Raises
        ------
        InputError : no path follows `--compare`.
        """
        completed_words: list[str] = []
        remaining_words = list(args)
        while remaining_words:
            word = remaining_words.pop(0)
            completed_words.append(word)
            if word == COMPARED:
                paths = list(takewhile(lambda path: not path.startswith("-"), remaining_words))
                del remaining_words[: len(paths)]
                if not paths:
                    raise InputError(f"{COMPARED}: no runs after it; give run files, or folders of them")
                completed_words += [inserted_word for path in paths for inserted_word in (COMPARED, path)][1:]
        return super().parse_args(ctx, completed_words)


@app.command(
    cls=SeveralCompared,
    epilog=examples("report runs --html sheet.html", "report new --html sheet.html --pdf --compare old"),
)
def report(
    runs: list[Path] = typer.Argument(metavar="RUN...", help="Run files, or folders of them, of any experiments."),
    html: Path | None = typer.Option(None, "--html", metavar="OUT.html", help="Write the datasheet."),
    pdf: bool = typer.Option(False, "--pdf", help="Print it to OUT.pdf too, by an installed Chromium."),
    compare: list[Path] = typer.Option(
        [], COMPARED, metavar="RUN...", help="Other runs or folders, to stand beside the first."
    ),
    settings: list[str] = typer.Option(
        [], "--set", metavar="NAME=NUMBER", help="Set a numeric option of the analysis, such as torque_constant=0.5."
    ),
    as_json: bool = typer.Option(False, "--json", help="Print the table as JSON on stdout."),
) -> None:
    """Make a datasheet from runs: results with intervals and sources beside the paper's, and the figures."""
    from leactl.analysis.analyze import numeric_options
    from leactl.report.datasheet.make import DatasheetOutputs, make

    sheet = make(runs, compare, numeric_options(settings), DatasheetOutputs(html, pdf, as_json))
    if as_json:
        typer.echo(json.dumps(sheet.as_json(), allow_nan=False))
