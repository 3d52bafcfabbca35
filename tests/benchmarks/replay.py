"""A CAN bus that plays two emulated drives' answers again, so that neither emulator nor plant is part of a timing.

It is as cheap as a python-can bus can be: frames wait in a queue of this process, and python-can's own `recv` takes
them from there, as it does for every real interface.
"""

from collections import deque
from collections.abc import Sequence

import can

from leactl.driver.clock import Clock
from leactl.driver.far_end import Frame
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.emulation.wires.buses import EmulatedCanBus

SYNC = 0x080
NODES = (1, 2)
ENABLED = bytes.fromhex("3706")  # statusword 0x0637, as a PDO begins
HEARTBEAT_EVERY = 50  # cycles of 1 ms
VOLTAGE_REQUEST, VOLTAGE_ANSWER = bytes.fromhex("4079600000000000"), bytes.fromhex("43796000a0730000")  # 29.6 V


class ReplayBus(can.BusABC):
    """Answers each SYNC with the same frames, and requests of the bus voltage; heartbeats come where there are any."""

    def __init__(self, answers: list[Frame], heartbeats: Sequence[Frame] = ()) -> None:
        self.answers, self.heartbeats = answers, heartbeats
        self.arrived: deque[Frame] = deque()
        self._cycles = 0
        super().__init__(channel="replay")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        identifier = msg.arbitration_id
        if identifier == SYNC:
            self.arrived.extend(self.answers)
            self._cycles += 1
            if self._cycles % HEARTBEAT_EVERY == 0:
                self.arrived.extend(self.heartbeats)
        elif identifier >= 0x600 and msg.data == VOLTAGE_REQUEST:
            self.arrived.append(Frame(identifier - 0x80, VOLTAGE_ANSWER))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self.arrived:
            return None, False
        identifier, data = self.arrived.popleft()
        return can.Message(arbitration_id=identifier, is_extended_id=False, data=data), False


class RehearsedBus(ReplayBus):
    """Leads to emulated drives until both carry the current demanded of them, and plays those answers from then on.

    What is demanded may swing afterwards as far as the interlock on current against its demand lets it.
    """

    replay = ReplayBus.send

    def __init__(self, machine: EmulatedBench, host: Clock) -> None:
        super().__init__([], [Frame(0x700 + node, b"\x05") for node in NODES])
        self._machine, self._host = machine, host
        self._wire = EmulatedCanBus(machine.wires["can0"])
        self._demanded: dict[int, int] = {}  # by node, thousandths of the rated current

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._machine.clock.sleep_until(self._host.now())
        if msg.arbitration_id - 0x200 in NODES:
            self._demanded[msg.arbitration_id - 0x200] = int.from_bytes(msg.data[2:4], "little", signed=True)
        self._wire.send(msg)
        answers = list(self._wire.arrived)
        self._wire.arrived.clear()
        self.arrived.extend(answers)
        if msg.arbitration_id == SYNC and sum(map(self._carries_its_demand, answers)) == len(NODES):
            self.answers = [frame for frame in answers if 0x180 <= frame.identifier < 0x500]
            self._wire.shutdown()
            self.send = self.replay  # type: ignore[method-assign]  # nothing of the rehearsal is timed

    def _carries_its_demand(self, frame: Frame) -> bool:
        """Whether a frame is TPDO 1 (statusword, mode, torque, current) of a drive in operation at its torque."""
        demand = self._demanded.get(frame.identifier - 0x180, 0)
        if not demand or not frame.data.startswith(ENABLED):
            return False
        return abs(int.from_bytes(frame.data[3:5], "little", signed=True) - demand) <= 0.05 * abs(demand)
