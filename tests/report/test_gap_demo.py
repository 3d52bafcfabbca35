"""A demonstration in words: what was planted beside what was named, right, wrong or one of several."""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from leactl.gap.blind.demonstration import Demonstration
from leactl.report.gap_demo import demonstration_json, demonstration_lines, files_of, page, verdict
from tests.report.answers import answer

FILES = files_of(Path("out"))
ALONE = replace(answer(), causes=(replace(answer().causes[0], indistinguishable_from=()),))


def demonstrated(planted, said=ALONE, **parameters):
    return Demonstration(said, planted, "plain", parameters or {"loss": 0.2, "exponent": 2.0})


@pytest.mark.parametrize(
    ("planted", "said", "outcome", "words"),
    [
        ("saturation", ALONE, "named", "Named: saturation, with a probability of 0.98, and nothing else."),
        ("saturation", answer(), "named with others", "which these runs cannot tell from torque_sensor_gain"),
        ("cogging", ALONE, "missed", "Missed: named was saturation."),
        ("cogging", replace(ALONE, causes=(), verdict="unknown"), "missed", "Missed: nothing was named."),
    ],
)
def test_the_planted_effect_stands_beside_what_was_named(planted, said, outcome, words):
    shown = demonstrated(planted, said)
    assert shown.outcome == outcome
    assert verdict(shown).startswith(f"Planted, at plain strength: {planted}. ")
    assert words in verdict(shown)
    assert demonstration_json(shown, 7, FILES)["outcome"] == outcome


def test_a_cause_beside_the_planted_one_is_said_not_to_be_there():
    both = replace(ALONE, causes=(ALONE.causes[0], replace(answer().causes[2], probability=0.7)))
    assert "named beside it, though not planted: cogging" in verdict(demonstrated("saturation", both))


def test_parameters_stand_as_planted_and_as_fitted():
    shown = demonstrated("saturation", loss=0.183)
    text = "\n".join(demonstration_lines(shown, 7, FILES))
    assert "loss       0.183" in text
    assert "over q-axis current, held-out runs: 0.413 N*m before, 0.00130 N*m after" in text
    assert "wrote out/gap.html" in text
    assert "leactl gap demo --seed 7" in text


def test_the_page_says_what_was_planted_and_the_document_is_json():
    shown = demonstrated("saturation")
    root = ElementTree.fromstring(page(shown, 7))
    headings = ["".join(h.itertext()) for h in root.iter("h2")]
    assert headings[:3] == ["Planted and named", "Causes", "What each effect explains"]
    document = json.loads(json.dumps(demonstration_json(shown, 7, FILES), allow_nan=False))
    assert document["planted"] == {
        "effect": "saturation",
        "strength": "plain",
        "parameters": {"loss": 0.2, "exponent": 2.0},
    }
    assert document["seed"] == 7
    assert document["answer"]["format"] == "leactl-gap"
