"""The site of the manual and the man page, with the extra `docs`.

`sphinx-build -aEW --keep-going docs site` writes the site, `sphinx-build -b man docs build/man` writes
`build/man/leactl.1`.
"""

import re
from collections.abc import Iterator
from typing import Any

project = "leactl"
author = "the leactl contributors"
extensions = ["myst_parser"]
myst_heading_anchors = 3  # links to headings, as the pages write them, are checked
html_theme = "furo"
html_title = "leactl"
html_show_sourcelink = False
html_show_copyright = False

COMMANDS = "reference/commands"
MAN_WIDTH = 66  # characters of a literal line, which `man` indents: a terminal of 80 columns shows it whole
AS_MAN = (  # what a man page cannot hold well, and what stands in its place
    (r"^\|( command |---)\|.*\n", ""),
    (r"^\| `(.*)` \| (.*) \|$", r"- **\1**: \2"),  # a table has narrow columns there
    (r"\[([^]]*)\]\([^)]*\)", r"\1"),  # links to other pages
)
man_pages = [(COMMANDS, "leactl", "characterise electric actuators, diagnose the sim-to-real gap", author, 1)]


def setup(app: Any) -> None:
    """Make the man page of the page of commands."""
    app.connect("source-read", write_for_man)


def write_for_man(app: Any, name: str, source: list[str]) -> None:
    """Write the page of commands for `man`, and append what `--help` says of each command."""
    if app.builder.name == "man" and name == COMMANDS:
        for pattern, replacement in AS_MAN:
            source[0] = re.sub(pattern, replacement, source[0], flags=re.MULTILINE)
        source[0] += "".join(f"\n## {title}\n\n```text\n{text}\n```\n" for title, text in help_texts())


def help_texts() -> Iterator[tuple[str, str]]:
    """Yield each command and its help text, in the order of the page."""
    from typer import Context
    from typer.main import get_command

    from leactl.cli.main import app

    def walk(command: Any, words: str) -> Iterator[tuple[str, str]]:
        for name in getattr(command, "commands", {}):
            yield from walk(command.get_command(None, name), f"{words} {name}")
        if not hasattr(command, "commands"):
            context = Context(command, info_name=words, terminal_width=MAN_WIDTH, **app.info.context_settings)
            yield words, command.get_help(context)

    yield from walk(get_command(app), "leactl")
