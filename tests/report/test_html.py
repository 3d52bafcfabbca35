"""Text on a page: what it says stays, whatever it is made of, and what a page lacks is an error."""

import re
import subprocess
import sys
from html import unescape

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jinja2 import UndefinedError

from leactl.report.html import code_parts, environment

WORDS = st.text(st.characters(exclude_categories=("Cc", "Cs"), exclude_characters="`\ufffe\uffff"))
CODE = """{% from "parts.html" import with_code %}{{ with_code(words) }}"""


def filled(template, **content):
    return environment().from_string(template).render(**content)


@given(st.lists(WORDS, min_size=1, max_size=7))
def test_what_stands_between_backquotes_is_code_and_all_else_is_escaped(parts):
    page = filled(CODE, words=code_parts("`".join(parts)))
    whole = len(parts) % 2 == 1
    assert unescape(re.sub(r"</?code>", "", page)) == ("" if whole else "`").join(parts)
    assert [unescape(code) for code in re.findall(r"<code>(.*?)</code>", page, re.DOTALL)] == parts[1::2] * whole


@pytest.mark.parametrize("template", ["{{ words }}", "{% for word in [words] %}{{ word }}{% endfor %}"])
@pytest.mark.parametrize(
    ("words", "shown"),
    [('<b a="\'">&', "&lt;b a=&#34;&#39;&#34;&gt;&amp;"), ("\x00\x9f\ud800\n\ufffe", "\ufffd\ufffd\ufffd\n\ufffd")],
)
def test_a_text_is_escaped_and_cannot_hold_what_no_page_can(template, words, shown):
    assert filled(template, words=words) == shown


@pytest.mark.parametrize("template", ["{{ nothing }}", "{{ words.nothing }}", "{% if nothing %}{% endif %}"])
def test_a_name_that_was_not_given_is_an_error(template):
    with pytest.raises(UndefinedError, match="nothing"):
        filled(template, words={})


def test_a_terminal_needs_no_templates():
    rooms = ["gap_text", "gap_demo", "run_progress", "notebook", "run_page", "run_plot", "datasheet.page", "web.feed"]
    told = f"import sys, leactl.report.{', leactl.report.'.join(rooms)}; print('jinja2' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", told], check=True, capture_output=True, text=True).stdout == "False\n"
