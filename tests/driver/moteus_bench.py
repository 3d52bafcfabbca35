"""A moteus controller at the host's wire, on a shaft that does as it is told."""

from leactl_plugins.moteus_can.driver import MoteusCan
from leactl_plugins.moteus_can.emulator import MoteusEmulator
from leactl_plugins.moteus_can.settings import MoteusSettings

from leactl.driver.can_port import CanPort
from leactl.driver.far_end import Frame

from .elmo_bench import Tap
from .failing import Shaft
from .transports import CanInProcess

NODE = 1
CONSTANT = 0.6  # N*m per A of amplitude
PERIOD_S = 0.005
TO_DRIVE, FROM_DRIVE = 0x8001, 0x0100


class MoteusBench:
    """One controller; `tape` has what the host sent."""

    def __init__(self, **settings):
        wire = CanInProcess()
        self.wire, self.clock, self.shaft = wire.wire, wire.clock, Shaft()
        self.tape: list[Frame] = []
        self.far = MoteusEmulator(NODE, self.shaft, torque_constant=CONSTANT)
        self.wire.attach(self.far)
        self.port = CanPort(lambda: Tap(wire.connect(), self.tape), self.clock)
        checked = MoteusSettings(node=NODE, **settings)
        self.drive = MoteusCan("drive", "test", checked, self.port, self.clock)

    def cycle(self, feed=True):
        began = self.clock.now()
        self.drive.begin_cycle()
        self.drive.end_cycle(began + 0.6 * PERIOD_S)
        if feed:
            self.drive.feed()
        self.clock.sleep_until(began + PERIOD_S)
        return list(self.drive.values)

    def cycles(self, seconds, feed=True):
        return [self.cycle(feed) for _ in range(round(seconds / PERIOD_S))]

    def engage(self, mode):
        self.drive.engage(mode)
        for _ in range(400):
            self.cycle()
            if self.drive.engaged:
                return
        raise AssertionError("not engaged within two seconds")

    def commands(self):
        """Frames that told the controller to follow a position, the number of the question left out."""
        return [frame.data for frame in self.tape if frame.identifier == TO_DRIVE and frame.data[:3] == b"\x01\x00\x0a"]
