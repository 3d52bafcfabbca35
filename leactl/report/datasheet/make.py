"""Make a datasheet from run files: check the command line, analyse the runs, then write HTML and PDF."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from leactl.errors import InputError
from leactl.report.datasheet.instruments import warnings_of
from leactl.report.datasheet.page import page
from leactl.report.datasheet.runset import RunSet, check_options, read_runs
from leactl.report.datasheet.sheet import Datasheet
from leactl.report.outputs import check_files
from leactl.report.pdf import print_pdf, required_browser
from leactl.report.progress_line import ProgressLine
from leactl.runfile.publish import replacement


@dataclass(frozen=True)
class DatasheetOutputs:
    """The outputs of a datasheet that the command line asks for."""

    html: Path | None  # file of the page
    pdf: bool  # whether the page is printed too
    json: bool  # whether the command prints JSON

    @property
    def pdf_file(self) -> Path | None:
        """Return the path of the PDF, in the folder of the page; None without a PDF."""
        return self.html.with_suffix(".pdf") if self.pdf and self.html is not None else None

    def check(self, inputs: Sequence[Path]) -> None:
        """Raise if an output cannot be written, before minutes are spent on the analyses.

        Raises
        ------
        InputError : no output is named, the name of the page does not end in .html or .htm, a file cannot be written or
            is an input, or no browser is installed that prints a PDF.
        """
        if self.html is None and (self.pdf or not self.json):
            raise InputError("--html OUT.html: where the datasheet goes is missing; --json alone prints its table")
        if self.html is not None and self.html.suffix.lower() not in (".html", ".htm"):
            raise InputError(f"--html {self.html}: a name that ends in .html was expected")
        check_files([path for path in (self.html, self.pdf_file) if path is not None], inputs)
        if self.pdf:
            required_browser()


def make(
    runs: Sequence[Path], compared: Sequence[Path], options: Mapping[str, float], outputs: DatasheetOutputs
) -> Datasheet:
    """Analyse one set of runs, or compare two, and write the outputs.

    Runs that were not analysed and instruments that were overdue for calibration are reported on stderr.

    Parameters
    ----------
    runs : run files or folders of the first set.
    compared : run files or folders of the second set; empty for a datasheet of one set.
    options : options of analyses by name; each analysis gets those that it takes.

    Raises
    ------
    InputError : see `read_runs` and `DatasheetOutputs.check`; an option that no analysis takes; no run that could be
        analysed; or a run in both sets.
    """
    check_options(options)
    outputs.check([*runs, *compared])
    with ProgressLine() as step:
        prefixes = ("A", "B") if compared else ("R",)
        paths_by_set = (runs, compared) if compared else (runs,)
        sets = tuple(
            read_runs(paths, prefix, options, step) for paths, prefix in zip(paths_by_set, prefixes, strict=True)
        )
        refuse_shared(sets)
        datasheet = Datasheet(with_distinct_names(sets))
        datasheet.refuse_empty()
        step("writing")
        if outputs.html is not None:
            with replacement(outputs.html) as path:
                path.write_text(page(datasheet, outputs.html), encoding="utf-8")
            if outputs.pdf_file is not None:
                print_pdf(outputs.html, outputs.pdf_file)
    for line in warnings_of(datasheet.sets):
        print(f"leactl: warning: {line}", file=sys.stderr)
    for entry in (entry for run_set in datasheet.sets for entry in run_set.entries if entry.fault):
        print(f"leactl: not analysed: {entry.path}: {entry.fault}", file=sys.stderr)
    return datasheet


def refuse_shared(sets: Sequence[RunSet]) -> None:
    """Raise if a run is in two sets: it would be compared with itself.

    Raises
    ------
    InputError : a line for each shared run.
    """
    first_use: dict[str, tuple[int, Path]] = {}  # by identity: number of the set, path
    faults = []
    for number, run_set in enumerate(sets):
        for entry in run_set.entries:
            first_number, first_path = first_use.setdefault(entry.identity, (number, entry.path))
            if first_number != number:
                faults.append(f"{entry.path}: the same run as {first_path} of the other set; give each run once")
    if faults:
        raise InputError(faults)


def with_distinct_names(sets: tuple[RunSet, ...]) -> tuple[RunSet, ...]:
    """Return the sets with `A` and `B` behind their names where the names are the same."""
    if len({run_set.name for run_set in sets}) == len(sets):
        return sets
    return tuple(replace(run_set, name=f"{run_set.name} {'AB'[k]}") for k, run_set in enumerate(sets))
