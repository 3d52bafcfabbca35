"""Watch the power of emulated drives during a drill, on the emulated plant and not by the reports of its devices."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leactl.emulation.bench.emulated_bench import EmulatedBench


class DrivePowerWatch:
    """Notes during one run since when no drive of an emulated bench has had power."""

    def __init__(self) -> None:
        self.run_start = self.last_cycle = 0.0  # s on the bench's clock; the caller sets both
        self.unpowered_since: float | None = None  # s on the bench's clock; None while any drive has power
        self._bench: EmulatedBench | None = None

    @property
    def bench(self) -> "EmulatedBench":
        """The bench that is watched."""
        assert self._bench is not None
        return self._bench

    def see(self, bench: "EmulatedBench") -> None:
        """Begin to watch a bench; call once, before its time passes."""
        self._bench = bench
        bench.time.follow(self._update)

    def powered(self, role: str) -> bool:
        """Return whether the drive of a role is switched on or current flows in its motor."""
        actuator = self.bench.rig.actuators[role]
        return actuator.mode != "off" or actuator.current_true != 0.0

    def _update(self, now: float) -> None:
        """Set `unpowered_since` to this time [s] once no drive has power, and to None while any drive has."""
        if any(self.powered(role) for role in self.bench.rig.actuators):
            self.unpowered_since = None
        elif self.unpowered_since is None:
            self.unpowered_since = now

    def end(self) -> None:
        """Update once more after the run, because the clock calls `_update` only when time passes."""
        self._update(self.bench.time.now())
