"""Watch an emulated bench during a drill: since when no drive has had power, whatever its devices report."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leactl.emulation.bench.emulated_bench import EmulatedBench


class DrivePowerWatch:
    """The emulated bench of one run: when each cycle began, and since when no drive has had power."""

    def __init__(self) -> None:
        self.began = self.cycle = 0.0  # on the bench's own clock [s], of the run and of its last cycle
        self.unpowered_since: float | None = None  # s on the bench's clock; None while any drive has power
        self._bench: EmulatedBench | None = None

    @property
    def bench(self) -> "EmulatedBench":
        """The bench itself."""
        assert self._bench is not None
        return self._bench

    def see(self, bench: "EmulatedBench") -> None:
        """Watch a bench that has just been made."""
        self._bench = bench
        bench.time.follow(self._look)

    def powered(self, role: str) -> bool:
        """Whether a drive lets current flow."""
        actuator = self.bench.rig.actuators[role]
        return actuator.mode != "off" or actuator.current_true != 0.0

    def _look(self, now: float) -> None:
        if any(self.powered(role) for role in self.bench.rig.actuators):
            self.unpowered_since = None
        elif self.unpowered_since is None:
            self.unpowered_since = now

    def end(self) -> None:
        """The run is over, no time has passed since the last device was made safe."""
        self._look(self.bench.time.now())
