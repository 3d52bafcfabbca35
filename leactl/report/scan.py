"""Results of a scan of wires as text, as JSON, and as the blocks `buses` and `devices` of a bench file."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import yaml

from leactl.bench.benchfile import Bus, CanBus, I2cBus, LineBus
from leactl.bench.scan import Answered, WireReport, rate_or_port, settings_left_open
from leactl.driver import registry
from leactl.driver.probe import CanProbe, Probe
from leactl.report.terminal import list_line
from leactl.runner.scan import ScannedWire

FILL_IN = "FILL_IN"  # stands for a value that a scan cannot find
ROLE_HINT = "test, load or bench"
# by key of a JSON schema
BOUND_PHRASES = {"minimum": "at least", "exclusiveMinimum": "more than", "maximum": "at most"}
ScanResults = Sequence[tuple[ScannedWire, WireReport]]


def lines(scanned: ScanResults) -> Iterator[str]:
    """Yield a line for each device that answered, each note, and each wire that is silent or not scanned to its end."""
    for wire, report in scanned:
        for device in report.answered:
            head = f"{wire.shown:<12} {_address(wire, device):<11} {_driver_name(device) or '-':<12} "
            yield list_line(head, "; ".join(_description(device)))
        for note in report.notes:
            yield list_line(f"{wire.shown}: ", note)
        if report.asked and report.complete and not (report.answered or isinstance(wire.buses[0], LineBus)):
            yield f"{wire.shown}: nothing answered"
        if not (report.complete or report.fault):
            yield f"{wire.shown}: the scan was stopped before its end"


def as_json(scanned: ScanResults) -> dict[str, Any]:
    """Return the results of a scan as `--json` prints them."""
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
            "address": device.sighting.address,
            "driver": _driver_name(device) or None,
            "name": names.get(id(device)),
            "model": device.sighting.identity.model,
            "serial": device.sighting.identity.serial,
            "firmware": device.sighting.identity.firmware,
            "detail": device.sighting.detail,
            "settings": dict(device.sighting.settings or {}),
            "left_open": _missing_settings(device),
        }
        for wire, report in scanned
        for device in report.answered
    ]
    return {"wires": wires, "devices": devices, "bench_file": bench_file_part(scanned)}


def bench_file_part(scanned: ScanResults) -> str:
    """Return the blocks `buses` and `devices` of a bench file; empty if no device has a driver.

    FILL_IN stands for values that a scan cannot find.
    """
    names, buses, devices = _names(scanned), [], []
    for wire, report in scanned:
        with_driver = [device for device in report.answered if _driver_name(device)]
        if with_driver:
            buses.append(f"  {wire.name}: {_flow_style(_bus_settings(wire, with_driver))}\n")
        devices += [_device_block(names[id(device)], wire, device) for device in with_driver]
    if not devices:
        return ""
    head = f"# devices that answered a scan; replace each {FILL_IN} by its value, which a scan cannot know\n"
    return f"{head}buses:\n{''.join(buses)}devices:\n{''.join(devices)}"


def _device_block(name: str, wire: ScannedWire, device: Answered) -> str:
    """Return the block of one device in a bench file."""
    description = "; ".join(_description(device)[:-1])
    driver = registry.load(device.driver)
    schema, hint = driver.Settings.model_json_schema()["properties"], f"; leactl driver info {device.driver}"
    head = f"  {name}:  # {description}\n    driver: {device.driver}\n    bus: {wire.name}\n"
    text = f"{head}    role: {FILL_IN}  # {ROLE_HINT}\n"
    settings = [f"      {_flow_style({key: value})[1:-1]}\n" for key, value in (device.sighting.settings or {}).items()]
    settings += [
        f"      {key}: {FILL_IN}  # {_expected(schema[key], driver.example.get(key))}{hint}\n"
        for key in settings_left_open(driver, device.sighting)
    ]
    return f"{text}    settings:\n{''.join(settings)}" if settings else text


def _expected(field: dict[str, Any], example: Any) -> str:
    """Return a text on the values that a setting takes according to its JSON schema; for a list, an example."""
    schema = next((option for option in field.get("anyOf", ()) if option.get("type") != "null"), field)
    if "enum" in schema:
        return " or ".join(map(str, schema["enum"]))
    if schema.get("type") == "array" and example:
        return f"such as {_flow_style(list(example))}"
    phrases = [f"{phrase} {schema[key]}" for key, phrase in BOUND_PHRASES.items() if key in schema]
    return ", ".join((str(schema.get("type", "")), *phrases))


def _bus_settings(wire: ScannedWire, answered: Sequence[Answered]) -> dict[str, Any]:
    """Return the settings of a bus for a bench file; for a serial line, the settings at which the device answered."""
    bus: Bus | LineBus = answered[0].line or wire.buses[0]
    settings = bus.model_dump(exclude_defaults=isinstance(bus, CanBus))
    if isinstance(bus, CanBus):
        if not any(isinstance(probe, CanProbe) and probe.fd for probe in _probes_of(answered)):
            settings.pop("options", None)  # the scan may open the interface with options that no device here needs
        return {"kind": "can", "interface": bus.interface, "channel": bus.channel} | settings
    keys = ("kind", "number", "port", "baudrate", "resource")
    return {key: value for key, value in settings.items() if key in keys}


def _probes_of(answered: Sequence[Answered]) -> list[Probe | None]:
    """Return the probe of the driver of each device."""
    return [registry.load(device.driver).probe for device in answered]


def _flow_style(value: dict[str, Any] | list[Any]) -> str:
    """Return a value as YAML on one line."""
    return str(yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=1000)).strip()


def _names(scanned: ScanResults) -> dict[int, str]:
    """Return unique names of the devices with a driver, by the `id` of the `Answered`."""
    names: dict[int, str] = {}
    namesakes: Counter[str] = Counter()  # number of devices so far with the same driver and address
    for _wire, report in scanned:
        for device in report.answered:
            if _driver_name(device):
                address = "" if device.sighting.address is None else f"_{device.sighting.address}"
                name = f"{device.driver}{address}"
                names[id(device)] = f"{name}_{chr(ord('a') + namesakes[name])}" if namesakes[name] else name
                namesakes[name] += 1
    return names


def _driver_name(device: Answered) -> str:
    """Return the name of the driver of a device; empty if there is none."""
    return device.driver if device.sighting.settings is not None else ""


def _missing_settings(device: Answered) -> list[str]:
    """Return the keys of a device in a bench file whose values a scan cannot find."""
    if not _driver_name(device):
        return []
    return ["role", *settings_left_open(registry.load(device.driver), device.sighting)]


def _address(wire: ScannedWire, device: Answered) -> str:
    """Return the address of a device on its bus; on a serial line, the settings at which it answered."""
    if device.line is not None:
        return rate_or_port(device.line)
    address = device.sighting.address or 0
    return f"0x{address:02X}" if isinstance(wire.buses[0], I2cBus) else f"node {address}"


def _description(device: Answered) -> list[str]:
    """Return texts on the identity of a device.

    The last text lists its settings for a bench file, or says that no installed driver is for it.
    """
    identity, settings = device.sighting.identity, device.sighting.settings
    texts = [
        identity.model or "does not say what it is",
        f"firmware {identity.firmware}" if identity.firmware else "",
        f"serial number {identity.serial}" if identity.serial else "",
        device.sighting.detail,
    ]
    if settings is not None:
        entries = [f"{key}: {value}" for key, value in settings.items()]
        entries += [f"{key}: {FILL_IN}" for key in _missing_settings(device)]
        texts.append(f"in a bench file {', '.join(entries)}")
    else:
        texts.append("no installed driver is for it")
    return [_printable(text) for text in texts if text]


def _printable(text: str) -> str:
    """Return a device's text with control characters escaped; a line feed would end a comment of YAML."""
    return text if text.isprintable() else ascii(text)[1:-1]
