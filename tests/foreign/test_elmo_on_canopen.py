"""The Elmo driver at a node of canopen's, and canopen's own CiA 402 master at the emulated Elmo."""

import itertools
import math

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from leactl_plugins.elmo_can.driver import ElmoCan
from leactl_plugins.elmo_can.settings import ElmoSettings

from leactl.bench.benchfile import CanBus
from leactl.bench.wiring import MachineWiring
from leactl.driver.can_port import CanPort
from leactl.driver.clock import MonotonicClock
from leactl.driver.contract import Identity, Mode
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.wires.buses import CanWire
from leactl.emulation.wires.serving import CanBridge
from leactl.errors import DeviceError, DeviceFault
from tests.driver.failing import FailingDrive

from .canopen_drive import COUNTS, RATED_MA, CanopenDrive, dictionary
from .serving import served

CHANNELS = (f"foreign-{number}" for number in itertools.count())
PATIENT = {"consumer_heartbeat_ms": 1000, "producer_heartbeat_ms": 200, "sdo_timeout_s": 1.0}
ANSWER_S = 5.0  # that is waited for only where nothing comes
NAME = "Gold Twitter of another hand"
PER_MILLE = RATED_MA * 1e-6 * math.sqrt(1.5)  # q-axis current [A] of one per mille of the rated one, an amplitude


class Meeting:
    """The driver and the node of another hand at one bus."""

    def __init__(self, lacks=(), **settings):
        self.clock, channel = MonotonicClock(), next(CHANNELS)
        self.far = CanopenDrive(channel, lacks=lacks)
        connect = MachineWiring().can("can0", CanBus(kind="can", interface="virtual", channel=channel))
        self.port = CanPort(connect, self.clock)
        checked = ElmoSettings(**({"node": 1, "counts_per_turn": COUNTS} | PATIENT | settings))
        self.drive = ElmoCan("drive", "test", checked, self.port, self.clock)

    def cycle(self, answer_s=ANSWER_S):
        """One SYNC, and what the drive answers."""
        self.drive.begin_cycle()
        self.port.sync()
        self.drive.end_cycle(self.clock.now() + answer_s)
        self.drive.feed()
        return dict(zip((channel.quantity for channel in self.drive.loop_channels), self.drive.values, strict=True))

    def engage(self, mode):
        """Go on until the drive is in operation."""
        self.drive.engage(mode)
        while not self.drive.engaged:
            self.cycle()


@pytest.fixture
def meet():
    """Let a driver and a node meet; both leave at the end."""
    made = []

    def meet(*arguments, **settings):
        made.append(Meeting(*arguments, **settings))
        return made[-1]

    yield meet
    for meeting in made:
        meeting.drive.close()
        meeting.far.close()


def test_a_node_of_another_hand_is_identified_set_up_and_started(meet):
    at = meet()
    at.drive.open()
    assert at.drive.identity() == Identity(
        "Gold Twitter of another hand, hardware 7.3", "2718281", "Twitter 01.01.17.00"
    )
    assert [at.far.get(index) for index in (0x60B0, 0x60B1, 0x60B2)] == [0, 0, 0]
    assert at.far.get(0x1016, 1) == 126 << 16 | 1000
    at.cycle()
    assert (at.far.get(0x1017), at.far.node.nmt.state) == (200, "OPERATIONAL")
    mapped = {pdo.cob_id: [item.name for item in pdo.map] for pdo in at.far.heard}
    assert mapped == {
        0x201: ["Controlword", "Target torque", "Modes of operation"],
        0x301: ["Target position", "Target velocity"],
    }


