"""Sessions in the pages: what a person types after `$ `, and what the terminal shows below it.

`python -m tests.cli.sessions PAGE` runs the sessions of a page in an empty folder and writes what came below each line.
"""

import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.cli.terminal import leactl

BLOCK = re.compile(r"```console\n(.*?)```", re.DOTALL)
FILE = re.compile(r"`([\w-]+\.\w+)`:\n\n```\w+\n(.*?)```", re.DOTALL)  # named at the end of the sentence above it
CHANGING = (  # from run to run: when, drawn names, how long this machine takes
    (re.compile(r"\d{8}T\d{6}Z"), "DATE"),
    (re.compile(r"(?<=-)[0-9a-f]{4}(?=\.h5)"), "ID"),
    (re.compile(r"\d+(\.\d+)? s in all"), "N s in all"),
    (re.compile(r"done in [\d.]+ s"), "done in N s"),
)
LIVE = re.compile(r"^.* left; .*\n", re.MULTILINE)  # the live view, where a run takes seconds


def masked(shown: str) -> str:
    """What a terminal shows, without what changes from run to run."""
    for pattern, word in CHANGING:
        shown = pattern.sub(word, shown)
    return shown


def commands(block: str) -> Iterator[tuple[str, str]]:
    """Each line that is typed in a block, and what is shown below it."""
    for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
        line, _, shown = part.partition("\n")
        yield line, shown


def typed(line: str, folder: Path) -> str:
    """Type a line in a folder; returns what is shown."""
    line, _, count = line.partition(" | head -")
    words = shlex.split(line)
    if words[0] != "leactl":
        return subprocess.run(line, shell=True, cwd=folder, capture_output=True, text=True, check=True).stdout
    words = [name for word in words[1:] for name in (sorted(map(str, Path().glob(word))) if "*" in word else [word])]
    surroundings = {"LEACTL_STATE": str(folder / "state"), "COLUMNS": "80", "PYTHONIOENCODING": "utf-8"}
    done = leactl(*words, **surroundings)
    shown = LIVE.sub("", done.stderr + done.stdout if done.returncode == 0 else done.stdout + done.stderr)
    return "".join(shown.splitlines(keepends=True)[: int(count) if count else None])


def write_files(page: str, folder: Path) -> None:
    """Save the files that a page has the reader save."""
    for name, text in FILE.findall(page):
        (folder / name).write_text(text, encoding="utf-8")


def filled(page: str, folder: Path) -> str:
    """A page with what its lines show now."""
    write_files(page, folder)

    def typed_again(block: re.Match[str]) -> str:
        return "```console\n" + "".join(f"$ {line}\n{typed(line, folder)}" for line, _ in commands(block[1])) + "```"

    return BLOCK.sub(typed_again, page)


if __name__ == "__main__":
    path = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)
        path.write_text(filled(path.read_text(encoding="utf-8"), Path(name)), encoding="utf-8")
