"""Text on a page: what it says stays, whatever it is made of."""

import re
from html import unescape

from hypothesis import given
from hypothesis import strategies as st

from leactl.report.html import with_code

WORDS = st.text(st.characters(exclude_categories=("Cc", "Cs"), exclude_characters="`\ufffe\uffff"))


@given(st.lists(WORDS, min_size=1, max_size=7))
def test_what_stands_between_backquotes_is_code_and_all_else_is_escaped(parts):
    page = with_code("`".join(parts))
    whole = len(parts) % 2 == 1
    assert unescape(re.sub(r"</?code>", "", page)) == ("" if whole else "`").join(parts)
    assert [unescape(code) for code in re.findall(r"<code>(.*?)</code>", page, re.DOTALL)] == parts[1::2] * whole