def test_a_current_arrives_as_it_was_asked_and_comes_back(meet):
    at = meet()
    at.drive.open()
    at.engage(Mode.CURRENT)
    assert at.far.words == [0x00, 0x06, 0x07, 0x0F]
    at.drive.command(2.45)
    at.cycle()
    read = at.cycle()
    assert at.far.get(0x6071) == round(2.45 / PER_MILLE) == 200
    assert read["q_axis_current"] == pytest.approx(200 * PER_MILLE)
    at.far.set(0x6064, -COUNTS // 4)
    at.far.set(0x606C, COUNTS)
    read = at.cycle()
    assert (read["angle"], read["velocity"]) == pytest.approx((-math.pi / 2, 2 * math.pi))


def test_it_is_made_safe_and_says_so_itself(meet):
    at = meet()
    at.drive.open()
    at.engage(Mode.CURRENT)
    confirmed = at.drive.safe_state(2.0)
    assert (confirmed.safe, at.far.words[-1]) == (True, 0x00)


def test_its_emergency_ends_the_run_with_its_name(meet):
    at = meet()
    at.drive.open()
    at.engage(Mode.CURRENT)
    at.far.fail(0x2310)
    with pytest.raises(DeviceFault, match="0x2310"):
        at.cycle()
        at.cycle()


def test_a_node_that_is_reset_by_somebody_is_noticed(meet):
    at = meet()
    at.drive.open()
    at.engage(Mode.CURRENT)
    at.far.reset()
    with pytest.raises(DeviceError, match="boot-up"):
        at.cycle(answer_s=0.1)


def test_what_the_node_aborts_is_told_with_the_abort_code(meet):
    at = meet(lacks=(0x1016,))
    with pytest.raises(DeviceError, match=r"0x1016:1 refused, abort 0x06020000"):
        at.drive.open()


def test_a_node_without_optional_objects_is_met(meet):
    at = meet(lacks=(0x6502, 0x607E, 0x608F, 0x6091, 0x6092, 0x607B, 0x1009))
    at.drive.open()
    at.engage(Mode.VELOCITY)
    assert at.drive.identity().model == NAME


def test_counts_that_contradict_the_bench_file_are_refused_with_both(meet):
    at = meet(counts_per_turn=40000)
    with pytest.raises(DeviceError, match=r"4096.*40000|40000.*4096"):
        at.drive.open()


# -- the emulated Elmo, at a master of canopen's -----------------------------------------------------------------------


@pytest.fixture
def emulated():
    """An emulated Elmo on a virtual bus, served by a thread; its channel and the drive."""
    channel, clock = next(CHANNELS), EmulatedClock()
    wire = CanWire(clock)
    drive = FailingDrive(wire, 1)
    with served(CanBridge("", can.Bus(channel=channel, interface="virtual"), wire), clock):
        yield channel, drive


@pytest.fixture
def master(emulated):
    """canopen's master of CiA 402 at the emulated Elmo."""
    network = canopen.Network()
    network.connect(interface="virtual", channel=emulated[0])
    node = BaseNode402(1, dictionary())
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = node.TIMEOUT_CHECK_TPDO = ANSWER_S
    node.TIMEOUT_SWITCH_STATE_SINGLE = node.TIMEOUT_SWITCH_STATE_FINAL = 2 * ANSWER_S
    yield node
    node.rpdo[1].stop()
    network.sync.stop()
    network.disconnect()


def test_canopen_reads_the_emulated_drive(master):
    assert master.sdo[0x1008].raw == "Gold DC Whistle"
    assert (master.sdo[0x1018][1].raw, master.sdo[0x6075].raw, master.sdo[0x60C2][2].raw) == (0x9A, 11186, -3)
    with pytest.raises(canopen.SdoAbortedError) as refused:
        master.sdo[0x6041].raw = 1
    assert refused.value.code == 0x06010002


def test_canopen_brings_the_emulated_drive_into_operation(master, emulated):
    fill_map(master.rpdo[1], ((0x6040, 16), (0x6071, 16), (0x6060, 8)))
    fill_map(master.rpdo[2], ())
    fill_map(master.tpdo[1], ((0x6041, 16), (0x6061, 8), (0x6077, 16)))
    master.nmt.state = "OPERATIONAL"
    master.setup_402_state_machine(read_pdos=True)
    master.rpdo[1].start(0.01)
    master.network.sync.start(0.01)
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
        master.state = state
        assert master.state == state
    master.rpdo[1][0x6060].raw, master.rpdo[1][0x6071].raw = 10, 250
    while (master.tpdo[1][0x6061].raw, master.tpdo[1][0x6077].raw) != (10, 250):
        assert master.tpdo[1].wait_for_reception(ANSWER_S) is not None
    mode, current = emulated[1].shaft.following
    assert (mode, current) == ("current", pytest.approx(250 * 11186e-6 * math.sqrt(1.5)))
    master.state = "SWITCH ON DISABLED"
    assert emulated[1].shaft.following[0] == "off"


def fill_map(pdo, objects):
    """Map these objects, or none, by canopen's own order of SDO transfers."""
    pdo.read()
    pdo.clear()
    for index, bits in objects:
        pdo.add_variable(index, 0, bits)
    pdo.trans_type, pdo.enabled = 1, bool(objects)
    pdo.save()
