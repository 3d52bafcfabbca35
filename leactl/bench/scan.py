"""Scan a wire for devices by the probes of all drivers, which send nothing except requests to read.

Each function scans one wire and adds each answer to a `WireReport` at once, so that the answers remain if a person
stops the scan. A CAN bus is listened to first, and nothing is sent on it if another host is at work there.
"""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from leactl.bench.benchfile import LineBus, SerialBus
from leactl.driver import registry
from leactl.driver.can_port import CanPort
from leactl.driver.clock import Clock
from leactl.driver.far_end import LAST_OF_11_BITS, FdFrame, Frame
from leactl.driver.i2c_port import I2cPort, SmBus
from leactl.driver.probe import CanProbe, I2cProbe, LineProbe, Seen, Sighting
from leactl.driver.serial_port import SerialLine, SerialPort
from leactl.errors import DeviceError, LeactlError

if TYPE_CHECKING:
    import can

    from leactl.driver.contract import Driver

LISTEN_S = 1.2  # most devices are shipped with a heartbeat of one second or less
LONGEST_PROBE_S = 20.0  # time limit of one probe on one bus, or at one rate of a line
MOST_FRAMES_HZ = 3000  # if frames come at this rate without a host, nothing is sent in addition
LINE_LISTEN_S = 0.1  # time of listening to a line before a probe asks
MOST_UNASKED_BYTES = 64  # in LINE_LISTEN_S; if as many come, no probe asks
MOST_FRAMES, MOST_IDENTIFIERS = 8, 4096  # stored frames of each identifier, and stored identifiers
SHOWN_BYTES = 24  # first bytes of a line that a note quotes
BIT_RATE_HINT = "is a device switched on, have all devices and the interface one bit rate, is the bus terminated?"
MOST_ANSWERS = 200  # sightings of one probe, and notes on one wire


class Watcher(NamedTuple):
    """A person who follows a scan."""

    show: Callable[[str], None]  # takes a text on the next activity
    check: Callable[[], None]  # raises `Stopped` if the person has asked for the end; called often


class Answered(NamedTuple):
    """A device that answered a driver's probe."""

    driver: str
    sighting: Sighting
    line: LineBus | None = None  # serial line or socket on which the device answered; None for a device on another bus


@dataclass
class WireReport:
    """Answers and notes of the scan of one wire."""

    name: str
    answered: list[Answered] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # a line each
    fault: str = ""  # why the wire could not be scanned, or not completely
    asked: bool = False  # whether anything was sent
    heard: bool = False  # whether a note is on data that came over the wire, not on a probe that failed
    complete: bool = False  # whether the scan came to its end

    def note(self, text: str) -> None:
        """Add a line, unless it is there already or there are too many."""
        if text not in self.notes and len(self.notes) < MOST_ANSWERS:
            self.notes.append(text)


class ProbeOverrun(DeviceError):
    """A probe took longer than `LONGEST_PROBE_S`, or sent what a scan refuses."""


class _TimeLimit:
    """Time limit of one probe, which a person may end earlier."""

    def __init__(self, clock: Clock, watcher: Watcher) -> None:
        self._clock, self._watcher, self._deadline = clock, watcher, float("inf")

    def begin(self) -> None:
        """Begin the time of another probe."""
        self._deadline = self._clock.now() + LONGEST_PROBE_S

    def check(self) -> None:
        """Raise ProbeOverrun if the time is over, or Stopped if a person has ended the scan."""
        self._watcher.check()
        if self._clock.now() > self._deadline:
            raise ProbeOverrun(f"takes more than {LONGEST_PROBE_S:g} s")


def can_probes() -> dict[str, CanProbe]:
    """Return the probes for a CAN bus by the names of their drivers."""
    return {name: driver.probe for name, driver in _drivers() if isinstance(driver.probe, CanProbe)}


def i2c_probes() -> dict[str, I2cProbe]:
    """Return the probes for an I2C bus by the names of their drivers."""
    return {name: driver.probe for name, driver in _drivers() if isinstance(driver.probe, I2cProbe)}


