"""Rows of a list: a line each into a pipe, for other programs; in a terminal as many as their text needs."""

import shutil
import sys
import textwrap

LEAST = 20  # columns for the text; with fewer it stays in one line


def row(head: str, text: str) -> str:
    """One row, its text under its own column where the terminal is too narrow for it."""
    line = f"{head}{text}".rstrip()
    if not sys.stdout.isatty():
        return line
    width = shutil.get_terminal_size((80, 24)).columns
    if len(line) <= width or width < len(head) + LEAST:
        return line
    return textwrap.fill(
        text,
        width,
        initial_indent=head,
        subsequent_indent=" " * len(head),
        break_long_words=False,
        break_on_hyphens=False,
    )
