"""Bench files: devices on buses in roles, their limits, and what an emulated bench is made of."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from leactl import yamlfile
from leactl.driver import registry
from leactl.driver.contract import DriverSettings
from leactl.errors import InputError
from leactl.safety.limits import Limits

STRICT = ConfigDict(frozen=True, extra="forbid")
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]
Fraction = Annotated[float, Field(ge=0, allow_inf_nan=False)]
SHIPPED = Path(__file__).parent / "files"


class CanBus(BaseModel):
    """A CAN bus by python-can's own words; an emulated bench answers in its place."""

    model_config = STRICT
    kind: Literal["can"]
    interface: str = "socketcan"
    channel: str | int = "can0"
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] = 1_000_000
    options: dict[str, Any] = {}


class I2cBus(BaseModel):
    """An I2C bus by its number, /dev/i2c-N."""

    model_config = STRICT
    kind: Literal["i2c"]
    number: Annotated[int, Field(ge=0, le=255)] = 1


class Device(BaseModel):
    """One device: its driver, the bus it hangs on, its role, and the driver's own settings."""

    model_config = STRICT
    driver: str
    bus: Name | None = None
    role: Literal["test", "load", "bench"]
    settings: dict[str, Any] = {}


class Emulated(BaseModel):
    """What an emulated bench is made of; a bench file without this block is a real bench."""

    model_config = STRICT
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    test: dict[str, Any] = {}  # parameters over the motor's own
    load: dict[str, Any] = {}
    bench: dict[str, Any] = {}
    conditions: dict[str, dict[str, Any]] = {}  # label: parameters of both actuators under it
    effects: list[dict[str, Any]] = []
    current_noise_A: Fraction = 0.015  # noqa: N815 (a unit keeps its letter)
    torque_noise_Nm: Fraction = 0.004  # noqa: N815
    velocity_noise_rad_s: Fraction = 0.002


class BenchFile(BaseModel):
    """A whole bench."""

    model_config = STRICT
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=60)]
    title: str = ""
    setup: Literal["free", "locked", "coupled", "heated"] | None = None  # none: whatever the protocol asks for
    motors: dict[Literal["test", "load"], str]
    buses: dict[Name, Annotated[CanBus | I2cBus, Field(discriminator="kind")]]
    devices: Annotated[dict[Name, Device], Field(min_length=1)]
    limits: Limits
    emulated: Emulated | None = None

    @model_validator(mode="after")
    def _one_drive_a_role(self) -> "BenchFile":
        if "test" not in self.motors:
            raise ValueError("motors.test is required: it tells the supervisor what the winding endures")
        return self


class CheckedDevice(BaseModel):
    """A device whose settings its own driver has accepted."""

    model_config = ConfigDict(frozen=True, arbitrary_types_allowed=True)
    name: str
    entry: Device
    settings: DriverSettings


def names() -> list[str]:
    """Names of the bench files that ship with leactl."""
    return sorted(path.stem for path in SHIPPED.glob("*.yaml"))


def load(name_or_path: str) -> tuple[BenchFile, list[CheckedDevice], yamlfile.Document]:
    """Read and check a bench, by its shipped name or from a file.

    Raises
    ------
    InputError : no such bench, or faults in it, all at once with file, line and column.
    """
    path = SHIPPED / f"{name_or_path}.yaml" if name_or_path in names() else Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"bench '{name_or_path}' is not known; known: {', '.join(names())}, or a path to a .yaml")
    document = yamlfile.load(path)
    bench = document.validate(BenchFile)
    faults: list[str] = []
    checked = [_check(document, bench, name, entry, faults) for name, entry in bench.devices.items()]
    if faults:
        raise InputError(faults)
    return bench, [device for device in checked if device is not None], document


def put_elsewhere(bench: BenchFile, words: Sequence[str]) -> dict[str, CanBus]:
    """CAN buses as `NAME=INTERFACE:CHANNEL` puts them, for one process or one run.

    Raises
    ------
    InputError : not of this form, or no CAN bus of the bench.
    """
    changed: dict[str, CanBus] = {}
    for word in words:
        name, _, place = word.partition("=")
        interface, _, channel = place.partition(":")
        bus = bench.buses.get(name)
        if not isinstance(bus, CanBus) or not interface:
            known = ", ".join(key for key, value in bench.buses.items() if isinstance(value, CanBus)) or "none"
            raise InputError(
                f"--bus {word}: NAME=INTERFACE:CHANNEL was expected, with a CAN bus of the bench ({known})"
            )
        changed[name] = bus.model_copy(update={"interface": interface, "channel": channel})
    return changed


def _check(
    document: yamlfile.Document, bench: BenchFile, name: str, entry: Device, faults: list[str]
) -> CheckedDevice | None:
    place: tuple[str | int, ...] = ("devices", name)
    try:
        driver = registry.load(entry.driver)
    except InputError as error:
        faults.append(document.fault((*place, "driver"), str(error)))
        return None
    bus = bench.buses.get(entry.bus) if entry.bus else None
    if driver.transport != "none" and (bus is None or bus.kind != driver.transport):
        found = "no bus" if entry.bus is None else f"'{entry.bus}'"
        choices = [key for key, value in bench.buses.items() if value.kind == driver.transport]
        expected = ", ".join(choices) or f"a bus of kind {driver.transport} under buses"
        faults.append(document.fault((*place, "bus"), f"{found}: {entry.driver} needs {expected}"))
    try:
        settings = driver.Settings.model_validate(entry.settings)
    except ValidationError as error:
        faults.extend(document.explain(error, (*place, "settings")))
        return None
    return CheckedDevice(name=name, entry=entry, settings=settings)
