"""Pages from the templates beside this module: every text is escaped, and a page loads nothing."""

import re
from base64 import b64encode
from collections.abc import Sequence
from functools import cache
from hashlib import sha256
from importlib import resources
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # a terminal takes a function from here and needs no templates
    from jinja2 import Environment

# what neither XML 1.0 nor UTF-8 can carry: control characters, and the halves that stand for bytes of a file's name
UNFIT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


def without_control_characters(words: str) -> str:
    """Replace the characters that neither a page nor a terminal can take by U+FFFD."""
    return UNFIT.sub("\ufffd", words)


def render(template: str, scripts: Sequence[str] = (), **content: Any) -> str:
    """Return the page of a template; it runs these scripts of this room, as one, and no other."""
    from markupsafe import Markup

    room = resources.files("leactl.report")
    script = "\n".join((room / name).read_text(encoding="utf-8") for name in scripts)
    digest = b64encode(sha256(script.encode()).digest()).decode()
    return environment().get_template(template).render(script=Markup(script), script_digest=digest, **content)


@cache
def environment() -> "Environment":
    """Return what fills templates: all text is escaped, and a name that was not given is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    def printable(value: object) -> str:
        return value if isinstance(value, Markup) else without_control_characters(str(value))

    return Environment(
        loader=PackageLoader("leactl.report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=printable,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def code_parts(words: str) -> list[str]:
    """Split a text at its backquotes: every second part is code; a backquote without its other end is text."""
    parts = words.split("`")
    return parts if len(parts) % 2 else [words]
