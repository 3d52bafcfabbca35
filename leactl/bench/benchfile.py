"""Read and check bench files: devices on buses in roles, their limits, and the parameters of an emulated bench."""

import os
import re
from collections.abc import Collection, Mapping, Sequence
from ipaddress import AddressValueError, IPv4Address
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from leactl import yamlfile
from leactl.driver import registry
from leactl.driver.contract import SAFE_STATE_S, DriverSettings
from leactl.driver.file_records import RecordSettings
from leactl.errors import InputError
from leactl.model.motor import load_motor, motor_names
from leactl.model.nominal import BenchModel
from leactl.quantities import UNITS
from leactl.runfile.instruments import Instrument
from leactl.safety.interlocks import Interlocks
from leactl.safety.limits import Limits
from leactl.yamlblock import Block

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]
NonNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
SHIPPED = Path(__file__).parent / "files"


RETURNS_OWN = ("udp_multicast", "gs_usb", "cantact")  # interfaces of python-can that return the frames they send


class CanBus(Block):
    """A CAN bus, with python-can's names of settings; an emulated bench replaces it."""

    kind: Literal["can"]
    interface: str = "socketcan"
    channel: str | int = "can0"
    bitrate: Annotated[int, Field(strict=True, ge=10_000, le=1_000_000)] = 1_000_000
    options: dict[str, Any] = {}

    @property
    def returns_own(self) -> bool:
        """Whether a port may receive the frames that it sends, by the nature of the bus or as an adapter's echo."""
        return self.interface in RETURNS_OWN or bool(self.options.get("receive_own_messages", False))


class I2cBus(Block):
    """An I2C bus by its number, /dev/i2c-N."""

    kind: Literal["i2c"]
    number: Annotated[int, Field(strict=True, ge=0, le=255)] = 1


class SerialBus(Block):
    """A serial line to one device; an emulated bench replaces it."""

    kind: Literal["serial"]
    port: Annotated[str, Field(min_length=1)] = "/dev/ttyUSB0"
    baudrate: Annotated[int, Field(strict=True, ge=300, le=4_000_000)] = 9600
    data_bits: Literal[7, 8] = 8
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    flow_control: Literal["none", "rtscts", "xonxoff"] = "none"

    @property
    def byte_s(self) -> float:
        """Duration of one byte on the line [s], including start, parity and stop bits."""
        return (1 + self.data_bits + (self.parity != "none") + self.stop_bits) / self.baudrate


SOCKET_RESOURCE = re.compile(r"TCPIP\d{0,4}::([^:]*)::(\d{1,5})::SOCKET", re.IGNORECASE | re.ASCII)


def _socket_address(resource: str) -> tuple[str, int]:
    """Return the IPv4 address and the port of a VISA resource name.

    Raises
    ------
    ValueError : the name is not that of a raw socket, or no instrument can have its address or port.
    """
    match = SOCKET_RESOURCE.fullmatch(resource)
    if match is None:
        raise ValueError(
            "not the name of a raw socket; TCPIP::ADDRESS::PORT::SOCKET was expected, with the instrument's IPv4"
            " address and port, mostly 5025 or 5555"
        )
    try:
        host = IPv4Address(match[1])
    except AddressValueError:
        raise ValueError(
            f"{match[1]!r} is not an IPv4 address; one was expected, because to look up a name may take longer than"
            " a safe state has"
        ) from None
    if host.is_unspecified or host.is_multicast or host.is_reserved:
        raise ValueError(f"{host} is not the address of one instrument")
    port = int(match[2])
    if not 1 <= port <= 65535:
        raise ValueError(f"port {port}; 1 to 65535 was expected")
    return str(host), port


def _socket_resource(resource: str) -> str:
    """Return a VISA resource name unchanged if it is that of a raw socket; see `_socket_address`."""
    _socket_address(resource)
    return resource


class VisaBus(Block):
    """The raw socket of one instrument on the network; an emulated bench replaces it."""

    kind: Literal["visa"]
    resource: Annotated[str, AfterValidator(_socket_resource)]
    byte_s: ClassVar[float] = 8e-8  # duration of one byte on the line [s], 100 Mbit/s

    @property
    def address(self) -> tuple[str, int]:
        """IPv4 address and port of the instrument."""
        return _socket_address(self.resource)


