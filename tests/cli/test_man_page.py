"""The man page: it names every command and its options, as `--help` tells them."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.test_help import COMMANDS

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    pytest.importorskip("sphinx", reason="the man page is made by leactl[docs]")
    pytest.importorskip("myst_parser", reason="the man page is made by leactl[docs]")
    folder = tmp_path_factory.mktemp("man")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-b", "man", DOCS, folder]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    text = (folder / "leactl.1").read_text(encoding="utf-8")
    return re.sub(r"\\f[BIRP]|\\(?=[-&])", "", re.sub(r"\\\((aq|dq|ga|ha|ti)", "'", text))  # a character each


def test_it_names_every_command_once_in_its_list_and_once_with_its_help(page):
    names = [" ".join(path) for path in COMMANDS]
    assert page.startswith('.\\" Man page generated')
    assert re.search(r'^\.TH "?LEACTL"? "?1"?', page, re.MULTILINE)
    assert re.findall(r"^\.SH LEACTL (.*)$", page, re.MULTILINE) == [name.upper() for name in names]
    assert sorted(re.findall(r"^([a-z][a-z ]*): [A-Z]", page, re.MULTILINE)) == sorted(names)


def test_it_has_every_option(page):
    helps = re.split(r"^\.SH LEACTL .*$", page, flags=re.MULTILINE)[1:]
    for command, text in zip(COMMANDS.values(), helps, strict=True):
        options = [name for param in command.params for name in param.opts if name.startswith("--")]
        assert [name for name in options if name not in text] == [], command.name
        lines = [line for line in text.splitlines() if not line.strip().startswith("leactl ")]
        assert max(map(len, lines)) <= 70  # beside the indents of `man`, in a terminal of 80 columns


def test_it_has_no_link_and_no_table(page):
    assert ".TS" not in page
    assert "|---" not in page
    assert "<>" not in page
