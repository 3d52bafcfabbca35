"""The manual that comes with the program."""

import json
from pathlib import Path

from tests.cli.terminal import leactl

PAGES = Path(__file__).parents[2] / "docs"


def test_every_page_is_listed_with_its_title_and_printed_as_it_is():
    told = json.loads(leactl("docs", "--json").stdout)
    assert told["folder"] == str(PAGES)
    kinds = {page for page in PAGES.glob("*/*.md") if page.parent.name != "decisions"}
    assert set(told["pages"]) == {page.parent.name if page.stem == "README" else page.stem for page in kinds}
    assert len(told["pages"]) == len(kinds)
    assert all(told["pages"].values())
    assert leactl("docs", "safety").stdout == (PAGES / "explanation" / "safety.md").read_text(encoding="utf-8")


def test_a_page_that_is_not_there_is_one_line_with_those_that_are():
    done = leactl("docs", "safty")
    assert done.returncode == 2
    assert done.stdout == ""
    [line] = done.stderr.splitlines()
    assert "'safty'" in line
    assert "safety" in line