LineBus = SerialBus | VisaBus
Bus = CanBus | I2cBus | LineBus


class Device(Instrument):
    """One device: its driver, bus, role and settings, and facts about the instrument."""

    driver: str
    bus: Name | None = None
    role: Literal["test", "load", "bench"]
    settings: dict[str, Any] = {}
    on_demand: bool = False  # opened only by protocols that need or want a quantity that it measures


class Harmonic(Block):
    """A harmonic of the emulated back-EMF of a phase; line-to-line voltages of a wye lack multiples of three."""

    order: Annotated[int, Field(strict=True, ge=2, le=100)]
    share: Annotated[float, Field(strict=True, ge=0, le=1)]  # of the fundamental
    phase_rad: Annotated[float, Field(strict=True, ge=-10, le=10)] = 0.0


class Emulated(Block):
    """Parameters of an emulated bench; a bench file without this block is a real bench."""

    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = 1
    motors: dict[Literal["test", "load"], str] = {}  # of the emulated actuators, where the bench's are not theirs
    test: dict[str, Any] = {}  # parameters that replace those of the motor
    load: dict[str, Any] = {}
    bench: dict[str, Any] = {}
    conditions: dict[str, dict[str, Any]] = {}  # label: parameters of both actuators, which override `test` and `load`
    effects: list[dict[str, Any]] = []
    faults: list[dict[str, Any]] = []  # what goes wrong and when (leactl.emulation.faults)
    current_noise_A: NonNegative = 0.015  # noqa: N815 (a unit keeps its letter)
    torque_noise_Nm: NonNegative = 0.004  # noqa: N815
    velocity_noise_rad_s: NonNegative = 0.002
    terminal_noise_V: NonNegative = 0.005  # noqa: N815 (between two leads, as a converter there picks it up)
    back_emf_harmonics: tuple[Harmonic, ...] = ()  # of each actuator
    temperature_noise_K: NonNegative = 0.05  # noqa: N815
    temperature_offset_K: Annotated[float, Field(strict=True, ge=-20, le=20)] = 0.0  # noqa: N815 (of every sensor's zero point)
    # reading over true value, of the rise above ambient
    temperature_gain: Annotated[float, Field(strict=True, ge=0.5, le=2)] = 1.0

    def expect(self, condition: str) -> None:
        """Raise InputError for an unknown condition, if the block defines conditions.

        Raises
        ------
        InputError : the condition is unknown; the message lists the known ones.
        """
        if condition and self.conditions and condition not in self.conditions:
            known = ", ".join(self.conditions)
            raise InputError(f"condition '{condition}' is not one of the emulated bench's: {known}")


