"""HTML without a template: every text is escaped unless it was built here, and a page is well-formed XML too."""

import re
from base64 import b64encode
from hashlib import sha256
from html import escape

VOID = frozenset({"meta", "br", "path", "line"})
# what neither XML 1.0 nor UTF-8 can carry: control characters, and the halves that stand for bytes of a file's name
UNFIT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


class Html(str):
    """Text that is markup already."""

    __slots__ = ()


def escaped(words: str) -> Html:
    """Words made safe, for a body or for an attribute."""
    return words if isinstance(words, Html) else Html(escape(without_control_characters(words), quote=True))


def without_control_characters(words: str) -> str:
    """Words without what a page or a terminal cannot take."""
    return UNFIT.sub("\ufffd", words)


def tag(name: str, *children: str, **attributes: str) -> Html:
    """One element; an attribute's trailing underscore is dropped and others become hyphens."""
    attribute_text = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escaped(value)}"' for key, value in attributes.items()
    )
    if name in VOID:
        return Html(f"<{name}{attribute_text}/>")
    return Html(f"<{name}{attribute_text}>{''.join(escaped(child) for child in children)}</{name}>")


def joined(parts: list[Html], by: str = "") -> Html:
    """Elements one after the other."""
    return Html(escaped(by).join(parts))


def table(headings: list[str], rows: list[list[str]], class_: str = "") -> Html:
    """A table that scrolls sideways by itself where the page is too narrow; the first cell of a row is its heading."""
    head = tag("thead", tag("tr", *(tag("th", heading, scope="col") for heading in headings)))
    body = tag(
        "tbody",
        *(tag("tr", tag("th", row[0], scope="row"), *(tag("td", cell) for cell in row[1:])) for row in rows),
    )
    return tag("div", tag("table", head, body, class_=class_), class_="scroll", tabindex="0")


def document(title: str, style: str, body: Html, script: str = "") -> str:
    """A whole page that asks nothing of any network; the one script that may run in it is named by its hash."""
    policy = "default-src 'none'; style-src 'unsafe-inline'"
    scripts = []
    if script:
        digest = b64encode(sha256(script.encode()).digest()).decode()
        policy += f"; script-src 'sha256-{digest}'"
        scripts = [tag("script", Html(script))]
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name_="viewport", content="width=device-width, initial-scale=1"),
        tag("title", title),
        tag("style", Html(style)),
    )
    return f"<!DOCTYPE html>\n{tag('html', head, tag('body', body, *scripts), lang='en')}\n"
