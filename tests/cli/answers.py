"""The page of JSON answers as JSON Schema.

`python -m tests.cli.answers` writes docs/reference/json-answers.schema.json from the tables of json-answers.md.
"""

import json
import re
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[2] / "docs" / "reference"
PAGE, SCHEMA = FOLDER / "json-answers.md", FOLDER / "json-answers.schema.json"
SECTION = re.compile(r"^## (.*?)\n\n    leactl (.*?)\n(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)
ROW = re.compile(r"^\| `(.*?)` \| (.*?) \| (.*) \|$", re.MULTILINE)
TYPES = {"text": "string", "number": "number", "true or false": "boolean", "mapping": "object", "list": "array"}
JsonSchema = dict[str, Any]


def sections() -> dict[str, tuple[str, list[tuple[str, str, str]]]]:
    """The command of each answer and the rows of its table: key, value, meaning."""
    text = PAGE.read_text(encoding="utf-8")
    return {title: (command, ROW.findall(body)) for title, command, body in SECTION.findall(text)}


def schema_of(rows: list[tuple[str, str, str]]) -> JsonSchema:
    """The JSON Schema of an answer."""
    whole: JsonSchema = {"type": "object"}
    for key, value, meaning in rows:
        described, last = whole, key.split(".")[-1]
        for part in key.split("."):
            owner = described.get("anyOf", [described])[0]
            described = _member(owner, part)
        described |= _kind(value) | {"description": meaning}
        if last != "*" and not value.endswith("optional"):
            owner.setdefault("required", []).append(last.removesuffix("[]"))
    return whole


def fits_the_page(title: str, answer: Any) -> None:
    """Raise AssertionError where an answer has keys or values that its table on the page does not."""
    from tests.cli.test_schema import misfits

    schema = schema_of(sections()[title][1])
    assert list(misfits(answer, schema, schema)) == []


def _member(owner: JsonSchema, part: str) -> JsonSchema:
    """The schema of a key of an object; of the items where it is a list."""
    owner.setdefault("type", "object")
    if part == "*":
        return owner.setdefault("additionalProperties", {})
    member: JsonSchema = owner.setdefault("properties", {}).setdefault(part.removesuffix("[]"), {})
    owner.setdefault("additionalProperties", False)
    if part.endswith("[]"):
        member["type"] = "array"
        return member.setdefault("items", {})
    return member


def _kind(value: str) -> JsonSchema:
    """What a table says of a value."""
    words = value.removesuffix(", optional").removeprefix("list of ")
    plain = words.removesuffix(" or null")
    if plain == "any":
        return {}
    kind = {"type": TYPES[plain]}
    return kind if plain == words else {"anyOf": [kind, {"type": "null"}]}


def written() -> str:
    """The file of schemas."""
    answers = {title: schema_of(rows) for title, (_, rows) in sections().items()}
    dialect = "https://json-schema.org/draft/2020-12/schema"
    return json.dumps({"$schema": dialect, "title": "Answers of leactl --json", "$defs": answers}, indent=2) + "\n"


if __name__ == "__main__":
    SCHEMA.write_text(written(), encoding="utf-8")