class BenchFile(Block):
    """The keys of a bench file."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=60)]
    title: str = ""
    setup: Literal["free", "locked", "coupled", "heated"] | None = None  # None: any set-up that the protocol asks for
    motors: dict[Literal["test", "load"], str]
    buses: dict[Name, Annotated[Bus, Field(discriminator="kind")]]
    devices: Annotated[dict[Name, Device], Field(min_length=1)]
    limits: Limits
    interlocks: Interlocks = Interlocks()
    response: BenchModel = BenchModel()  # known properties of supply, sensors and loops
    emulated: Emulated | None = None

    @model_validator(mode="after")
    def _needs_the_test_motor(self) -> "BenchFile":
        if "test" not in self.motors:
            raise ValueError("motors.test is required: it tells the supervisor what the winding endures")
        return self


class CheckedDevice(BaseModel):
    """A device whose settings its driver has accepted."""

    model_config = ConfigDict(frozen=True, arbitrary_types_allowed=True)
    name: str
    entry: Device
    settings: DriverSettings


def names() -> list[str]:
    """Return the names of the bench files that ship with leactl."""
    return sorted(path.stem for path in SHIPPED.glob("*.yaml"))


def shipped_file(name: str) -> yamlfile.Document:
    """Return a bench file that ships with leactl, unchecked."""
    return yamlfile.load(SHIPPED / f"{name}.yaml")


def load(name_or_path: str) -> tuple[BenchFile, list[CheckedDevice], yamlfile.Document]:
    """Read and check a bench, by its shipped name or from a file.

    Raises
    ------
    InputError : no such bench, or all its faults with file, line and column.
    """
    path = SHIPPED / f"{name_or_path}.yaml" if name_or_path in names() else Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"bench '{name_or_path}' is not known; known: {', '.join(names())}, or a path to a .yaml")
    document = yamlfile.load(path)
    faults: list[str] = []
    try:
        bench = document.validate(BenchFile)
    except InputError as error:
        raise InputError([*error.faults, *_unusable_drivers(document)]) from None
    checked = [_check(document, bench, name, entry, faults) for name, entry in bench.devices.items()]
    usable = [device for device in checked if device is not None]
    faults += _shared_wires(document, bench)
    faults += _shared_addresses(document, bench.buses, usable)
    faults += _shared_identifiers(document, usable)
    faults += _shared_host_addresses(document, usable)
    faults += _shared_folders(document, usable)
    faults += _shared_roles(document, usable)
    faults += [document.fault(("interlocks", *keys), text) for keys, text in bench.interlocks.beyond(bench.limits)]
    if faults:
        raise InputError(faults)
    return _with_motor_paths(bench, path.parent), usable, document


def _with_motor_paths(bench: BenchFile, folder: Path) -> BenchFile:
    """Return the bench with the relative paths of its motor files taken from the folder of the bench file.

    From the working directory they could lead to the file of another motor, and the guard would protect that one.
    """

    def located(motors: Mapping[Literal["test", "load"], str]) -> dict[Literal["test", "load"], str]:
        return {role: name if name in motor_names() else str(folder / name) for role, name in motors.items()}

    emulated = bench.emulated
    if emulated is not None:
        emulated = emulated.model_copy(update={"motors": located(emulated.motors)})
    return bench.model_copy(update={"motors": located(bench.motors), "emulated": emulated})


def devices_of_run(devices: Sequence[CheckedDevice], quantities: Collection[str]) -> list[CheckedDevice]:
    """Return the devices of a run.

    Parameters
    ----------
    quantities : a device that is `on_demand` takes part only if it measures one of them.
    """
    return [
        device
        for device in devices
        if not device.entry.on_demand or any(measured.quantity in quantities for measured in device.settings.shown())
    ]


def check_devices(bench: BenchFile) -> list[CheckedDevice]:
    """Return the devices of a bench that `load` has already checked, possibly in another process."""
    return [
        CheckedDevice(name=name, entry=entry, settings=registry.load(entry.driver).Settings(**entry.settings))
        for name, entry in bench.devices.items()
    ]


def nominal_model(bench: BenchFile) -> str:
    """Return the text of a model file for a bench: the file of the test motor, with `response` as block `bench`."""
    properties = bench.response.model_dump(exclude_none=True)
    block = "".join(f"  {name}: {value!r}\n" for name, value in properties.items())
    motor = load_motor(bench.motors["test"])[1].text.rstrip("\n")
    return f"{motor}\nbench:\n{block}" if block else f"{motor}\n"


def host_silences(devices: Sequence[CheckedDevice]) -> dict[str, float | None]:
    """Return for how long each device runs on without the host's heartbeat [s], by name; None if it monitors none."""
    return {device.name: device.settings.host_silence_s for device in devices}


def supplies_of(devices: Sequence[CheckedDevice]) -> list[str]:
    """Return the names of the power supplies among some devices."""
    return [device.name for device in devices if hasattr(registry.load(device.entry.driver), "switch_on")]