def line_probes(kind: str) -> dict[str, LineProbe]:
    """Return the probes for a line of this kind, "serial" or "visa", by the names of their drivers."""
    return {
        name: driver.probe
        for name, driver in _drivers()
        if isinstance(driver.probe, LineProbe) and kind in (driver.transport, *driver.further_transports)
    }


def _drivers() -> "Iterator[tuple[str, type[Driver]]]":
    """Yield every driver that can be loaded, with its name; `leactl driver list` lists the others."""
    return ((item.name, item.driver) for item in registry.survey() if item.driver is not None)


def settings_left_open(driver: "type[Driver]", sighting: Sighting) -> list[str]:
    """Return the settings that a bench file must have and that a device's answer does not determine."""
    settings, fields = sighting.settings or {}, driver.Settings.model_fields
    needed_settings = [name for name, field in fields.items() if field.is_required() or name in sighting.left_open]
    return [name for name in needed_settings if name not in settings]


# -- CAN -------------------------------------------------------------------------------------------------------------


class _HeardFrames:
    """Frames of other participants: the latest frames of each identifier."""

    def __init__(self) -> None:
        self.begin()
        self.sent: set[Frame] = set()  # frames sent by the scan, which some adapters echo

    def begin(self) -> None:
        """Forget all frames."""
        self._frames: dict[int, deque[Frame]] = {}
        self.count = self.errors = self.of_29_bits = 0

    @property
    def frames(self) -> list[Frame]:
        """The stored frames, by identifier in order of arrival."""
        return [frame for stored in self._frames.values() for frame in stored]

    @property
    def classic(self) -> bool:
        """Whether any stored frame is a classic frame."""
        return any(not isinstance(frame, FdFrame) for frame in self.frames)

    def add(self, message: "can.Message") -> None:
        """Count a frame, and store it unless it is an error frame, a remote frame or an echo of a sent frame."""
        self.count += 1
        if message.is_error_frame:
            self.errors += 1
            return
        kind = FdFrame if message.is_fd else Frame
        frame = kind(message.arbitration_id, bytes(message.data))
        if message.is_remote_frame or frame in self.sent:
            return
        self.of_29_bits += frame.identifier > LAST_OF_11_BITS and not message.is_fd
        stored = self._frames.get(frame.identifier)
        if stored is None and len(self._frames) < MOST_IDENTIFIERS:
            stored = self._frames[frame.identifier] = deque(maxlen=MOST_FRAMES)
        if stored is not None:
            stored.append(frame)


class _WatchedBus:
    """A connection that stores received frames, and refuses to send identifiers of other protocols' devices."""

    def __init__(self, bus: "can.BusABC", heard_frames: _HeardFrames, time_limit: _TimeLimit) -> None:
        self._bus, self._heard_frames, self._time_limit = bus, heard_frames, time_limit
        self.taken: Collection[int] = ()

    def recv(self, timeout: float | None = None) -> "can.Message | None":
        """Receive a frame and store it."""
        self._time_limit.check()
        message = self._bus.recv(timeout)
        if message is not None:
            self._heard_frames.add(message)
        return message

    def send(self, message: "can.Message", timeout: float | None = None) -> None:
        """Send a frame.

        Raises
        ------
        ProbeOverrun : another protocol's device acts on its identifier, or the time of the probe is over.
        """
        self._time_limit.check()
        if not message.is_extended_id and message.arbitration_id in self.taken:
            raise ProbeOverrun(f"would send 0x{message.arbitration_id:03X}, on which another device acts")
        kind = FdFrame if message.is_fd else Frame
        self._heard_frames.sent.add(kind(message.arbitration_id, bytes(message.data)))
        self._bus.send(message, timeout)

    def shutdown(self) -> None:
        """Close the connection."""
        self._bus.shutdown()


