"""`leactl schema`: what ships fits it, and the pages of keys say what the code does."""

import json
import re
from importlib import resources
from pathlib import Path

import pytest

from leactl.cli.schema import Kind
from leactl.report.schema import TABLES, schema_of, tables_of
from leactl.yamlfile import load, parse
from tests.cli.terminal import leactl

DOCS = Path(__file__).parents[2] / "docs"
PAGES = {"protocol": DOCS / "reference" / "protocols.md", "bench": DOCS / "reference" / "bench-files.md"}
FILES = {
    "protocol": sorted(Path(str(resources.files("leactl_protocols"))).glob("*.yaml")),
    "bench": sorted((Path(str(resources.files("leactl.bench"))) / "files").glob("*.yaml")),
    "motor": sorted((Path(str(resources.files("leactl.model"))) / "motors").glob("*.yaml")),
    "campaign": sorted(Path(str(resources.files("leactl_protocols.campaigns"))).glob("*.yaml")),
}
TYPES = {"string": str, "array": list, "object": dict, "boolean": bool, "null": type(None), "integer": int}


def misfits(value, schema, whole, place="$"):
    """Why a value does not fit, as far as keys, kinds and choices go."""
    if "$ref" in schema:
        schema = whole["$defs"][schema["$ref"].rpartition("/")[2]] | {k: v for k, v in schema.items() if k != "$ref"}
    choices = schema.get("anyOf") or schema.get("oneOf")
    if choices:
        every = [list(misfits(value, choice, whole, place)) for choice in choices]
        yield from min(every, key=len)
        return
    kind = schema.get("type")
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind and not (number if kind == "number" else isinstance(value, TYPES[kind])):
        yield f"{place}: {value!r} is no {kind}"
    elif value not in schema.get("enum", [value]) or value != schema.get("const", value):
        yield f"{place}: {value!r} is no choice"
    elif isinstance(value, str) and not re.search(schema.get("pattern", ""), value):
        yield f"{place}: {value!r} is of another form"
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from misfits(item, schema.get("items") or {}, whole, f"{place}[{number}]")
    elif isinstance(value, dict):
        known = schema.get("properties", {})
        yield from (f"{place}: {key} is missing" for key in schema.get("required", ()) if key not in value)
        for key, item in value.items():
            further = schema.get("additionalProperties", True)
            if key in known:
                yield from misfits(item, known[key], whole, f"{place}.{key}")
            elif further is False:
                yield f"{place}: {key} is unknown"
            elif isinstance(further, dict):
                yield from misfits(item, further, whole, f"{place}.{key}")


@pytest.mark.parametrize(("kind", "path"), [(kind, path) for kind, paths in FILES.items() for path in paths])
def test_what_ships_fits_the_schema(kind, path):
    whole = schema_of(kind)
    assert list(misfits(load(path).data, whole, whole)) == []


def test_what_a_protocol_may_not_say_does_not_fit():
    whole = schema_of("protocol")
    good = parse("name: a\nsetup: free\nrate_Hz: 1\nsteps: [{hold: {duration_s: $t}}, {supply: {test: off}}]").data
    assert list(misfits(good, whole, whole)) == []
    for key in ("holt: {duration_s: 1}", "hold: {duration_ms: 1}", "mode: {test: curent}", "signal: {kind: cirp}"):
        bad = good | {"steps": [parse(key).data]}
        assert list(misfits(bad, whole, whole)), key


@pytest.mark.parametrize("kind", list(Kind))
def test_every_kind_is_printed(kind):
    assert leactl("schema", kind).stdout == json.dumps(schema_of(kind), indent=2) + "\n"


def test_a_kind_without_tables_says_which_have_them():
    done = leactl("schema", "motor", "--table")
    assert (done.returncode, done.stdout) == (2, "")
    assert "one of protocol, bench was expected" in done.stderr


@pytest.mark.parametrize("kind", TABLES)
def test_the_page_of_keys_is_what_the_command_prints(kind):
    mark = f"<!-- leactl schema {kind} --table -->\n"
    _head, found, tables = PAGES[kind].read_text().partition(mark)
    assert found
    assert tables == tables_of(kind)


def example(page):
    return page.read_text().partition("```yaml\n")[2].partition("```")[0]


def test_the_examples_of_both_pages_run_as_they_are_printed(tmp_path):
    for kind, name in (("protocol", "staircase.yaml"), ("bench", "one-drive.yaml")):
        (tmp_path / name).write_text(example(PAGES[kind]))
    protocol, bench = tmp_path / "staircase.yaml", tmp_path / "one-drive.yaml"
    assert leactl("protocol", "check", protocol).stdout == "staircase: 11 actions, 0:00:09, no faults\n"
    assert leactl("bench", "check", bench).returncode == 0
    done = leactl("run", protocol, "--bench", bench, "--out", tmp_path, "--json", LEACTL_STATE=str(tmp_path / "state"))
    assert (done.returncode, done.stderr) == (0, "")
    assert [limit["met"] for limit in json.loads(done.stdout)["acceptance"]] == [True, True, True]
    more = "--set", "levels_A=[2, 9]"  # 9 A give 4.4 N*m
    done = leactl("run", protocol, "--bench", bench, "--out", tmp_path, *more, LEACTL_STATE=str(tmp_path / "state"))
    assert done.returncode == 6
    assert "leactl: acceptance: max of test torque in step hold is 4." in done.stderr
    assert leactl("protocol", "plan", protocol, "--bench", "emulated").returncode == 0
    words = "--bench", "emulated", "--condition", "unloaded", "--set", "hold_s=2", "--out", tmp_path
    assert leactl("run", protocol, *words, LEACTL_STATE=str(tmp_path / "state")).returncode == 0
