"""Sessions of the pages show what the program says."""

from pathlib import Path

import pytest

from tests.cli.sessions import BLOCK, commands, masked, typed, write_files

ROOT = Path(__file__).parents[2]
PAGES = (
    "README.md",
    "docs/tutorial/first-protocol.md",
)
ELSEWHERE = "demo"  # the demonstrations take a minute: tests/cli/test_demo.py and test_gap_demo.py have them


@pytest.mark.parametrize("page", PAGES)
def test_every_line_shows_what_the_page_says(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / page).read_text(encoding="utf-8")
    write_files(text, tmp_path)
    lines = [line for block in BLOCK.findall(text) for line in commands(block)]
    assert len(lines) >= 3
    for line, shown in lines:
        if ELSEWHERE not in line:
            assert masked(typed(line, tmp_path)) == masked(shown), line
