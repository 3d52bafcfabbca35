"""A driver whose call never returns once a file is there; the product has no such hook, the harness registers it."""

import ctypes
import math
import time
from pathlib import Path

from leactl.driver.contract import Confirmation, Driver, DriverSettings, StreamSpec
from leactl.errors import DeviceError
from leactl.quantities import ChannelSpec

ENTRY_POINT = "[leactl.drivers]\nstuck = tests.kills.stuck:Stuck\n"
METADATA = "Metadata-Version: 2.1\nName: stuck\nVersion: 1.0\n"


class Settings(DriverSettings):
    """The file that makes it stuck; it says how."""

    trigger: str


class Stuck(Driver):
    """Measures nothing."""

    Settings = Settings
    transport = "none"
    summary = "gets stuck"

    def safe_state(self, deadline_s):
        return Confirmation(True, "measures only")

    def __init__(self, name, role, settings, port, clock):
        self.name, self._trigger = name, Path(settings.trigger)

    def open(self): ...

    def close(self): ...

    due = math.inf

    @staticmethod
    def tick(now): ...

    @classmethod
    def far_end(cls, settings, role, physics):
        return cls  # which has no time of its own to keep

    @property
    def streams(self):
        return (StreamSpec(self.name, (ChannelSpec("nothing", "line_voltage", "bench", self.name, "nothing"),)),)

    def take(self):
        if self._trigger.exists():
            how = self._trigger.read_text()
            if how == "failing":
                raise DeviceError(f"{self.name}: nothing answers")
            if how == "broken":
                raise ValueError("a mistake in a plug-in")
            while how == "sleeping":
                time.sleep(1000)
            while how == "spinning":
                pass
            while how == "holding the GIL":
                ctypes.PyDLL(None).sleep(1000)  # PyDLL keeps the lock for the whole call
        return ()


def register(directory: Path) -> None:
    """Make a distribution in this directory, which is to be on the path, that brings the driver."""
    folder = directory / "stuck-1.0.dist-info"
    folder.mkdir(exist_ok=True)
    (folder / "METADATA").write_text(METADATA)
    (folder / "entry_points.txt").write_text(ENTRY_POINT)