def ask_can(
    report: WireReport,
    connect: "Callable[[], can.BusABC]",
    clock: Clock,
    probes: Mapping[str, CanProbe],
    watcher: Watcher,
    fd: bool = False,
) -> None:
    """Listen to a CAN bus, then ask by each probe, unless another host is at work.

    fd : whether the bus carries CAN-FD frames.

    Raises
    ------
    DeviceError : the bus is absent, gone, or takes no frames; earlier answers remain in the report.
    Stopped : by the watcher.
    """
    _CanScan(report, connect, clock, probes, watcher).run(fd)


class _CanScan:
    """Scan of one CAN bus."""

    def __init__(
        self,
        report: WireReport,
        connect: "Callable[[], can.BusABC]",
        clock: Clock,
        probes: Mapping[str, CanProbe],
        watcher: Watcher,
    ) -> None:
        self._report, self._connect, self._clock, self._probes = report, connect, clock, probes
        self._show, self._heard_frames, self._time_limit = watcher.show, _HeardFrames(), _TimeLimit(clock, watcher)
        # the watched bus has the methods of a bus that a port calls
        self._port = CanPort(self._connect_watched, clock, report.name)  # type: ignore[arg-type]
        self._addresses: dict[str, frozenset[int]] = {}  # heard while listening, by driver
        self._known_nodes: dict[str, set[int]] = {}  # heard while listening, or answered, by driver

    def _connect_watched(self) -> _WatchedBus:
        """Connect to the bus, with every frame stored and checked."""
        self._bus = _WatchedBus(self._connect(), self._heard_frames, self._time_limit)
        return self._bus

    def run(self, fd: bool) -> None:
        """Listen, then ask by each probe: first those that search, last those that use CAN-FD frames."""
        report, port = self._report, self._port
        self._show(f"listens for {LISTEN_S:g} s")
        port.open()
        try:
            port.pump_until((False,), self._clock.now() + LISTEN_S)
            frames = self._heard_frames.frames
            self._addresses = {name: frozenset(probe.heard(frames)) for name, probe in self._probes.items()}
            self._known_nodes = {name: set(nodes) for name, nodes in self._addresses.items()}
            if self._heard_frames.of_29_bits:
                report.note("frames with identifiers of 29 bits come, of a protocol that no driver here speaks")
            if reason := self._reason_to_listen():
                self._only_listen(reason)
                return
            for name in sorted(self._probes, key=self._sort_key):
                if name not in self._exclude_fd_probes(fd):
                    self._ask_by_probe(name)
                if reason := self._other_host():
                    self._only_listen(reason)
                    return
            if self._heard_frames.errors:
                report.note(f"{self._heard_frames.errors} error frames came while it was asked; {BIT_RATE_HINT}")
        except DeviceError:
            if port.queue_full.count:
                raise DeviceError(f"bus '{report.name}': no frame is acknowledged; {BIT_RATE_HINT}") from None
            raise
        finally:
            port.close()

    def _sort_key(self, name: str) -> tuple[bool, bool, str]:
        """Return the sort key of a probe: those that search first, those that use CAN-FD frames last."""
        probe = self._probes[name]
        return probe.fd, not probe.searches, name

    def _reason_to_listen(self) -> str:
        """Return why nothing may be sent, according to the received frames; empty if a probe may ask."""
        heard_frames, rate = self._heard_frames, self._heard_frames.count / LISTEN_S
        if heard_frames.errors:
            return f"{heard_frames.errors} error frames came; {BIT_RATE_HINT}"
        if reason := self._other_host():
            return reason
        return f"{rate:.0f} frames a second come without a host: a device babbles" if rate >= MOST_FRAMES_HZ else ""

    def _other_host(self) -> str:
        """Return a line on another host of which a command was heard; empty if none was."""
        for probe in self._probes.values():
            if command := probe.host(self._heard_frames.frames):
                return f"another host is at work, {command} was heard; end it, then scan again"
        return ""

    def _only_listen(self, reason: str) -> None:
        """Note why no more is sent, and which devices were heard and not asked."""
        self._report.note(f"only listened{' from then on' if self._report.asked else ''}: {reason}")
        for name, nodes in self._addresses.items():
            not_asked = nodes - {answer.sighting.address for answer in self._report.answered if answer.driver == name}
            if not_asked:
                self._report.note(f"heard, and not asked: {name} at {', '.join(map(str, sorted(not_asked)))}")

    def _exclude_fd_probes(self, fd: bool) -> list[str]:
        """Return the drivers whose probes may not be used on this bus, and note them in the report."""
        unsuited = [name for name, probe in self._probes.items() if probe.fd]
        if fd and not (
            self._heard_frames.classic or any(not self._probes[answer.driver].fd for answer in self._report.answered)
        ):
            return []
        reason = "errors to the classic devices on the bus" if fd else "more than this interface carries"
        for name in unsuited:
            self._report.note(f"{name} was not asked: its CAN-FD frames are {reason}")
        return unsuited

    def _ask_by_probe(self, name: str) -> None:
        """Ask by the probe of a driver, and add the devices that answer to the report."""
        self._show(f"{name} asks")
        self._report.asked = True
        self._bus.taken = frozenset(
            identifier
            for driver, nodes in self._known_nodes.items()
            if driver != name
            for node in nodes
            for identifier in self._probes[driver].identifiers(node)
        )
        ask = partial(self._probes[name].ask, self._port, self._addresses[name], self._bus.taken)
        for sighting in _sightings(self._report, name, ask, self._time_limit):
            self._report.answered.append(Answered(name, sighting))
            if sighting.address is not None:
                self._known_nodes[name].add(sighting.address)


