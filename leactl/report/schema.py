"""The keys of each kind of YAML file from its pydantic model: as JSON Schema for editors, as tables for the manual."""

from collections.abc import Callable, Iterator
from functools import cache
from importlib import resources
from typing import Any

from leactl import yamlfile

JsonSchema = dict[str, Any]
DIALECT = "https://json-schema.org/draft/2020-12/schema"
REFERENCE = {"type": "string", "pattern": "^\\$[a-z][A-Za-z0-9_]*$", "description": "a parameter of the protocol"}
# unit by the ending of the name of a key; the first ending that matches applies
UNITS = {
    "A_per_s": "A/s",
    "V_per_s": "V/s",
    "Nm_per_s": "N*m/s",
    "degC_per_s": "K/s",
    "rad_per_s": "rad/s",
    "rad_s_per_s": "rad/s^2",
    "rad_s2": "rad/s^2",
    "rad_s": "rad/s",
    "A_s": "A/s",
    "rad": "rad",
    "degC": "degC",
    "Nm": "N*m",
    "Hz": "Hz",
    "kg": "kg",
    "MB": "MB",
    "A": "A",
    "V": "V",
    "K": "K",
    "m": "m",
    "s": "s",
}
STEP = "Step"  # name of the block of all kinds of steps
SHOWN_INTERLOCK = "InAmperes"
# blocks of interlocks that differ from SHOWN_INTERLOCK in the unit alone; the tables leave them out
SIMILAR_INTERLOCKS = ("InVolts", "InRadians", "InRadiansPerSecond", "InNewtonMetres", "InDegrees")


def _protocol() -> JsonSchema:
    """Return the schema of a protocol: its head, the kinds of steps and signals; values may refer to parameters."""
    from leactl.protocol.schema import Head
    from leactl.protocol.signals import SIGNALS
    from leactl.protocol.steps import KINDS

    schema = Head.model_json_schema()
    blocks: JsonSchema = schema.setdefault("$defs", {})
    steps: dict[str, JsonSchema] = {}
    for kind, adapter in KINDS.items():
        steps[kind] = _reference_to_block(adapter.json_schema(), blocks)
    signals = [_reference_to_block(adapter.json_schema(), blocks) for adapter in SIGNALS.values()]
    steps["signal"] = {"oneOf": signals}
    blocks[STEP] = {
        "description": "One step: a mapping of one key.",
        "type": "object",
        "minProperties": 1,
        "maxProperties": 1,
        "additionalProperties": False,
        "properties": steps,
    }
    for block in (blocks["RepeatStep"], blocks["WhenStep"], schema):
        block["properties"]["steps"] |= {"items": {"$ref": "#/$defs/Step"}}
    schema["properties"]["parameters"] = {"type": "object"}
    schema["properties"]["conditions"] = {"type": "object", "additionalProperties": {"type": "object"}}
    for role in ("test", "load"):
        blocks["SupplyStep"]["properties"][role]["anyOf"].append({"const": "off"})
    for name, block in blocks.items():
        if name != STEP and "properties" in block:
            properties = block.get("properties", {})
            block["properties"] = {
                key: value if key == "kind" else _with_reference(value) for key, value in properties.items()
            }
    return schema


def _with_reference(value: JsonSchema) -> JsonSchema:
    """Return a schema that accepts a reference to a parameter in place of the value, or of an item of a list."""
    for choice in (value, *value.get("anyOf", ())):
        if "items" in choice:
            choice["items"] = {"anyOf": [choice["items"], REFERENCE]}
    return {"anyOf": [value, REFERENCE]} | ({"default": value["default"]} if "default" in value else {})


def _reference_to_block(block: JsonSchema, blocks: JsonSchema) -> JsonSchema:
    """Add the schema of a model, and the schemas that it refers to, to the blocks; return a reference to it.

    A schema without properties is not added but returned.
    """
    blocks.update(block.pop("$defs", {}))
    if "properties" not in block:
        return block
    blocks[block["title"]] = block
    return {"$ref": f"#/$defs/{block['title']}"}


def _bench() -> JsonSchema:
    """Return the schema of a bench file."""
    from leactl.bench.benchfile import BenchFile

    return BenchFile.model_json_schema()


def _motor() -> JsonSchema:
    """Return the schema of a motor file."""
    from leactl.model.motor_schema import MotorSheet

    return MotorSheet.model_json_schema()


def _campaign() -> JsonSchema:
    """Return the schema of a campaign file."""
    from leactl.runner.campaign.campaignfile import CampaignFile

    return CampaignFile.model_json_schema()


def _model() -> JsonSchema:
    """Return the schema of a model file."""
    from leactl.model.nominal import Model

    return Model.model_json_schema()


def _mapping() -> JsonSchema:
    """Return the schema of a mapping of foreign columns to channels."""
    from leactl.runfile.importing.mapping import Mapping

    return Mapping.model_json_schema()


# by kind of file: function that returns its schema, and name of its file in key_meanings/
KINDS: dict[str, tuple[Callable[[], JsonSchema], str]] = {
    "protocol": (_protocol, "protocol_bench"),
    "bench": (_bench, "protocol_bench"),
    "motor": (_motor, "motor_model"),
    "model": (_model, "motor_model"),
    "campaign": (_campaign, "campaign"),
    "mapping": (_mapping, "mapping"),
}


