"""Read and write a drive's parameters by their paths, with or without waiting for the drive's answer."""

from leactl.driver.can_port import CanPort
from leactl.errors import DeviceError, NoAnswer
from leactl_plugins.odrive_can.can_simple import NODE_SHIFT, PARAMETER, READ, WRITE, Command
from leactl_plugins.odrive_can.endpoints import EndpointTable

MOST_TRIES = 3  # of a query or a write, because a frame may get lost
READ_BACK_TOLERANCE = 1e-6  # relative; the drive's single precision rounds by 6e-8


class Parameters:
    """Reads and writes the parameters of one axis, and keeps the newest value that it has reported of each."""

    def __init__(self, name: str, port: CanPort, node: int, table: EndpointTable, timeout_s: float) -> None:
        self._name, self._port, self._timeout_s = name, port, timeout_s
        self._identifier = node << NODE_SHIFT | Command.RX_SDO
        self._endpoints = table.endpoints
        self._paths = {endpoint.number: path for path, endpoint in table.endpoints.items()}
        self._awaited = ""  # path of the parameter that `read` waits for
        self._answered = [False]  # whether its value has arrived; a list, because the port watches its item
        self.reported: dict[str, float] = {}  # newest reported value by path

    def ask(self, path: str) -> None:
        """Query a parameter without waiting; its value arrives in `reported`."""
        self._port.send(self._identifier, PARAMETER.pack(READ, self._endpoints[path].number, 0))

    def send(self, path: str, value: float) -> None:
        """Send a value without waiting, and forget the value reported before."""
        endpoint = self._endpoints[path]
        self.reported.pop(path, None)
        packed_value = value if endpoint.layout.format == "<f" else int(value)
        self._port.send(
            self._identifier, PARAMETER.pack(WRITE, endpoint.number, 0) + endpoint.layout.pack(packed_value)
        )

    def read(self, path: str) -> float:
        """Query a parameter and wait for its value.

        Raises
        ------
        NoAnswer : the drive has answered none of `MOST_TRIES` queries in time.
        """
        for _ in range(MOST_TRIES):
            self._awaited, self._answered[0] = path, False
            self.ask(path)
            if self._port.pump_until(self._answered, self._port.clock.now() + self._timeout_s):
                return self.reported[path]
        raise NoAnswer(f"{self._name}: {path} was not answered in {MOST_TRIES} times {self._timeout_s:g} s")

    def write(self, path: str, value: float) -> None:
        """Set a parameter and read it back.

        Raises
        ------
        DeviceError : the drive reports another value.
        NoAnswer : the drive does not answer.
        """
        for _ in range(MOST_TRIES):
            self.send(path, value)
            read_back = self.read(path)
            if self.reads_back_as(read_back, value):
                return
        raise DeviceError(f"{self._name}: {path} is {read_back:g} although {value:g} was written")

    def has_reported(self, path: str, value: float) -> bool:
        """Return whether the newest value that the drive has reported of a parameter equals this one."""
        return self.reads_back_as(self.reported.get(path), value)

    @staticmethod
    def reads_back_as(reported: float | None, value: float) -> bool:
        """Return whether a reported value equals a written one to `READ_BACK_TOLERANCE`; False if none was reported."""
        return reported is not None and abs(reported - value) <= READ_BACK_TOLERANCE * abs(value)

    def on_frame(self, data: bytearray, _timestamp: float) -> None:
        """Receive an answer; an answer without a value confirms a write (firmware 0.6.11) and is ignored."""
        if len(data) < PARAMETER.size:
            return
        path = self._paths.get(PARAMETER.unpack_from(data)[1])
        if path is None:
            return
        layout = self._endpoints[path].layout
        if len(data) >= PARAMETER.size + layout.size:
            (self.reported[path],) = layout.unpack_from(data, PARAMETER.size)
            if path == self._awaited:
                self._answered[0] = True
