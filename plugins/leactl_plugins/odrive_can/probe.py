"""Recognise ODrives by their heartbeats, and ask those that sent one for their version."""

from collections.abc import Collection, Sequence
from functools import partial

from leactl.driver.can_port import SYNC_ID, CanPort
from leactl.driver.contract import Identity
from leactl.driver.far_end import Frame
from leactl.driver.probe import CanProbe, Seen, Sighting
from leactl_plugins.odrive_can.can_simple import (
    ERRORS,
    HEARTBEAT,
    NODE_SHIFT,
    PROTOCOL,
    REPEATED_QUERIES,
    VERSION,
    Command,
    hardware_and_firmware,
    identifiers_of,
)

LAST_NODE = 62  # 63 stands for a drive without a node
STATES = range(1, 15)  # of an axis in heartbeats (firmware 0.6)
KNOWN_ERRORS = sum(ERRORS)
HOST_COMMANDS = (
    Command.RX_SDO,
    Command.SET_AXIS_STATE,
    Command.SET_CONTROLLER_MODE,
    Command.SET_INPUT_POS,
    Command.SET_INPUT_VEL,
    Command.SET_INPUT_TORQUE,
)
ANSWER_TIMEOUT_S = 0.2  # always waited for in full: a second drive may answer too
MOST_KEPT_ANSWERS = 3  # of each node


class OdriveProbe(CanProbe):
    """Probe that asks only nodes that were heard: a query has an identifier that CANopen gives to commands."""

    searches = False

    def heard(self, frames: Sequence[Frame]) -> Collection[int]:
        """Return the nodes that sent a heartbeat."""
        return {frame.identifier >> NODE_SHIFT for frame in frames if _is_heartbeat(frame)}

    def host(self, frames: Sequence[Frame]) -> str:
        """Describe a frame that only a host sends: a command to a node with heartbeats; empty if there is none."""
        nodes = self.heard(frames)
        for identifier, data in frames:
            node, command = identifier >> NODE_SHIFT, identifier & (1 << NODE_SHIFT) - 1
            if node in nodes and command in HOST_COMMANDS and data:
                return f"a command to the ODrive at node {node}"
        return ""

    def identifiers(self, address: int) -> Collection[int]:
        """Return the 32 identifiers of the node."""
        return identifiers_of(address)

    def ask(self, port: CanPort, addresses: Collection[int], taken: Collection[int]) -> Seen:
        """Ask the nodes that were heard for their version."""
        for node in sorted(addresses):
            query = node << NODE_SHIFT | Command.GET_VERSION
            if query | Command.HEARTBEAT in taken:
                yield f"node {node}: what may be an ODrive's heartbeat has an identifier of another device; not asked"
                continue
            if query == SYNC_ID or query in taken:
                yield _sighting_unasked(node)
                continue
            answers: list[bytes] = []
            port.listen(query, partial(_keep_answer, answers))
            try:
                _ask_once(port, query)
                for _ in range(REPEATED_QUERIES):
                    if len(answers) < 2 or len(set(answers)) > 1:
                        break
                    del answers[:]  # a frame may have come twice, but a second drive answers every query
                    _ask_once(port, query)
            finally:
                port.listen(query, None)
            yield _sighting_of(node, answers)


def _ask_once(port: CanPort, query: int) -> None:
    """Send a query, and let answers arrive until the time-out."""
    port.send(query, b"")
    port.pump_until((False,), port.clock.now() + ANSWER_TIMEOUT_S)


def _is_heartbeat(frame: Frame) -> bool:
    """Return whether a frame is an ODrive's heartbeat with known errors and a known state."""
    identifier, data = frame
    if identifier & (1 << NODE_SHIFT) - 1 != Command.HEARTBEAT or identifier >> NODE_SHIFT > LAST_NODE:
        return False
    if len(data) != HEARTBEAT.size:
        return False
    errors, state, _result, trajectory_ended, _reserved = HEARTBEAT.unpack(data)
    return not errors & ~KNOWN_ERRORS and state in STATES and trajectory_ended <= 1


def _keep_answer(answers: list[bytes], data: bytearray, _timestamp: float) -> None:
    if len(answers) < MOST_KEPT_ANSWERS:
        answers.append(bytes(data))


def _sighting_unasked(node: int) -> Sighting:
    """Return the sighting of a node that was not asked for its version."""
    reason = "its version was not asked for: to CANopen devices that question is a command"
    return Sighting(node, Identity("ODrive"), {"node": node}, f"heard by its heartbeat; {reason}")


def _sighting_of(node: int, answers: Sequence[bytes]) -> Sighting | str:
    """Return the sighting of a node from its answers; a text if they do not identify one ODrive."""
    if not answers:
        return f"node {node}: sends an ODrive's heartbeats and does not tell its version"
    if len(answers) > 1:
        return (
            f"node {node}: {len(answers)} answers to one question: two drives have this node; connect one of them alone"
            " and give it another"
        )
    if len(answers[0]) != VERSION.size:
        return f"node {node}: tells its version by {answers[0].hex(' ') or 'no byte'}; 8 bytes were expected"
    version = VERSION.unpack(answers[0])
    hardware, firmware = hardware_and_firmware(version)
    identity = Identity(f"ODrive {hardware}", "", firmware)
    if version[0] != PROTOCOL:
        return Sighting(node, identity, None, f"protocol {version[0]}; {PROTOCOL} of firmware 0.6 is known here")
    return Sighting(node, identity, {"node": node}, "endpoints: the maker's flat_endpoints.json of that firmware")