def schema_of(kind: str) -> JsonSchema:
    """Return the JSON Schema of a kind of file, each key with its meaning.

    Raises
    ------
    KeyError : a key has no meaning in key_meanings/.
    """
    make_schema, meanings_file = KINDS[kind]
    schema = _with_choices(make_schema())
    for name, block in _blocks(schema):
        if name == STEP:  # its keys are the kinds of steps, which their blocks describe
            continue
        for key, value in block.get("properties", {}).items():
            value["description"] = _meaning(meanings_file, name, key)
            value.pop("title", None)
    return {"$schema": DIALECT, **schema}


def tables_of(kind: str) -> str:
    """Return a Markdown table for each block of a kind of file: key, unit, accepted values, default, meaning."""
    schema = schema_of(kind)
    lines: list[str] = []
    for name, block in _blocks(schema):
        if name in (*SIMILAR_INTERLOCKS, STEP) or "properties" not in block:
            continue
        lines += ["", f"### {name}", "", " ".join(block.get("description", "").split()), ""]
        lines += ["| key | unit | accepted | default | meaning |", "|---|---|---|---|---|"]
        for key, value in block["properties"].items():
            is_required = key in block.get("required", ())
            default = "required" if is_required else _default(value)
            unit = next((unit for suffix, unit in UNITS.items() if key.endswith(f"_{suffix}")), "")
            accepted = _accepted(value).replace("|", "\\|")
            lines.append(f"| `{key}` | {unit} | {accepted} | {default} | {value['description']} |")
    return "\n".join(lines).strip() + "\n"


def _with_choices(schema: JsonSchema) -> JsonSchema:
    """Return the schema with each reference to an enumeration replaced by its choices."""
    choices = {name: block for name, block in schema.get("$defs", {}).items() if "enum" in block}

    def without_enumerations(node: Any) -> Any:
        if isinstance(node, list):
            return [without_enumerations(item) for item in node]
        if not isinstance(node, dict):
            return node
        block_name = str(node.get("$ref", "")).rpartition("/")[2]
        if block_name in choices:
            return {"type": "string", "enum": choices[block_name]["enum"]}
        return {
            key: without_enumerations(value)
            for key, value in node.items()
            if not (key in choices and value in choices.values())
        }

    without_references: JsonSchema = without_enumerations(schema)
    return without_references


def _blocks(schema: JsonSchema) -> Iterator[tuple[str, JsonSchema]]:
    """Yield title and schema of the file, then name and schema of each block."""
    yield schema["title"], schema
    yield from schema.get("$defs", {}).items()


@cache
def _meanings(file: str) -> dict[str, str]:
    """Return the meanings of keys in a file of key_meanings/, by key or `Block.key`."""
    entry = resources.files("leactl.report") / "key_meanings" / f"{file}.yaml"
    meanings: dict[str, str] = yamlfile.parse(entry.read_text(encoding="utf-8"), entry.name).data
    return meanings


def _meaning(file: str, block: str, key: str) -> str:
    """Return the meaning of a key in a block: that of `Block.key`, else that of the key, each with or without its unit.

    Raises
    ------
    KeyError : the key has no meaning.
    """
    key_without_unit = next((key.removesuffix(f"_{suffix}") for suffix in UNITS if key.endswith(f"_{suffix}")), key)
    meanings = _meanings(file)
    interlock_name = (
        f"{SHOWN_INTERLOCK}.{key_without_unit}" if block in SIMILAR_INTERLOCKS else f"{block}.{key_without_unit}"
    )
    for name in (f"{block}.{key}", f"{block}.{key_without_unit}", interlock_name, key, key_without_unit):
        if name in meanings:
            return meanings[name]
    raise KeyError(f"{block}.{key}: no meaning in key_meanings/{file}.yaml")


def _default(value: JsonSchema) -> str:
    """Return the default of a key as Markdown code; empty if it has none, or one that is empty or a mapping."""
    default = value.get("default")
    if default in (None, "", [], {}) or isinstance(default, dict):
        return ""
    return f"`{str(default).lower() if isinstance(default, bool) else default}`"


def _accepted(value: JsonSchema) -> str:
    """Return a short text on the values that a key accepts."""
    choices = value.get("anyOf") or value.get("oneOf")
    if choices:
        alternatives = [_accepted(choice) for choice in choices if choice.get("type") != "null" and choice != REFERENCE]
        return " or ".join(dict.fromkeys(alternatives))
    if "$ref" in value:
        return value["$ref"].rpartition("/")[2]  # type: ignore[no-any-return]
    if "enum" in value or "const" in value:
        return ", ".join(f"`{choice}`" for choice in value.get("enum", [value.get("const")]))
    json_type = value.get("type")
    if json_type == "array":
        items = value.get("items") or {}
        return f"list of {_accepted(items)}" if items else "list"
    if json_type in ("number", "integer"):
        limits = (
            ("minimum", "from"),
            ("exclusiveMinimum", "above"),
            ("maximum", "to"),
            ("exclusiveMaximum", "below"),
        )
        bounds = [f"{relation} {value[limit]:.10g}" for limit, relation in limits if limit in value]
        return " ".join(["whole number" if json_type == "integer" else "number", *bounds])
    return {"string": "text", "boolean": "`true`, `false`", "object": "mapping"}.get(str(json_type), "any")
