"""A command line that cannot be read: one line with the value and the way to the usage."""

import re

import pytest

from .terminal import leactl


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("motor scale --radius abc", "invalid value for '--radius': .*, found 'abc'; leactl motor scale --help"),
        ("motor scale --radius=abc", "invalid value for '--radius': .*, found 'abc'; leactl motor scale --help"),
        ("motor scale", "missing option '--radius'; leactl motor scale --help"),
        (
            "thermal limits --ambient nan",
            "invalid value for '--ambient': .*, found 'nan'; leactl thermal limits --help",
        ),
        ("analyze", "missing argument .*; leactl analyze --help"),
        ("motor skale", "no such command 'skale'.*; leactl motor --help"),
        ("stats x.h5 --jason", "no such option: --jason.*; leactl stats --help"),
    ],
)
def test_usage_errors_are_one_line(words, message):
    done = leactl(*words.split())
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert re.fullmatch(f"leactl: {message} tells the usage\n", done.stderr), done.stderr


def test_a_command_without_a_word_gets_its_help():
    done = leactl("motor")
    assert done.returncode in (0, 2)  # click below 8.2 and from there
    assert "Commands:" in done.stdout + done.stderr
