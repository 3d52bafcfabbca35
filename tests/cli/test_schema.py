"""`leactl schema`: what ships fits it, and the pages of keys say what the code does."""

import json
import re
from importlib import resources
from pathlib import Path

import pytest

from leactl.cli.schema import Kind
from leactl.model.nominal import read_model
from leactl.protocol.signals import SIGNALS
from leactl.protocol.steps import KINDS as STEP_KINDS
from leactl.report.schema import KINDS, schema_of, tables_of
from leactl.yamlfile import load, parse
from tests.cli.terminal import leactl

DOCS = Path(__file__).parents[2] / "docs"
PAGES = {
    "protocol": DOCS / "reference" / "protocols.md",
    "bench": DOCS / "reference" / "bench-files.md",
    "motor": DOCS / "reference" / "motors.md",
    "model": DOCS / "reference" / "model-files.md",
    "campaign": DOCS / "reference" / "campaign-files.md",
    "mapping": DOCS / "reference" / "mapping-files.md",
}
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


def test_every_kind_has_a_page_of_keys():
    assert PAGES.keys() == KINDS.keys() == set(Kind)


def test_every_key_of_every_kind_has_a_meaning():
    for kind in KINDS:
        whole = schema_of(kind)
        for name, block in {"": whole, **whole["$defs"]}.items():
            assert name == "Step" or all(value["description"] for value in block.get("properties", {}).values())


def test_every_meaning_is_of_some_key():
    described = {
        value.get("description")  # none of a kind of step, whose own block says what it is
        for kind in KINDS
        for block in (schema_of(kind), *schema_of(kind)["$defs"].values())
        for value in block.get("properties", {}).values()
    }
    for file in sorted((resources.files("leactl.report") / "key_meanings").iterdir()):
        assert set(parse(file.read_text()).data.values()) <= described, file.name


def test_an_interlock_says_what_trips_it():
    blocks = schema_of("bench")["$defs"]
    for name, rate in (("InAmperes", "rate_A_per_s"), ("InNewtonMetres", "rate_Nm_per_s")):
        assert "reading changes faster" in blocks[name]["properties"][rate]["description"]
    assert "less space" in blocks["DiskSpace"]["properties"]["trip_MB"]["description"]
    assert "hotter" in blocks["InDegrees"]["properties"]["trip_degC"]["description"]


def test_a_model_file_fits_its_schema(tmp_path):
    whole = schema_of("model")
    for text in (leactl("bench", "model", "emulated").stdout, example(PAGES["model"])):
        assert list(misfits(parse(text).data, whole, whole)) == []
        (tmp_path / "model.yaml").write_text(text)
        assert read_model(tmp_path / "model.yaml")
    assert list(misfits({"name": "a", "bench": {"bus_volt": 3}}, whole, whole))


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_of_keys_is_what_the_command_prints(kind):
    mark = f"<!-- leactl schema {kind} --table -->\n"
    _head, mark_as_written, tables = PAGES[kind].read_text().partition(mark)
    assert mark_as_written
    assert tables == tables_of(kind)
    assert leactl("schema", kind, "--table").stdout == tables


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


def protocols_of_the_page():
    """The whole protocols of the page by name, and the trajectory that one of them reads."""
    text = PAGES["protocol"].read_text()
    protocols = re.findall(r"```yaml\n(name: .*?)```", text, re.DOTALL)
    [trajectory] = re.findall(r"```text\n(time_s.*?)```", text, re.DOTALL)
    return {re.match(r"name: (\S+)", protocol)[1]: protocol for protocol in protocols}, trajectory


def test_every_step_and_every_signal_has_an_example():
    protocols, _ = protocols_of_the_page()
    kinds, signals = set(), set()

    def look_at(steps):
        for step in steps:
            [(kind, body)] = step.items()
            kinds.add(kind)
            if kind == "signal":
                signals.add(body["kind"])
            look_at(body.get("steps", ()) if isinstance(body, dict) else ())

    for protocol in protocols.values():
        look_at(parse(protocol).data["steps"])
    assert kinds == {*STEP_KINDS, "signal"}
    assert signals == set(SIGNALS)


@pytest.mark.parametrize("name", protocols_of_the_page()[0])
def test_an_example_of_the_page_is_checked_and_planned(tmp_path, name):
    protocols, trajectory = protocols_of_the_page()
    path = tmp_path / f"{name}.yaml"
    path.write_text(protocols[name])
    (tmp_path / "swing.csv").write_text(trajectory)
    assert list(misfits(parse(protocols[name]).data, schema_of("protocol"), schema_of("protocol"))) == []
    checked = leactl("protocol", "check", path)
    assert (checked.returncode, checked.stderr) == (0, "")
    assert checked.stdout.endswith("no faults\n")
    bench = "emulated-heated" if "setup: heated" in protocols[name] else "emulated"
    planned = leactl("protocol", "plan", path, "--bench", bench)
    assert planned.returncode == 0
    assert all(line.startswith("note: ") for line in planned.stderr.splitlines())
