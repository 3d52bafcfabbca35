"""The CPU time of commands that list or show, beside the import of the libraries that they use."""

import os
import subprocess
import sys

import pytest

MOST_S = 0.4  # CPU time, the interpreter's start included
ROUNDS = 7
COMMANDS = [
    "protocol list",
    "protocol show friction",
    "protocol plan friction",
    "bench list",
    "bench show emulated",
    "motor list",
    "driver list",
    "gap effects",
]


def cpu_s(*command):
    """The least CPU time of some rounds: what other processes slow down is not the command's."""
    taken = []
    for _ in range(ROUNDS):
        before = sum(os.times()[2:4])
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        taken.append(sum(os.times()[2:4]) - before)
    return min(taken)


@pytest.mark.parametrize("words", COMMANDS)
def test_a_list_is_there_at_once(words, figure, monkeypatch, tmp_path):
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)  # an installed package is compiled once
    monkeypatch.setenv("PYTHONPYCACHEPREFIX", str(tmp_path.parent / "compiled"))
    subject = cpu_s(sys.executable, "-m", "leactl", *words.split())
    peer = cpu_s(sys.executable, "-c", "import numpy, pydantic, typer, yaml")
    figure(f"leactl {words}: {subject:.2f} s of CPU time, at most {MOST_S} s; importing its libraries: {peer:.2f} s")
    assert subject <= MOST_S
