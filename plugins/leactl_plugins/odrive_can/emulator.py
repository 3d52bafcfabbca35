"""Emulator of an ODrive: queries, inputs, parameters, heartbeats and the watchdog.

Frames in, frames out; it shares with the driver only the protocol's numbers. Where firmware versions differ it takes
the behaviour that is harder for a host: its watchdog runs whenever it is enabled, and only inputs and states feed it.
"""

import math

from leactl.driver.far_end import Frame, Machine
from leactl_plugins.odrive_can import endpoints
from leactl_plugins.odrive_can.can_simple import (
    HEARTBEAT,
    MODES,
    NODE_SHIFT,
    ONE_FLOAT,
    PARAMETER,
    POSITION,
    PROTOCOL,
    STATE,
    TWO_FLOATS,
    VERSION,
    WATCHDOG_TIMER_EXPIRED,
    WRITE,
    AxisState,
    Command,
    ControlMode,
)

DRV_FAULT = 0x20
TO_AMPLITUDE, TURN = math.sqrt(2.0 / 3.0), 2.0 * math.pi
WATCHDOG_COMMANDS = (Command.SET_AXIS_STATE, Command.SET_INPUT_POS, Command.SET_INPUT_VEL, Command.SET_INPUT_TORQUE)


class OdriveEmulator:
    """One axis at a node, which turns a motor."""

    def __init__(
        self,
        node: int,
        machine: Machine,
        table: endpoints.EndpointTable,
        *,
        torque_constant: float,
        current_soft_max: float,
    ) -> None:
        self._base, self._machine, self._table = node << NODE_SHIFT, machine, table
        self.parameters: dict[str, float] = {
            endpoints.ENABLE_WATCHDOG: 0,
            endpoints.WATCHDOG_TIMEOUT: 0.0,
            endpoints.TORQUE_CONSTANT: torque_constant,
            endpoints.CURRENT_SOFT_MAX: current_soft_max,
            endpoints.VELOCITY_LIMIT: 20.0,
            endpoints.CONTROL_MODE: ControlMode.POSITION,
            endpoints.INPUT_MODE: 1,
            endpoints.HEARTBEAT_PERIOD: 100,
            endpoints.ENCODER_PERIOD: 10,
            endpoints.CURRENT_PERIOD: 0,
        }
        self.stored = dict(self.parameters)
        self._paths = {endpoint.number: path for path, endpoint in table.endpoints.items()}
        self.state, self.errors = AxisState.IDLE, 0
        self.frozen = False  # whether it has stopped answering
        self._inputs = {ControlMode.POSITION: 0.0, ControlMode.VELOCITY: 0.0, ControlMode.TORQUE: 0.0}
        self._watchdog_fed_at = 0.0
        self._next_heartbeat = self._next_encoder = -math.inf

    @property
    def due(self) -> float:
        """Time [s] of the next unrequested message, or of the watchdog's timeout."""
        if self.frozen:
            return math.inf
        encoder = self._next_encoder if self.parameters[endpoints.ENCODER_PERIOD] else math.inf
        heartbeat = self._next_heartbeat if self._heartbeat_s < math.inf else math.inf
        return min(heartbeat, encoder, self._watchdog_ends)

    @property
    def _heartbeat_s(self) -> float:
        """Time between two heartbeats [s]; infinite for a period of 0."""
        return 1e-3 * self.parameters[endpoints.HEARTBEAT_PERIOD] or math.inf

    @property
    def _watchdog_ends(self) -> float:
        """Time at which the watchdog expires [s]."""
        if not self.parameters[endpoints.ENABLE_WATCHDOG] or self.errors & WATCHDOG_TIMER_EXPIRED:
            return math.inf
        return self._watchdog_fed_at + self.parameters[endpoints.WATCHDOG_TIMEOUT]

    def tick(self, now: float) -> list[Frame]:
        """Send the heartbeats and readings that are due, and let the watchdog react; return the frames."""
        if self.frozen:
            return []
        if now >= self._watchdog_ends:
            self._disarm(WATCHDOG_TIMER_EXPIRED)
        frames = []
        if now >= self._next_heartbeat and self._heartbeat_s < math.inf:
            self._next_heartbeat = now + self._heartbeat_s
            frames.append(self._frame(Command.HEARTBEAT, HEARTBEAT.pack(self.errors, self.state, 0, 0, 0)))
        if self.parameters[endpoints.ENCODER_PERIOD] and now >= self._next_encoder:
            self._next_encoder = now + 1e-3 * self.parameters[endpoints.ENCODER_PERIOD]
            frames.append(self._encoder_frame())
        return frames

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Receive one frame from the bus; return the answers."""
        identifier, data = frame
        if self.frozen or identifier >> NODE_SHIFT != self._base >> NODE_SHIFT:
            return []
        command = identifier & (1 << NODE_SHIFT) - 1
        if command in WATCHDOG_COMMANDS:
            self._watchdog_fed_at = now
        if not data:
            return self._answer(command)
        if command == Command.RX_SDO and len(data) >= PARAMETER.size:
            return self._access_parameter(data, now)
        self._obey(command, data)
        return []

    def _answer(self, command: int) -> list[Frame]:
        """Return the answer to a query."""
        if command == Command.GET_VERSION:
            firmware, hardware = (
                [int(number) for number in text.split(".")] for text in (self._table.firmware, self._table.hardware)
            )
            return [self._frame(Command.GET_VERSION, VERSION.pack(PROTOCOL, *hardware, *firmware, 0))]
        if command == Command.GET_ENCODER_ESTIMATES:
            return [self._encoder_frame()]
        if command == Command.GET_IQ:
            demanded_current = self._inputs[ControlMode.TORQUE] / self.parameters[endpoints.TORQUE_CONSTANT]
            return [
                self._frame(Command.GET_IQ, TWO_FLOATS.pack(demanded_current, self._machine.read()[0] * TO_AMPLITUDE))
            ]
        if command == Command.GET_BUS_VOLTAGE_CURRENT:
            return [self._frame(command, TWO_FLOATS.pack(self._machine.bus_voltage, 0.0))]
        return []

    def _obey(self, command: int, data: bytes) -> None:
        """Obey a command; one of an unknown form changes nothing."""
        if command == Command.SET_AXIS_STATE and len(data) >= STATE.size:
            self._set_state(STATE.unpack_from(data)[0])
        elif command == Command.SET_CONTROLLER_MODE and len(data) == MODES.size:
            control_mode, input_mode = MODES.unpack(data)
            self.parameters.update({endpoints.CONTROL_MODE: control_mode, endpoints.INPUT_MODE: input_mode})
        elif command == Command.SET_INPUT_POS and len(data) == POSITION.size:
            self._set_input(ControlMode.POSITION, POSITION.unpack(data)[0])
        elif command == Command.SET_INPUT_VEL and len(data) == TWO_FLOATS.size:
            self._set_input(ControlMode.VELOCITY, TWO_FLOATS.unpack(data)[0])
        elif command == Command.SET_INPUT_TORQUE and len(data) >= ONE_FLOAT.size:
            self._set_input(ControlMode.TORQUE, ONE_FLOAT.unpack_from(data)[0])
        elif command == Command.CLEAR_ERRORS:
            self.errors = 0

    def _set_state(self, state: int) -> None:
        if state == AxisState.IDLE:
            self.state = AxisState.IDLE
            self._machine.command("off", 0.0)
        elif state == AxisState.CLOSED_LOOP_CONTROL and not self.errors:
            self.state = AxisState.CLOSED_LOOP_CONTROL
            self._follow_input()

    def _set_input(self, mode: ControlMode, value: float) -> None:
        self._inputs[mode] = value
        if self.state == AxisState.CLOSED_LOOP_CONTROL:
            self._follow_input()

    def _follow_input(self) -> None:
        """Let the motor follow the input of the mode, clipped to the drive's limits without a message."""
        mode = ControlMode(int(self.parameters[endpoints.CONTROL_MODE]))
        value = self._inputs[mode]
        if mode is ControlMode.POSITION:
            self._machine.command("angle", value * TURN)
        elif mode is ControlMode.VELOCITY:
            highest = self.parameters[endpoints.VELOCITY_LIMIT]
            self._machine.command("velocity", max(-highest, min(highest, value)) * TURN)
        else:
            highest = self.parameters[endpoints.CURRENT_SOFT_MAX]
            current = value / self.parameters[endpoints.TORQUE_CONSTANT]
            self._machine.command("current", max(-highest, min(highest, current)) / TO_AMPLITUDE)

    def _access_parameter(self, data: bytes, now: float) -> list[Frame]:
        """Read or write a parameter; return the answer."""
        opcode, number, _ = PARAMETER.unpack_from(data)
        path = self._paths.get(number)
        if path is None:
            return []
        layout = self._table.endpoints[path].layout
        if opcode == WRITE:
            if len(data) >= PARAMETER.size + layout.size:
                (self.parameters[path],) = layout.unpack_from(data, PARAMETER.size)
                self._watchdog_fed_at = now if path == endpoints.ENABLE_WATCHDOG else self._watchdog_fed_at
                self._next_heartbeat = min(self._next_heartbeat, now + self._heartbeat_s)
            return [self._frame(Command.TX_SDO, PARAMETER.pack(0, number, 0))]
        value = self.parameters[path]
        packed = layout.pack(value if layout.format == "<f" else int(value))
        return [self._frame(Command.TX_SDO, PARAMETER.pack(0, number, 0) + packed)]

    def _encoder_frame(self) -> Frame:
        _, velocity, angle = self._machine.read()
        return self._frame(Command.GET_ENCODER_ESTIMATES, TWO_FLOATS.pack(angle / TURN, velocity / TURN))

    def _frame(self, command: int, data: bytes) -> Frame:
        return Frame(self._base | command, data)

    def _disarm(self, error: int) -> None:
        """Go idle with an error."""
        self.errors |= error
        self.state = AxisState.IDLE
        self._machine.command("off", 0.0)

    def is_sign_of_life(self, frame: Frame) -> bool:
        """Return whether a frame is a heartbeat."""
        return frame.identifier == self._base | Command.HEARTBEAT

    # -- faults inside the drive -------------------------------------------------------------------------------------

    def freeze(self, frozen: bool) -> None:
        """Stop answering and keep the last demand (`frozen` True), or return to normal."""
        self.frozen = frozen

    def restart(self) -> None:
        """Come back from a loss of power: idle, without errors, with the stored parameters."""
        self.frozen, self.state, self.errors = False, AxisState.IDLE, 0
        self.parameters = dict(self.stored)
        self._machine.command("off", 0.0)

    def fault(self, code: int) -> None:
        """Go idle with an error of the power stage; the protocol has no CiA 301 error codes."""
        self._disarm(DRV_FAULT)
