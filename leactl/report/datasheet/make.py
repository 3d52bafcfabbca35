"""From paths to the files of a datasheet: faults of the command line, then minutes of analysis, then the files."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from leactl.errors import InputError
from leactl.report.datasheet.instruments import warnings_of
from leactl.report.datasheet.page import page
from leactl.report.datasheet.runset import RunSet, read_runs, refuse_untaken
from leactl.report.datasheet.sheet import Datasheet
from leactl.report.outputs import check_files
from leactl.report.pdf import browser, print_pdf
from leactl.report.steps import Steps
from leactl.runfile.publish import replacement


@dataclass(frozen=True)
class Wanted:
    """What is to come of it."""

    html: Path | None
    pdf: bool
    json: bool

    @property
    def printed(self) -> Path | None:
        """Where the PDF goes: beside the page."""
        return self.html.with_suffix(".pdf") if self.pdf and self.html is not None else None

    def refuse(self, inputs: Sequence[Path]) -> None:
        """Refuse what could not be written.

        Raises
        ------
        InputError : nothing is wanted, no place for it, or no browser for a PDF.
        """
        if self.html is None and (self.pdf or not self.json):
            raise InputError("--html OUT.html: where the datasheet goes is missing; --json alone prints its table")
        if self.html is not None and self.html.suffix.lower() not in (".html", ".htm"):
            raise InputError(f"--html {self.html}: a name that ends in .html was expected")
        check_files([path for path in (self.html, self.printed) if path is not None], inputs)
        if self.pdf:
            browser()


def make(runs: Sequence[Path], compared: Sequence[Path], options: Mapping[str, float], wanted: Wanted) -> Datasheet:
    """Analyse runs, or two sets of them side by side, and write what is wanted; runs that gave nothing go to stderr.

    Raises
    ------
    InputError : see `read_runs` and `Wanted.refuse`; an option that no analysis takes; nothing could be analysed, or a
        run is in both sets.
    """
    refuse_untaken(options)
    wanted.refuse([*runs, *compared])
    with Steps() as step:
        prefixes = ("A", "B") if compared else ("R",)
        groups = (runs, compared) if compared else (runs,)
        sets = tuple(read_runs(paths, prefix, options, step) for paths, prefix in zip(groups, prefixes, strict=True))
        refuse_shared(sets)
        sheet = Datasheet(with_distinct_names(sets))
        sheet.refuse_empty()
        step("writing")
        if wanted.html is not None:
            with replacement(wanted.html) as path:
                path.write_text(page(sheet, wanted.html), encoding="utf-8")
            if wanted.printed is not None:
                print_pdf(wanted.html, wanted.printed)
    for line in warnings_of(sheet.sets):
        print(f"leactl: warning: {line}", file=sys.stderr)
    for entry in (entry for run_set in sheet.sets for entry in run_set.entries if entry.fault):
        print(f"leactl: not analysed: {entry.path}: {entry.fault}", file=sys.stderr)
    return sheet


def refuse_shared(sets: Sequence[RunSet]) -> None:
    """Refuse a run in two sets: it would be compared with itself.

    Raises
    ------
    InputError : one line for each.
    """
    seen: dict[str, tuple[int, Path]] = {}
    faults = []
    for number, run_set in enumerate(sets):
        for entry in run_set.entries:
            where, first = seen.setdefault(entry.identity, (number, entry.path))
            if where != number:
                faults.append(f"{entry.path}: the same run as {first} of the other set; give each run once")
    if faults:
        raise InputError(faults)


def with_distinct_names(sets: tuple[RunSet, ...]) -> tuple[RunSet, ...]:
    """Sets with names that differ."""
    if len({run_set.name for run_set in sets}) == len(sets):
        return sets
    return tuple(replace(run_set, name=f"{run_set.name} {'AB'[k]}") for k, run_set in enumerate(sets))
