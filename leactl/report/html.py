"""Fill the templates of pages; every text is escaped, and a page loads nothing from other files."""

import re
from base64 import b64encode
from collections.abc import Sequence
from functools import cache
from hashlib import sha256
from importlib import resources
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # output to a terminal uses this module too, without jinja2
    from jinja2 import Environment

# not in XML 1.0: most control characters, surrogates, which stand for undecodable bytes of a file name, and U+FFFE and
# U+FFFF; XML has U+007F to U+009F, but a terminal obeys them
CONTROL_CHARACTERS = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


def without_control_characters(text: str) -> str:
    """Return a text with U+FFFD in place of the characters that neither a page nor a terminal can take."""
    return CONTROL_CHARACTERS.sub("\ufffd", text)


def render(template: str, scripts: Sequence[str] = (), **content: Any) -> str:
    """Return the page that a template makes of its variables; the page can run `scripts` and no other script.

    Parameters
    ----------
    scripts : files in this folder, which are joined to one script.
    content : variables of the template.
    """
    from markupsafe import Markup

    folder = resources.files("leactl.report")
    script = "\n".join((folder / name).read_text(encoding="utf-8") for name in scripts)
    digest = b64encode(sha256(script.encode()).digest()).decode()
    return environment().get_template(template).render(script=Markup(script), script_digest=digest, **content)


@cache
def environment() -> "Environment":
    """Return the Jinja environment: it escapes all text, and a variable without a value is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    def cleaned_text(value: object) -> str:
        return value if isinstance(value, Markup) else without_control_characters(str(value))

    return Environment(
        loader=PackageLoader("leactl.report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=cleaned_text,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def code_parts(text: str) -> list[str]:
    """Split a text at its backquotes; every second part is code. With an odd number of backquotes, it is not split."""
    parts = text.split("`")
    return parts if len(parts) % 2 else [text]
