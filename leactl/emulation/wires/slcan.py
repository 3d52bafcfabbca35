"""The far end of a serial CAN adapter on a pseudo terminal: Lawicel's ASCII protocol, which python-can calls `slcan`.

Commands end with CR; the adapter answers CR, or BEL where it refuses (Lawicel CANUSB manual, version 1.0D).
"""

import can

from leactl.emulation.wires.pseudo_terminal import PseudoTerminal

CR, BEL = b"\r", b"\a"
VERSION, SERIAL = b"V1013\r", b"NA123\r"  # answers of the adapter to V and N


class SlcanAdapter:
    """An adapter whose serial side is a pseudo terminal, `path`, and whose CAN side is `recv` and `send`."""

    def __init__(self) -> None:
        self._terminal = PseudoTerminal()
        self.path = self._terminal.path
        self._unfinished_command = b""
        self._is_open = False
        self._frames: list[can.Message] = []

    def fileno(self) -> int:
        """Return the descriptor that `select` waits for."""
        return self._terminal.fileno()

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame that the client sent, or None; never wait."""
        if not self._frames:
            self._read()
        return self._frames.pop(0) if self._frames else None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a classic frame to the client; a closed channel or a full line loses it, as with a real adapter."""
        if self._is_open and not msg.is_fd:
            self._terminal.write(b"t%03X%d%s\r" % (msg.arbitration_id, msg.dlc, bytes(msg.data).hex().upper().encode()))

    def shutdown(self) -> None:
        """Close the terminal."""
        self._terminal.close()

    def _read(self) -> None:
        """Read what the client has sent, and answer each complete command."""
        self._unfinished_command += self._terminal.read()
        *commands, self._unfinished_command = self._unfinished_command.split(CR)
        self._unfinished_command = self._unfinished_command[
            -64:
        ]  # no command is longer; this bounds what noise adds up to
        for command in commands:
            self._terminal.write(self._answer(command))

    def _answer(self, command: bytes) -> bytes:
        """Execute a command of the client and return the adapter's answer."""
        command_letter = command[:1]
        if command_letter == b"O":
            self._is_open = True
        elif command_letter == b"C":
            self._is_open = False
        elif command_letter == b"V":
            return VERSION
        elif command_letter == b"N":
            return SERIAL
        elif command_letter == b"t":
            return self._transmit(command)
        elif command_letter not in (b"S", b"s", b"M", b"m", b"Z", b""):
            return BEL
        return CR

    def _transmit(self, command: bytes) -> bytes:
        """Queue the frame of a transmit command `tIIILDD...`; return CR, or BEL if the command is not valid."""
        try:
            identifier, byte_count = int(command[1:4], 16), int(command[4:5])
            data = bytes.fromhex(command[5:].decode("ascii"))
        except ValueError:
            return BEL
        if not self._is_open or identifier > 0x7FF or byte_count > 8 or len(data) != byte_count:
            return BEL
        self._frames.append(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        return CR