def changed_buses(bench: BenchFile, words: Sequence[str]) -> dict[str, CanBus | LineBus]:
    """Return the buses that words change, by name, with their new interface, channel, port or resource.

    Parameters
    ----------
    words : each `NAME=INTERFACE:CHANNEL` (CAN), `NAME=serial:PORT` or `NAME=visa:RESOURCE`.

    Raises
    ------
    InputError : a word has another form, or names no such bus of the bench.
    """
    new_buses: dict[str, CanBus | LineBus] = {}
    for word in words:
        name, _, target = word.partition("=")
        interface, _, channel = target.partition(":")
        bus = bench.buses.get(name)
        if isinstance(bus, SerialBus) and interface == "serial" and channel:
            new_buses[name] = bus.model_copy(update={"port": channel})
            continue
        if isinstance(bus, VisaBus) and interface == "visa":
            try:
                _socket_address(channel)
            except ValueError as error:
                raise InputError(f"--bus {word}: {error}") from None
            new_buses[name] = bus.model_copy(update={"resource": channel})
            continue
        if not isinstance(bus, CanBus) or not interface:
            changeable = ", ".join(key for key, value in bench.buses.items() if not isinstance(value, I2cBus)) or "none"
            raise InputError(
                f"--bus {word}: NAME=INTERFACE:CHANNEL was expected, with a CAN bus of the bench, NAME=visa:RESOURCE,"
                f" with a raw socket of it, or NAME=serial:PORT, with a serial line of it ({changeable})"
            )
        new_buses[name] = bus.model_copy(update={"interface": interface, "channel": channel})
    return new_buses


def _unusable_drivers(document: yamlfile.Document) -> list[str]:
    """Return one line for each driver that cannot be loaded, so that a file with other faults reports these too."""
    devices = document.data.get("devices") if isinstance(document.data, dict) else None
    faults = []
    for name, entry in devices.items() if isinstance(devices, dict) else ():
        driver = entry.get("driver") if isinstance(entry, dict) else None
        if isinstance(driver, str):
            try:
                registry.load(driver)
            except InputError as error:
                faults.append(document.fault(("devices", name, "driver"), str(error)))
    return faults


def _shared_wires(document: yamlfile.Document, bench: BenchFile) -> list[str]:
    """Return one line for each CAN bus or serial line that another name of the bench leads to as well.

    Addresses and identifiers are compared bus by bus: under two names, two devices could obey one command.
    """
    if bench.emulated is not None:  # each has a wire of its own there
        return []
    names: dict[tuple[str, str], str] = {}
    faults = []
    for name, bus in bench.buses.items():
        if isinstance(bus, CanBus):
            wire = bus.interface, f"{bus.channel}{sorted(bus.options.items())}"
        elif isinstance(bus, SerialBus) and bus.port:
            wire = bus.kind, os.path.realpath(bus.port)
        else:
            continue
        if (first_name := names.setdefault(wire, name)) != name:
            faults.append(document.fault(("buses", name), f"leads where {first_name} does; one name was expected"))
    return faults


def _shared_addresses(
    document: yamlfile.Document, buses: Mapping[str, Bus], devices: Sequence[CheckedDevice]
) -> list[str]:
    """Return one line for each device with the bus address of another: both would obey a command to either device."""
    owners: dict[tuple[str, int | None], str] = {}
    faults = []
    for device in devices:
        bus, address = device.entry.bus, device.settings.bus_address
        bus_entry = buses.get(bus or "")
        is_line = isinstance(bus_entry, LineBus)  # takes one device, or several with addresses
        if bus is None or (address is None and not is_line):
            continue
        # two buses may lead to one instrument
        socket = "{} port {}".format(*bus_entry.address) if isinstance(bus_entry, VisaBus) else ""
        owner = owners.setdefault((socket or bus, address), device.name)
        if owner != device.name:
            address_text = (socket or f"bus '{bus}'") if address is None else f"address {address} on bus '{bus}'"
            message = f"{address_text} is that of {owner}; another one was expected"
            faults.append(document.fault(("devices", device.name, "settings"), message))
    return faults


def _shared_identifiers(document: yamlfile.Document, devices: Sequence[CheckedDevice]) -> list[str]:
    """Return one line for each device that shares CAN identifiers with a device of another driver on the same bus."""
    faults = []
    for index, device in enumerate(devices):
        for earlier in devices[:index]:
            if earlier.entry.bus != device.entry.bus or earlier.entry.driver == device.entry.driver:
                continue
            shared = sorted(device.settings.bus_identifiers & earlier.settings.bus_identifiers)
            if shared:
                identifier_texts = ", ".join(f"0x{identifier:03X}" for identifier in shared[:4])
                message = (
                    f"uses the identifiers {identifier_texts} of {earlier.name} on bus '{device.entry.bus}';"
                    " another node or bus"
                )
                faults.append(document.fault(("devices", device.name, "settings"), f"{message} was expected"))
    return faults


