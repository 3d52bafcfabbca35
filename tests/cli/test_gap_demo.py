"""`leactl gap demo`: an effect planted, diagnosed without the key, and compared with it."""

import json
import resource

import pytest

from leactl.emulation.blind.key import read_key
from leactl.emulation.blind.make import make
from leactl.gap.blind.demonstration import demonstrate
from tests.cli.terminal import interpreted, leactl


def test_an_effect_that_is_not_known_plants_nothing(tmp_path):
    done = leactl("gap", "demo", "--effect", "gremlin", "--out", tmp_path / "demo")
    assert done.returncode == 2
    assert "effect 'gremlin' is not known; known: ambient_drift, " in done.stderr
    assert not (tmp_path / "demo").exists()


@pytest.mark.long
def test_the_demonstration_names_what_it_planted_within_half_a_minute(tmp_path):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = interpreted("gap", "demo", "--seed", "1", "--out", tmp_path / "demo", "--json")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.returncode == 0, done.stderr
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 60  # of two cores
    answer = json.loads(done.stdout)
    assert answer["outcome"] == "named"
    assert answer["answer"]["causes"][0]["effect"] == answer["planted"]["effect"]
    assert answer["answer"] == json.loads((tmp_path / "demo" / "answer.json").read_text(encoding="utf-8"))
    page = (tmp_path / "demo" / "gap.html").read_text(encoding="utf-8")
    assert "Planted and named" in page
    again = leactl("gap", "demo", "--seed", "1", "--out", tmp_path / "demo")
    assert again.returncode == 2
    assert "is not empty; choose a new folder" in again.stderr


@pytest.mark.long
def test_the_answer_stands_before_the_key_is_opened(tmp_path):
    make(1, tmp_path / "bench", tmp_path / "key", 3, ("single",), ("stribeck",), ("strong",))
    hidden = (tmp_path / "key").rename(tmp_path / "elsewhere")
    answered = tmp_path / "answer.json"

    def open_key():
        assert json.loads(answered.read_text(encoding="utf-8"))["format"] == "leactl-gap"
        return read_key(hidden, tmp_path / "bench")

    shown = demonstrate(tmp_path / "bench", answered, open_key, lambda _: None)
    assert shown.planted == "stribeck"
    assert shown.outcome == "named"
    assert shown.parameters["breakaway_ratio"] == pytest.approx(
        next(p.value for p in shown.cause.parameters if p.name == "breakaway_ratio"), rel=0.3
    )