def _sightings(report: WireReport, name: str, ask: Callable[[], Seen], time_limit: _TimeLimit) -> Iterator[Sighting]:
    """Yield the devices that a probe recognises; texts of the probe, and its failure, become notes.

    Raises
    ------
    DeviceError : the wire failed.
    """
    time_limit.begin()
    try:
        for number, seen in enumerate(ask()):
            if number >= MOST_ANSWERS:
                report.note(f"the probe of {name} was ended: more than {MOST_ANSWERS} answers")
                return
            if isinstance(seen, str):
                report.heard = True
                report.note(f"{name}: {seen}")
            else:
                yield seen
    except ProbeOverrun as error:
        report.note(f"the probe of {name} was ended: it {error}")
    except LeactlError:
        raise
    except Exception as error:  # noqa: BLE001 (a foreign plug-in may fail in any way; the others are asked all the same)
        report.note(f"the probe of {name} breaks with {type(error).__name__}: {error}")


# -- I2C -------------------------------------------------------------------------------------------------------------


class _ReadOnlyBus:
    """A connection that refuses to write."""

    def __init__(self, bus: SmBus, time_limit: _TimeLimit) -> None:
        self._bus, self._time_limit = bus, time_limit

    def read_word_data(self, i2c_addr: int, register: int) -> int:
        """Read a word."""
        self._time_limit.check()
        return self._bus.read_word_data(i2c_addr, register)

    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Raise ProbeOverrun: a probe only reads."""
        raise ProbeOverrun(f"would write to address 0x{i2c_addr:02X}")

    def close(self) -> None:
        """Close the connection."""
        self._bus.close()


def ask_i2c(
    report: WireReport, connect: Callable[[], SmBus], clock: Clock, probes: Mapping[str, I2cProbe], watcher: Watcher
) -> None:
    """Ask an I2C bus by each probe.

    Raises
    ------
    DeviceError : the bus is absent or fails; earlier answers remain in the report.
    Stopped : by the watcher.
    """
    time_limit = _TimeLimit(clock, watcher)
    port = I2cPort(lambda: _ReadOnlyBus(connect(), time_limit), report.name)
    port.open()
    try:
        for name, probe in sorted(probes.items()):
            watcher.show(f"{name} asks")
            report.asked = True
            for sighting in _sightings(report, name, partial(probe.ask, port), time_limit):
                report.answered.append(Answered(name, sighting))
    finally:
        port.close()


# -- serial lines and sockets ----------------------------------------------------------------------------------------


class _WatchedLine:
    """A connection that several ports use in turn; it stores the first bytes received."""

    def __init__(self, line: SerialLine, time_limit: _TimeLimit) -> None:
        self._line, self._time_limit = line, time_limit
        self.heard = b""  # the first bytes received

    def read(self, timeout: float) -> bytes:
        """Return bytes that have arrived, waiting at most `timeout` [s] for the first byte."""
        self._time_limit.check()
        received = self._line.read(timeout)
        self.heard = (self.heard + received)[:SHOWN_BYTES]
        return received

    def write(self, data: bytes) -> int:
        """Write as many bytes as are accepted at once; return their number."""
        self._time_limit.check()
        return self._line.write(data)

    def close(self) -> None:
        """Keep the connection for the next port."""


def ask_line(
    report: WireReport,
    connect: Callable[[LineBus], SerialLine],
    clock: Clock,
    probes: Mapping[str, LineProbe],
    lines: Sequence[LineBus],
    watcher: Watcher,
) -> None:
    """Ask one device by each probe, over one line after another (rates, or ports), until a probe recognises it.

    A probe that fails at one rate or port is asked again at the others.

    Raises
    ------
    DeviceError : the line is absent, each of the ports refuses, or the connection fails.
    Stopped : by the watcher.
    """
    first_bytes: dict[str, bytes] = {}  # by rate or port
    refusals: list[str] = []
    for line in lines:
        watcher.show(f"asks at {rate_or_port(line)}")
        try:
            connection = connect(line)
        except (OSError, ValueError, ImportError) as error:
            refusals.append(str(error))
            if isinstance(line, SerialBus):  # the port will not be there at another rate either
                break
            continue
        try:
            first_bytes[rate_or_port(line)] = _ask_connection(report, connection, clock, probes, line, watcher)
        except OSError as error:
            raise DeviceError(f"{report.name}: the device is gone: {error}") from None
        finally:
            connection.close()
        if report.answered or report.heard:
            return
    if not first_bytes:
        raise DeviceError("; ".join(refusals))
    for rate, data in first_bytes.items():
        if data:
            report.note(f"something answers at {rate} what no driver can read: {data!r}")
    if not any(first_bytes.values()):
        rates = [str(line.baudrate) for line in lines if isinstance(line, SerialBus)]
        report.note(f"silent at {', '.join(rates)} baud" if rates else f"silent at {' and '.join(first_bytes)}")


def rate_or_port(line: LineBus) -> str:
    """Return the rate of a serial line, or the port of a socket, as text."""
    return f"{line.baudrate} baud" if isinstance(line, SerialBus) else f"port {line.address[1]}"


def _ask_connection(
    report: WireReport,
    connection: SerialLine,
    clock: Clock,
    probes: Mapping[str, LineProbe],
    line: LineBus,
    watcher: Watcher,
) -> bytes:
    """Ask by each probe over one connection; return the first bytes received."""
    time_limit = _TimeLimit(clock, watcher)
    watched_line = _WatchedLine(connection, time_limit)
    unasked_bytes, listen_end = 0, clock.now() + LINE_LISTEN_S
    while (seconds_left := listen_end - clock.now()) > 0.0 and unasked_bytes < MOST_UNASKED_BYTES:
        unasked_bytes += len(watched_line.read(seconds_left))
    if unasked_bytes >= MOST_UNASKED_BYTES:
        report.heard = True
        report.note(
            f"only listened: bytes come without a question at {rate_or_port(line)}, such as {watched_line.heard!r}"
        )
        return watched_line.heard
    for name, probe in sorted(probes.items()):
        if isinstance(line, SerialBus) and line.baudrate not in probe.baudrates:
            continue
        report.asked = True
        port = SerialPort(lambda: watched_line, clock, report.name)
        port.open()
        for sighting in _sightings(report, name, partial(probe.ask, port), time_limit):
            report.answered.append(Answered(name, sighting, line))
        port.close()
        if report.answered:
            break
    return watched_line.heard


def rates_of(probes: Iterable[LineProbe]) -> list[int]:
    """Return every rate at which one of the probes asks, the lowest first."""
    return sorted({rate for probe in probes for rate in probe.baudrates})