def _shared_host_addresses(document: yamlfile.Document, devices: Sequence[CheckedDevice]) -> list[str]:
    """Return one line for each device that knows the host by the bus address of another device on its bus.

    It would take the messages of that device for heartbeats of the host, and run on without the host.
    """
    faults = []
    for device in devices:
        host = device.settings.host_bus_address
        for neighbour in devices:
            if host is not None and neighbour.entry.bus == device.entry.bus and neighbour.settings.bus_address == host:
                message = f"the host's address {host} is that of {neighbour.name}, which would keep {device.name} going"
                faults.append(document.fault(("devices", device.name, "settings"), f"{message} without the host"))
    return faults


def _shared_folders(document: yamlfile.Document, devices: Sequence[CheckedDevice]) -> list[str]:
    """Return one line for each device whose folder of exports is that of another device."""
    owners: dict[Path, str] = {}
    faults = []
    for device in devices:
        settings = device.settings
        if isinstance(settings, RecordSettings) and settings.exports_folder is not None:
            owner = owners.setdefault(Path(os.path.normpath(settings.exports_folder)), device.name)
            if owner != device.name:
                message = f"{settings.exports_folder} is that of {owner}; a folder of its own was expected"
                faults.append(document.fault(("devices", device.name, "settings", "exports_folder"), message))
    return faults


def _shared_roles(document: yamlfile.Document, devices: Sequence[CheckedDevice]) -> list[str]:
    """Return one line for each drive in the role of another: a protocol names a drive by its role."""
    owners: dict[str, str] = {}
    faults = []
    for device in devices:
        if hasattr(registry.load(device.entry.driver), "engage"):
            owner = owners.setdefault(device.entry.role, device.name)
            if owner != device.name:
                message = f"{device.entry.role} is the role of {owner}; another one was expected"
                faults.append(document.fault(("devices", device.name, "role"), message))
    return faults


def _check(
    document: yamlfile.Document, bench: BenchFile, name: str, entry: Device, faults: list[str]
) -> CheckedDevice | None:
    """Check a device and append its faults; return None if its driver or its settings cannot be used."""
    keys: tuple[str | int, ...] = ("devices", name)
    try:
        driver = registry.load(entry.driver)
    except InputError as error:
        faults.append(document.fault((*keys, "driver"), str(error)))
        return None
    bus = bench.buses.get(entry.bus) if entry.bus else None
    bus_kinds = (driver.transport, *driver.further_transports)
    if driver.transport != "none" and (bus is None or bus.kind not in bus_kinds):
        statement = "no bus" if entry.bus is None else f"'{entry.bus}'"
        choices = [key for key, value in bench.buses.items() if value.kind in bus_kinds]
        expected = ", ".join(choices) or f"a bus of kind {' or '.join(bus_kinds)} under buses"
        faults.append(document.fault((*keys, "bus"), f"{statement}: {entry.driver} needs {expected}"))
    try:
        settings = driver.Settings.model_validate(entry.settings)
    except ValidationError as error:
        faults.extend(document.explain(error, (*keys, "settings")))
        return None
    silence = settings.host_silence_s
    if hasattr(driver, "engage") and not (silence and silence <= SAFE_STATE_S):
        statement = (
            f"stops by itself {silence:g} s after the host" if silence else "does not stop by itself without the host"
        )
        message = f"the drive {statement}; {SAFE_STATE_S:g} s at the most were expected"
        faults.append(document.fault((*keys, "settings"), message))
    for measurable in settings.shown():
        bounds = bench.limits.of(measurable.quantity)
        if bounds is not None and not measurable.low <= bounds[0] <= bounds[1] <= measurable.high:
            unit = UNITS[measurable.quantity]
            faults.append(
                document.fault(
                    (*keys, "settings", *measurable.place),
                    f"tells {measurable.quantity} from {measurable.low:.4g} to {measurable.high:.4g} {unit}; its limits"
                    f" of {bounds[0]:g} to {bounds[1]:g} {unit} would never trip: lower them, or widen the sensor's"
                    " range",
                )
            )
    return CheckedDevice(name=name, entry=entry, settings=settings)
