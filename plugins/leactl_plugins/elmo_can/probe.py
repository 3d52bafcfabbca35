"""Recognise CANopen nodes, and Elmo's among them, by SDO uploads alone: nothing is written, no NMT or SYNC is sent."""

import struct
from collections.abc import Collection, Sequence
from functools import partial

from leactl.driver.can_port import NMT_ID, SYNC_ID, CanPort
from leactl.driver.far_end import Frame
from leactl.driver.probe import CanProbe, Seen, Sighting
from leactl.errors import NoAnswer
from leactl_plugins.elmo_can.commissioning import identity_of, read_optional_u32
from leactl_plugins.elmo_can.sdo import Sdo
from leactl_plugins.elmo_can.settings import NODES, ElmoSettings, identifiers_of

REQUEST, ANSWER, HEARTBEAT = 0x600, 0x580, 0x700  # identifiers, to which the number of the node is added
HEARTBEAT_STATES = (0x00, 0x04, 0x05, 0x7F)
READ_DEVICE_TYPE = bytes.fromhex("4000100000000000")  # 0x1000:0, which every node has
UPLOADED, ABORTED = 0x43, 0x80  # first byte of an answer with four bytes, or of a refusal
REQUEST_COMMANDS = (0x40, 0x21, 0x22, 0x23, 0x27, 0x2B, 0x2F)  # first byte of a client's request
FIRST_OBJECT = 0x1000  # lowest index of an object (CiA 301)
REQUEST_PERIOD_S = 0.003  # time from one node to the next; request and answer take 2.2 ms at 125 kbit/s
ANSWER_TIMEOUT_S = 0.5  # of an SDO, and of all answers after the last request
MOST_KEPT_ANSWERS = 3  # frames of each node
MOST_SHOWN_BYTES = 8  # of a frame in a message


class ElmoProbe(CanProbe):
    """Probe that uploads the device type from every node, then the identity from those that answer."""

    def heard(self, frames: Sequence[Frame]) -> Collection[int]:
        """Return the nodes that sent a heartbeat or a boot-up message."""
        return {
            frame.identifier - HEARTBEAT
            for frame in frames
            if frame.identifier - HEARTBEAT in NODES and len(frame.data) == 1 and frame.data[0] in HEARTBEAT_STATES
        }

    def host(self, frames: Sequence[Frame]) -> str:
        """Describe a frame that only a host sends (SYNC, network management, SDO request); empty if there is none."""
        for identifier, data in frames:
            if identifier == SYNC_ID and len(data) <= 1:
                return "CANopen's SYNC"
            if identifier == NMT_ID and len(data) == 2:
                return "a command of CANopen's network management"
            if identifier - REQUEST in NODES and len(data) == 8 and data[0] in REQUEST_COMMANDS:
                (index,) = struct.unpack_from("<H", data, 1)
                if index >= FIRST_OBJECT:
                    return f"an SDO request to node {identifier - REQUEST}"
        return ""

    def identifiers(self, address: int) -> Collection[int]:
        """Return the CAN identifiers that CiA 301 assigns to a node, and those of network management and SYNC."""
        return identifiers_of(address)

    def ask(self, port: CanPort, addresses: Collection[int], taken: Collection[int]) -> Seen:
        """Ask every node for its device type, and those that answer for their identity."""
        unasked_nodes = [node for node in NODES if REQUEST + node in taken]
        if unasked_nodes:
            yield f"the nodes {_listed(unasked_nodes)} were not asked by SDO: another device acts on these identifiers"
        answers = _sweep(port, [node for node in NODES if node not in unasked_nodes])
        answering_nodes = [node for node, frames in answers.items() if any(map(_is_answer, frames))]
        settings = ElmoSettings.model_fields
        host, vendor = settings["host_node"].default, settings["vendor_id"].default
        extra_settings: dict[str, int] = {}
        if host in answering_nodes:  # the node's heartbeat would be taken for the host's
            extra_settings = {"host_node": max(set(NODES) - set(answering_nodes))}
        for node, frames in sorted(answers.items()):
            valid_answers = [data for data in frames if _is_answer(data)]
            for data in frames:
                if not _is_answer(data):
                    frame_text = data[:MOST_SHOWN_BYTES].hex(" ") or "no byte"
                    yield f"node {node}: sent {frame_text} after an upload of 0x1000:0; garbled, or another host's"
            if len(valid_answers) > 1:
                yield (
                    f"node {node}: {len(valid_answers)} answers to one question: two devices have this number; connect"
                    " one of them alone and give it another"
                )
            elif valid_answers:
                yield _identify(port, node, vendor, extra_settings)
        for node in sorted(set(addresses) - set(answers) - set(unasked_nodes)):
            yield f"node {node}: sends heartbeats and answers no SDO: is it stopped, or another host?"


def _sweep(port: CanPort, nodes: Sequence[int]) -> dict[int, list[bytes]]:
    """Ask each node for its device type; return the first frames of the nodes that sent any."""
    answers: dict[int, list[bytes]] = {}

    def keep_answer(node: int, data: bytearray, _timestamp: float) -> None:
        answers_of_node = answers.setdefault(node, [])
        if len(answers_of_node) < MOST_KEPT_ANSWERS:
            answers_of_node.append(bytes(data))

    for node in nodes:
        port.listen(ANSWER + node, partial(keep_answer, node))
    try:
        for node in nodes:
            port.send(REQUEST + node, READ_DEVICE_TYPE)
            port.pump_until((False,), port.clock.now() + REQUEST_PERIOD_S)
        port.pump_until((False,), port.clock.now() + ANSWER_TIMEOUT_S)
    finally:
        for node in nodes:
            port.listen(ANSWER + node, None)
    return answers


def _is_answer(data: bytes) -> bool:
    """Return whether a node has answered the upload of its device type: by a value, or by a refusal."""
    return len(data) == 8 and data[0] in (UPLOADED, ABORTED) and data[1:4] == READ_DEVICE_TYPE[1:4]


def _identify(port: CanPort, node: int, elmo_vendor: int, extra_settings: dict[str, int]) -> Sighting | str:
    """Read the identity of a node, and return its sighting, or a text if it does not answer."""
    sdo = Sdo(port, node, ANSWER_TIMEOUT_S)
    port.listen(ANSWER + node, sdo.on_frame)
    try:
        vendor, product, revision = (read_optional_u32(sdo, 0x1018, sub) for sub in (1, 2, 3))
        identity = identity_of(sdo)
    except NoAnswer as error:
        return f"{error}, although it answered before"
    finally:
        port.listen(ANSWER + node, None)
    numbers = (("vendor", vendor), ("product", product), ("revision", revision))
    detail = ", ".join(f"{label} 0x{value:08X}" for label, value in numbers if value is not None)
    if vendor != elmo_vendor:
        return Sighting(node, identity, None, f"CANopen, {detail or 'no identity object'}; not Elmo's")
    return Sighting(node, identity, {"node": node, **extra_settings}, detail)


def _listed(nodes: Sequence[int]) -> str:
    """Return the numbers of nodes as text."""
    return ", ".join(map(str, nodes))
