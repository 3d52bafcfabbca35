"""Read and write a drive's parameters by their paths, with or without waiting for the drive's answer."""

from leactl.driver.can_port import CanPort
from leactl.errors import DeviceError, NoAnswer
from leactl_plugins.odrive_can.can_simple import NODE_SHIFT, PARAMETER, READ, WRITE, Command
from leactl_plugins.odrive_can.endpoints import EndpointTable

MOST_TRIES = 3  # of one query or one write: a frame may get lost
READ_BACK_TOLERANCE = 1e-6  # share of a value, for the drive's single precision


class Parameters:
    """Parameters that one axis has reported."""

    def __init__(self, name: str, port: CanPort, node: int, table: EndpointTable, timeout_s: float) -> None:
        self._name, self._port, self._timeout_s = name, port, timeout_s
        self._identifier = node << NODE_SHIFT | Command.RX_SDO
        self._endpoints = table.endpoints
        self._paths = {endpoint.number: path for path, endpoint in table.endpoints.items()}
        self._awaited, self._came = "", [False]
        self.shown: dict[str, float] = {}  # newest reported value by path

    def ask(self, path: str) -> None:
        """Query a parameter without waiting; its value arrives in `shown`."""
        self._port.send(self._identifier, PARAMETER.pack(READ, self._endpoints[path].number, 0))

    def tell(self, path: str, value: float) -> None:
        """Send a value without waiting, and drop the reported one."""
        endpoint = self._endpoints[path]
        self.shown.pop(path, None)
        written = value if endpoint.layout.format == "<f" else int(value)
        self._port.send(self._identifier, PARAMETER.pack(WRITE, endpoint.number, 0) + endpoint.layout.pack(written))

    def read(self, path: str) -> float:
        """Query a parameter and wait for its value.

        Raises
        ------
        NoAnswer : the drive has answered none of `MOST_TRIES` queries in time.
        """
        for _ in range(MOST_TRIES):
            self._awaited, self._came[0] = path, False
            self.ask(path)
            if self._port.pump_until(self._came, self._port.clock.now() + self._timeout_s):
                return self.shown[path]
        raise NoAnswer(f"{self._name}: {path} was not answered in {MOST_TRIES} times {self._timeout_s:g} s")

    def write(self, path: str, value: float) -> None:
        """Set a parameter and read it back.

        Raises
        ------
        DeviceError : another value reads back; `NoAnswer` if the drive does not answer.
        """
        for _ in range(MOST_TRIES):
            self.tell(path, value)
            read_back = self.read(path)
            if self.is_near(read_back, value):
                return
        raise DeviceError(f"{self._name}: {path} is {read_back:g} although {value:g} was written")

    def is_shown(self, path: str, value: float) -> bool:
        """Whether the drive has reported this value."""
        return self.is_near(self.shown.get(path), value)

    @staticmethod
    def is_near(shown: float | None, value: float) -> bool:
        """Whether a reported value equals this one."""
        return shown is not None and abs(shown - value) <= READ_BACK_TOLERANCE * abs(value)

    def on_frame(self, data: bytearray, _timestamp: float) -> None:
        """Receive an answer; one without a value confirms a write (firmware 0.6.11)."""
        if len(data) < PARAMETER.size:
            return
        path = self._paths.get(PARAMETER.unpack_from(data)[1])
        if path is None:
            return
        layout = self._endpoints[path].layout
        if len(data) >= PARAMETER.size + layout.size:
            (self.shown[path],) = layout.unpack_from(data, PARAMETER.size)
            if path == self._awaited:
                self._came[0] = True
