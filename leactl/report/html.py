"""HTML without a template: every text is escaped unless it was built here, and a page is well-formed XML too."""

import re
from base64 import b64encode
from hashlib import sha256
from html import escape
from importlib import resources

VOID = frozenset({"meta", "br", "path", "line"})
# what neither XML 1.0 nor UTF-8 can carry: control characters, and the halves that stand for bytes of a file's name
UNFIT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


class Html(str):
    """Text that is HTML already and is not escaped again."""

    __slots__ = ()


def escaped(words: str) -> Html:
    """Escape a text for a body or an attribute; HTML stays as it is."""
    return words if isinstance(words, Html) else Html(escape(without_control_characters(words), quote=True))


def without_control_characters(words: str) -> str:
    """Replace the characters that neither a page nor a terminal can take by U+FFFD."""
    return UNFIT.sub("\ufffd", words)


def tag(name: str, *children: str, **attributes: str) -> Html:
    """Return one element; an attribute's trailing underscore is dropped and other underscores become hyphens."""
    attribute_text = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escaped(value)}"' for key, value in attributes.items()
    )
    if name in VOID:
        return Html(f"<{name}{attribute_text}/>")
    return Html(f"<{name}{attribute_text}>{''.join(escaped(child) for child in children)}</{name}>")


def with_code(words: str) -> Html:
    """Return a text, its parts between backquotes as code."""
    parts = words.split("`")
    if len(parts) % 2 == 0:  # one without its other end
        return escaped(words)
    return joined([tag("code", part) if place % 2 else escaped(part) for place, part in enumerate(parts)])


def joined(parts: list[Html], by: str = "") -> Html:
    """Return elements one after the other, with `by` between them."""
    return Html(escaped(by).join(parts))


def table(headings: list[str], rows: list[list[str]], class_: str = "") -> Html:
    """Return a table that scrolls sideways where the page is too narrow; the first cell of a row is its heading."""
    head = tag("thead", tag("tr", *(tag("th", heading, scope="col") for heading in headings)))
    body = tag(
        "tbody",
        *(tag("tr", tag("th", row[0], scope="row"), *(tag("td", cell) for cell in row[1:])) for row in rows),
    )
    return tag("div", tag("table", head, body, class_=class_), class_="scroll", tabindex="0")


def scripts(*names: str) -> str:
    """Return scripts of this room as one, in this order."""
    room = resources.files("leactl.report")
    return "\n".join((room / name).read_text(encoding="utf-8") for name in names)


def document(title: str, style: str, body: Html, script: str = "", asks_its_server: bool = False) -> str:
    """Return a whole page that loads nothing; its policy allows the given script alone, by its hash.

    `asks_its_server` lets that script send requests to the server that the page is from.
    """
    policy = "default-src 'none'; style-src 'unsafe-inline'"
    policy += "; connect-src 'self'" if asks_its_server else ""
    elements = []
    if script:
        digest = b64encode(sha256(script.encode()).digest()).decode()
        policy += f"; script-src 'sha256-{digest}'"
        elements = [tag("script", Html(script))]
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name_="viewport", content="width=device-width, initial-scale=1"),
        tag("title", title),
        tag("style", Html(style)),
    )
    return f"<!DOCTYPE html>\n{tag('html', head, tag('body', body, *elements), lang='en')}\n"
