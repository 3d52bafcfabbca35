"""Every separating protocol runs on the emulated bench within its limits; shortened, for nothing but time is saved."""

import json

import pytest

from leactl.protocol import protocolfile, shipped
from leactl.runfile.read.reader import Run
from tests.cli.terminal import leactl

SHORTER = {
    "separate-angle": ("hold_s=1",),
    "separate-by-grid": ("hold_s=0.4",),
    "separate-drive-timing": ("repeats=1",),
    "separate-heat": ("part_s=5",),
    "separate-sensor-timing": ("hold_s=0.2", "chirp_s=5"),
    "separate-slow-friction": ("hold_s=0.6",),
}


def test_every_separating_protocol_is_tried():
    assert {name for name in shipped.names() if protocolfile.load(name).separates} == set(SHORTER)


SLOW = "separate-slow-friction"  # ten seconds


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long) if name == SLOW else name for name in SHORTER]
)
def test_it_runs_to_its_end(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    settings = [item for setting in SHORTER[name] for item in ("--set", setting)]
    done = leactl("run", name, *settings, "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["status"] == "complete"
    with Run.open(tmp_path / answer["run"]) as run:
        assert run.mechanical == protocolfile.load(name).setup
        assert run.attributes["protocol"] == name
