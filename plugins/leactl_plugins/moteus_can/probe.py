"""Recognise moteus controllers by reading their identity: no register is written, not even that of the mode."""

import base64
import struct
from collections.abc import Collection, Mapping, Sequence
from functools import partial

from leactl.driver.can_port import CanPort
from leactl.driver.contract import Identity
from leactl.driver.far_end import LAST_OF_11_BITS, FdFrame, Frame
from leactl.driver.probe import CanProbe, Seen, Sighting
from leactl_plugins.moteus_can.exchange import query
from leactl_plugins.moteus_can.multiplex import REPLY_REQUESTED, Resolution, identifier, pad, parse
from leactl_plugins.moteus_can.registers import MAP_VERSION, Register
from leactl_plugins.moteus_can.settings import HOST, NODES

IDENTITY_QUERY = query(
    (Register.MODE, 1, Resolution.INT8),
    (Register.FAULT, 1, Resolution.INT8),
    (Register.MODEL_NUMBER, 3, Resolution.INT32),  # with the versions of firmware and register map
    (Register.SERIAL_NUMBER, 3, Resolution.INT32),
)
REPLY_REQUESTED_BIT = 0x8000  # bit of an identifier
REQUEST_PERIOD_S = 0.002  # time from one controller to the next; frame and answer take 0.3 ms at 1 and 5 Mbit/s
ANSWER_TIMEOUT_S = 0.1  # time for answers after the last request
MOST_KEPT_ANSWERS = 3  # of each node


class MoteusProbe(CanProbe):
    """Probe that reads model, versions and serial number from every number that a controller can have."""

    fd = True

    def host(self, frames: Sequence[Frame]) -> str:
        """Describe a frame that only a host sends: one that requests an answer; empty if there is none."""
        for frame in frames:
            if isinstance(frame, FdFrame) and frame.identifier >> 16 == 0 and frame.identifier & REPLY_REQUESTED_BIT:
                return f"a command to the moteus at node {frame.identifier & 0x7F}"
        return ""

    def identifiers(self, address: int) -> Collection[int]:
        """Return the identifiers of frames to the node, from any source, and of its answers to the host."""
        return frozenset((*range(address, LAST_OF_11_BITS + 1, 0x100), identifier(address, HOST)))

    def ask(self, port: CanPort, addresses: Collection[int], taken: Collection[int]) -> Seen:
        """Ask every node for its identity."""
        answers: dict[int, list[bytes]] = {}
        for node in NODES:
            port.listen_fd(identifier(node, HOST), partial(_keep_answer, answers, node))
        try:
            for node in NODES:
                port.send_fd(identifier(HOST | REPLY_REQUESTED, node), pad(IDENTITY_QUERY.subframes))
                port.pump_until((False,), port.clock.now() + REQUEST_PERIOD_S)
            port.pump_until((False,), port.clock.now() + ANSWER_TIMEOUT_S)
        finally:
            for node in NODES:
                port.listen_fd(identifier(node, HOST), None)
        for node, frames in sorted(answers.items()):
            yield _sighting_of(node, frames)


def identity_of(values: Mapping[int, float]) -> Identity:
    """Return the identity of a controller from the registers of `IDENTITY_QUERY`."""
    model, firmware = int(values[Register.MODEL_NUMBER]), int(values[Register.FIRMWARE_VERSION])
    words = [int(values[Register.SERIAL_NUMBER + word]) for word in range(3)]
    serial = base64.b64encode(struct.pack(">3i", *words)).decode("ascii")
    return Identity(
        f"moteus, model 0x{model:04X}", serial, ".".join(str(firmware >> shift & 0xFF) for shift in (16, 8, 0))
    )


def _keep_answer(answers: dict[int, list[bytes]], node: int, data: bytearray, _timestamp: float) -> None:
    """Add a frame to the answers of its node."""
    answers_of_node = answers.setdefault(node, [])
    if len(answers_of_node) < MOST_KEPT_ANSWERS:
        answers_of_node.append(bytes(data))


def _sighting_of(node: int, frames: Sequence[bytes]) -> Sighting | str:
    """Return the sighting of a node from its answers; a text if they do not identify one controller."""
    if len(frames) > 1:
        return (
            f"node {node}: {len(frames)} answers to one question: two controllers have this number; connect one of them"
            " alone and give it another id.id"
        )
    try:
        values = parse(frames[0]).values
    except ValueError as error:
        return f"node {node}: its answer {error}"
    if not IDENTITY_QUERY.registers <= values.keys():
        return f"node {node}: does not tell who it is; a moteus with firmware of another kind?"
    identity, map_version = identity_of(values), int(values[Register.REGISTER_MAP_VERSION])
    if map_version != MAP_VERSION:
        return Sighting(node, identity, None, f"register map {map_version}; {MAP_VERSION} is known here")
    return Sighting(node, identity, {"node": node})
