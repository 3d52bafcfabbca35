"""Lists: a line each into a pipe; in a terminal no wider than it is, with the same words."""

import os

import pytest

from tests.cli.terminal import COMMAND, leactl

LISTS = [
    "driver list",
    "protocol list",
    "campaign list",
    "bench faults",
    "bench check emulated",
    "gap effects",
    "gap effects cogging",
]


def in_a_terminal(arguments, columns):
    """What a terminal of this width is given."""
    pexpect = pytest.importorskip("pexpect")
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    child = pexpect.spawn(
        COMMAND[0], COMMAND[1:] + arguments, env=environment, dimensions=(50, columns), encoding="utf-8", timeout=60
    )
    text = child.read()
    child.close()
    assert child.exitstatus == 0
    return text.replace("\r\n", "\n")


@pytest.mark.parametrize("what", LISTS)
def test_a_list_is_as_wide_as_its_terminal(what):
    arguments = what.split()
    piped = leactl(*arguments).stdout
    assert in_a_terminal(arguments, 400) == piped
    narrow = in_a_terminal(arguments, 80)
    assert max(map(len, narrow.splitlines())) <= 80 < max(map(len, piped.splitlines()))
    assert narrow.split() == piped.split()
