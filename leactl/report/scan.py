"""What a scan of wires tells: a line for each device, JSON, and the buses and devices of a bench file."""

from collections.abc import Iterator, Sequence
from typing import Any

import yaml

from leactl.bench.benchfile import Bus, CanBus, I2cBus, LineBus
from leactl.bench.scan import Answered, WireReport, how, settings_left_open
from leactl.driver import registry
from leactl.driver.probe import CanProbe, Probe
from leactl.report.terminal import list_line
from leactl.runner.scan import ScannedWire

FILL_IN = "FILL_IN"
ROLES = "test, load or bench"
BOUNDS = {"minimum": "at least", "exclusiveMinimum": "more than", "maximum": "at most"}
Scanned = Sequence[tuple[ScannedWire, WireReport]]


def lines(scanned: Scanned) -> Iterator[str]:
    """A line for each device, and for each thing that is notable about a wire."""
    for wire, report in scanned:
        for each in report.answered:
            head = f"{wire.shown:<12} {_place(wire, each):<11} {_driver(each) or '-':<12} "
            yield list_line(head, "; ".join(_told(each)))
        for note in report.notes:
            yield list_line(f"{wire.shown}: ", note)
        if report.asked and report.complete and not (report.answered or isinstance(wire.buses[0], LineBus)):
            yield f"{wire.shown}: nothing answered"
        if not (report.complete or report.fault):
            yield f"{wire.shown}: not asked to the end"


def answer(scanned: Scanned) -> dict[str, Any]:
    """The same for `--json`."""
    names = _names(scanned)
    wires = [
        {
            "wire": wire.shown,
            "bus": wire.name,
            "kind": wire.buses[0].kind,
            "asked": report.asked,
            "complete": report.complete,
            "notes": report.notes,
            "fault": report.fault or None,
        }
        for wire, report in scanned
    ]
    devices = [
        {
            "wire": wire.shown,
            "address": each.sighting.address,
            "driver": _driver(each) or None,
            "name": names.get(id(each)),
            "model": each.sighting.identity.model,
            "serial": each.sighting.identity.serial,
            "firmware": each.sighting.identity.firmware,
            "detail": each.sighting.detail,
            "settings": dict(each.sighting.settings or {}),
            "left_open": _left_open(each),
        }
        for wire, report in scanned
        for each in report.answered
    ]
    return {"wires": wires, "devices": devices, "bench_file": bench_file_part(scanned)}


def bench_file_part(scanned: Scanned) -> str:
    """The blocks `buses` and `devices` of a bench file, where FILL_IN stands for what no scan can know; or empty."""
    names, buses, devices = _names(scanned), [], []
    for wire, report in scanned:
        usable = [each for each in report.answered if _driver(each)]
        if usable:
            buses.append(f"  {wire.name}: {_flow(_as_written(wire, usable))}\n")
        devices += [_device(names[id(each)], wire, each) for each in usable]
    if not devices:
        return ""
    head = f"# what answered a scan; {FILL_IN}: what it cannot know\n"
    return f"{head}buses:\n{''.join(buses)}devices:\n{''.join(devices)}"


def _device(name: str, wire: ScannedWire, each: Answered) -> str:
    told = "; ".join(_told(each)[:-1])
    driver = registry.load(each.driver)
    schema, told_by = driver.Settings.model_json_schema()["properties"], f"; leactl driver info {each.driver}"
    text = f"  {name}:  # {told}\n    driver: {each.driver}\n    bus: {wire.name}\n    role: {FILL_IN}  # {ROLES}\n"
    settings = [f"      {_flow({key: value})[1:-1]}\n" for key, value in (each.sighting.settings or {}).items()]
    settings += [
        f"      {key}: {FILL_IN}  # {_expected(schema[key], driver.example.get(key))}{told_by}\n"
        for key in settings_left_open(driver, each.sighting)
    ]
    return f"{text}    settings:\n{''.join(settings)}" if settings else text


def _expected(field: dict[str, Any], example: Any) -> str:
    """What a setting takes, in words; of a list an example."""
    field = next((each for each in field.get("anyOf", ()) if each.get("type") != "null"), field)
    if "enum" in field:
        return " or ".join(map(str, field["enum"]))
    if field.get("type") == "array" and example:
        return f"such as {_flow(list(example))}"
    return ", ".join(
        (str(field.get("type", "")), *(f"{word} {field[key]}" for key, word in BOUNDS.items() if key in field))
    )


def _as_written(wire: ScannedWire, answered: Sequence[Answered]) -> dict[str, Any]:
    """A bus as a bench file has it; a line as it was open when its device answered."""
    bus: Bus | LineBus = answered[0].line or wire.buses[0]
    written = bus.model_dump(exclude_defaults=isinstance(bus, CanBus))
    if isinstance(bus, CanBus):
        if not any(isinstance(probe, CanProbe) and probe.fd for probe in _probes_of(answered)):
            written.pop("options", None)  # which the interface could have, and none of these devices needs
        return {"kind": "can", "interface": bus.interface, "channel": bus.channel} | written
    kept = ("kind", "number", "port", "baudrate", "resource")
    return {key: value for key, value in written.items() if key in kept}


def _probes_of(answered: Sequence[Answered]) -> list[Probe | None]:
    return [registry.load(each.driver).probe for each in answered]


def _flow(value: dict[str, Any] | list[Any]) -> str:
    return str(yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=1000)).strip()


def _names(scanned: Scanned) -> dict[int, str]:
    """A name for each device that a driver is for, by its identity as an object."""
    names: dict[int, str] = {}
    for _wire, report in scanned:
        for each in report.answered:
            if _driver(each):
                address = "" if each.sighting.address is None else f"_{each.sighting.address}"
                taken = sum(name.startswith(f"{each.driver}{address}") for name in names.values())
                names[id(each)] = f"{each.driver}{address}{f'_{chr(97 + taken)}' if taken else ''}"
    return names


def _driver(each: Answered) -> str:
    """The driver that a device is for; empty if there is none."""
    return each.driver if each.sighting.settings is not None else ""


def _left_open(each: Answered) -> list[str]:
    if not _driver(each):
        return []
    return ["role", *settings_left_open(registry.load(each.driver), each.sighting)]


def _place(wire: ScannedWire, each: Answered) -> str:
    if each.line is not None:
        return how(each.line)
    address = each.sighting.address or 0
    return f"0x{address:02X}" if isinstance(wire.buses[0], I2cBus) else f"node {address}"


def _told(each: Answered) -> list[str]:
    """What a device said of itself, and what it is in a bench file."""
    identity, settings = each.sighting.identity, each.sighting.settings
    parts = [
        identity.model or "does not say what it is",
        f"firmware {identity.firmware}" if identity.firmware else "",
        f"serial number {identity.serial}" if identity.serial else "",
        each.sighting.detail,
    ]
    if settings is not None:
        given = [f"{key}: {value}" for key, value in settings.items()]
        given += [f"{key}: {FILL_IN}" for key in _left_open(each)]
        parts.append(f"in a bench file {', '.join(given)}")
    else:
        parts.append("no driver here is for it")
    return [_on_a_line(part) for part in parts if part]


def _on_a_line(text: str) -> str:
    """A device's text without line feeds, which would end a comment of YAML, and other controls."""
    return text if text.isprintable() else ascii(text)[1:-1]
