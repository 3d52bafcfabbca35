"""Output files of a diagnosis: JSON, a page, and an augmented model."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from leactl.gap.diagnosis import DiagnosisResult
from leactl.model.nominal import as_mapping
from leactl.report.outputs import check_files

STDOUT = Path("-")


@dataclass(frozen=True)
class Outputs:
    """The files that a diagnosis is written to; `-` for the JSON is stdout."""

    json: Path | None = None
    html: Path | None = None
    model: Path | None = None

    def check(self, inputs: Sequence[Path] = ()) -> None:
        """Check that all files can be written, before minutes are spent on the diagnosis.

        An existing file is replaced, but never an input.

        Raises
        ------
        InputError : a file is an input or no plain file, its folder does not exist, or one is named twice.
        """
        files = [path for path in (self.json, self.html, self.model) if path is not None and path != STDOUT]
        to_stdout = STDOUT in (self.html, self.model)
        check_files(files, inputs, ["-: only --json goes to stdout; name a file"] if to_stdout else [])

    def write(self, diagnosis: DiagnosisResult) -> None:
        """Write the files, each atomically; JSON on stdout comes last."""
        texts: list[tuple[Path, str]] = []
        if self.model is not None:
            texts.append((self.model, yaml.safe_dump(as_mapping(diagnosis.extra["augmented"]), sort_keys=False)))
        if self.html is not None:
            from leactl.report.gap_page import page

            texts.append((self.html, page(diagnosis)))
        if self.json is not None:
            texts.append((self.json, json.dumps(diagnosis.as_json(), indent=1, allow_nan=False) + "\n"))
        for path, text in texts:
            if path == STDOUT:
                sys.stdout.write(text)
            else:
                publish(path, text)


def publish(path: Path, text: str) -> None:
    """Write a text file and replace an earlier one atomically; an interrupted write leaves no partial file behind."""
    partial_file = path.with_name(f".{path.name}.part")
    try:
        partial_file.write_text(text, encoding="utf-8")
        partial_file.replace(path)
    finally:
        partial_file.unlink(missing_ok=True)
