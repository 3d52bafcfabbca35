"""What the emulated bench itself shows of a run: whether its drives have power, whatever is said of them."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leactl.emulation.bench.emulated_bench import EmulatedBench


class DrillPlant:
    """The emulated bench of one run: when each cycle began, and since when no drive has had power."""

    def __init__(self) -> None:
        self.began = self.cycle = 0.0  # on the bench's own clock [s], of the run and of its last cycle
        self.without_power: float | None = None
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
            self.without_power = None
        elif self.without_power is None:
            self.without_power = now

    def end(self) -> None:
        """The run is over, no time has passed since the last device was made safe."""
        self._look(self.bench.time.now())
