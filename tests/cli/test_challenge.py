"""`leactl safety challenge` as a shell sees it."""

import json

import pytest

from tests.cli.terminal import leactl


def test_a_short_search_is_pure_json_with_its_progress_beside_it():
    done = leactl("safety", "challenge", "--minutes", "0.001", "--rate", "20", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["held"] is True
    assert [search["angle"] for search in answer["searches"]] == ["true", "noisy", "stuck", "lost", "drifting"]
    assert all(search["hottest"]["peak_degC"] <= answer["limit_degC"] for search in answer["searches"])
    assert "search 5 of 5: test, 20 Hz, drifting angle" in done.stderr


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (("--rate", "5"), "--rate 5: 10 to 10000 Hz were expected"),
        (("--minutes", "0"), "--minutes 0: more than 0 and at most 10000 were expected"),
        (("nowhere.yaml",), "nowhere.yaml"),
    ],
)
def test_a_wrong_option_is_one_line(wrong, said):
    done = leactl("safety", "challenge", *wrong)
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1
