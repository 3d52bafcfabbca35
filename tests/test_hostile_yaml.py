"""YAML that is meant to hang, fill memory or flood a screen: each kind of file refuses it in few lines."""

import os

import pytest

from leactl import yamlfile
from leactl.bench import benchfile
from leactl.errors import InputError
from leactl.model.motor import load_sheet
from leactl.model.nominal import read_model
from leactl.protocol import protocolfile
from leactl.runfile.importing.importer import import_runs
from leactl.runner.campaign import campaignfile

KINDS = {
    "protocol": lambda path: protocolfile.load(str(path)),
    "bench": lambda path: benchfile.load(str(path)),
    "motor": lambda path: load_sheet(str(path)),
    "model": read_model,
    "campaign": lambda path: campaignfile.load(str(path)),
    "mapping": lambda path: import_runs([], path, path.parent),
}
TEXTS = {
    "unknown keys": "".join(f"k{number}: {number}\n" for number in range(60_000)),
    "fewer unknown keys": "".join(f"k{number}: {number}\n" for number in range(20_000)),
    "brackets": "a: " + "[" * 500_000,
    "braces": "a: " + "{" * 500_000,
    "brackets behind a key that stands twice": "a: 1\na: " + "[" * 500_000,
    "dashes": "- " * 400_000,
    "complex keys": "? " * 400_000,
    "aliases": "a0: &a0 [x]\n" + "".join(f"a{n}: &a{n} [{f'*a{n - 1}, ' * 9}]\n" for n in range(1, 999)),
    "values": "steps: [" + "1," * 200_000 + "1]",
    "a long key": f"{'k' * 1000}: 1\n" * 2,
    "a long value": f"winding: {'k' * 900_000}",
    "a long number": f"winding: {'9' * 900_000}",
    "terminal escapes": '"a\\e[31m": "\\e[31m"',
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("text", TEXTS)
def test_few_short_printable_lines(tmp_path, kind, text):
    path = tmp_path / "x.yaml"
    path.write_text(TEXTS[text])
    with pytest.raises(InputError) as caught:
        KINDS[kind](path)
    assert len(caught.value.faults) < 10
    assert all(len(fault) < 2 * yamlfile.LONGEST_FAULT and fault.isprintable() for fault in caught.value.faults)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_regular_file_is_not_read(tmp_path, kind):
    fifo, zero = tmp_path / "fifo.yaml", tmp_path / "zero.yaml"
    os.mkfifo(fifo)
    zero.symlink_to("/dev/zero")
    for path in (fifo, zero):
        with pytest.raises(InputError, match="a regular file was expected") as caught:
            KINDS[kind](path)
        assert len(caught.value.faults) == 1
