"""The manual that comes with the program."""

import json
import re
from pathlib import Path

import leactl as package
from leactl.cli.docs import complete_page
from tests.cli.terminal import leactl
from tests.cli.test_help import COMMANDS

PAGES = Path(__file__).parents[2] / "docs"


def test_every_page_is_listed_with_its_title_and_printed_as_it_is():
    answer = json.loads(leactl("docs", "--json").stdout)
    assert answer["folder"] == str(PAGES)
    kinds = {page for page in PAGES.glob("*/*.md") if page.parent.name != "decisions"}
    assert set(answer["pages"]) == {page.parent.name if page.stem == "README" else page.stem for page in kinds}
    assert len(answer["pages"]) == len(kinds)
    assert all(answer["pages"].values())
    assert leactl("docs", "safety").stdout == (PAGES / "explanation" / "safety.md").read_text(encoding="utf-8")


def test_a_page_that_is_not_there_is_one_line_with_those_that_are():
    done = leactl("docs", "safty")
    assert done.returncode == 2
    assert done.stdout == ""
    [line] = done.stderr.splitlines()
    assert "'safty'" in line
    assert "safety" in line


def test_a_shell_offers_no_page_where_none_is_installed(monkeypatch, tmp_path):
    assert complete_page("safe") == ["safety"]
    monkeypatch.setattr(package, "__file__", str(tmp_path / "leactl" / "__init__.py"))
    monkeypatch.setattr("importlib.metadata.files", lambda _name: [])
    assert complete_page("safe") == []


def test_the_page_of_commands_has_each_with_its_first_sentence():
    page = (PAGES / "reference" / "commands.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(.*)` \| (.*) \|$", page, re.MULTILINE))
    assert rows == {" ".join(path): command.get_short_help_str(10_000) for path, command in COMMANDS.items()}


def test_the_readme_is_a_page_to_begin_with():
    readme = (PAGES.parent / "README.md").read_text(encoding="utf-8")
    assert len(readme.splitlines()) <= 80
    assert "pytest -n 2" in readme
    for target in re.findall(r"\]\(([^):#]+)\)", readme):
        assert (PAGES.parent / target).exists(), target


def test_every_link_of_a_page_leads_somewhere():
    for page in (*PAGES.rglob("*.md"), *PAGES.parent.glob("plugins/**/*.md"), *PAGES.parent.glob("*.md")):
        for target in re.findall(r"\]\((?!\w+://)([^)\s#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page}: {target}"


def test_the_site_has_every_page():
    index = (PAGES / "index.md").read_text(encoding="utf-8")
    for page in PAGES.glob("*/*.md"):
        name = f"{page.parent.name}/{page.stem}"
        assert name in index.splitlines() or f"{page.parent.name}/*" in index, name


def test_a_study_names_its_command_date_and_version():
    for page in PAGES.glob("evidence/*.md"):
        text = page.read_text(encoding="utf-8")
        provenance = r"^Command: .*`.*\. Date: \d{4}-\d\d-\d\d\. Version: leactl \d+\.\d+\.\d+, revision [0-9a-f]{7}\.$"
        assert page.stem == "README" or re.search(provenance, text, re.MULTILINE), page.name


def test_no_page_has_a_path_of_a_machine():
    for page in PAGES.rglob("*.md"):
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"(?<![\w.])/(home|root|work|Users)\b|\.\./shared", text), page.name
