"""Every shipped protocol on the shipped bench that it fits, without any effect, against the bench's own model."""

import json

import pytest

from leactl.protocol.protocolfile import load
from leactl.protocol.shipped import names
from tests.cli.terminal import leactl

OFTEN = ("back-emf",)  # what an ordinary run tries


def diagnosed(protocol, here):
    """The answer on two runs that differ by their noise alone."""
    bench = "emulated-heated" if load(protocol).setup == "heated" else "emulated"
    runs = []
    for seed in (11, 12):
        chosen = ("--bench", bench, "--set", f"seed={seed}", "--out", here, "--json")
        done = leactl("run", protocol, *chosen, LEACTL_STATE=str(here / "state"))
        assert done.returncode == 0, done.stderr
        runs.append(json.loads(done.stdout)["run"])
    model = here / "nominal.yaml"
    model.write_text(leactl("bench", "model", bench).stdout)
    done = leactl("gap", "diagnose", runs[0], "--held-out", runs[1], "--model", model, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("protocol", OFTEN)
def test_nothing_is_missing_where_nothing_is(protocol, tmp_path):
    nothing_is_named(diagnosed(protocol, tmp_path))


@pytest.mark.long
@pytest.mark.parametrize("protocol", names())
def test_no_shipped_protocol_shows_an_effect_that_is_not_there(protocol, tmp_path):
    nothing_is_named(diagnosed(protocol, tmp_path))


def nothing_is_named(found):
    assert found["verdict"] in ("none", "calibration"), found["notes"]
    assert all(cause["probability"] < 0.5 for cause in found["causes"])
    for line in found["calibration"]:
        assert line["fitted"] == pytest.approx(line["nominal"], rel=0.05, abs=4.0 * line["std"]), line["parameter"]
