"""One run to replay through one bench, and the results of the replay."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from leactl.effects.plant import Course, Plant
from leactl.gap.replay.time_steps import MOST_STEPS, servo_times, steps_in_sample
from leactl.gap.signals.record import Clocked, Key, Record
from leactl.gap.signals.rig import load_of

Array = npt.NDArray[np.float64]
SERVO_SUB_STEP = 0.02  # longest sub-step over a servo's shortest response time: back-EMF is then right to a percent


@dataclass
class Job:
    """A run, a bench, and the results of the replay as they are computed: current, temperatures, motion, readings."""

    record: Record
    plant: Plant
    disturbance: np.random.Generator | None = None  # draws noise for start and inputs; None for no noise
    tracked: bool = False  # whether a turning rotor is kept near its measured motion instead of restarting

    current: Array | None = None  # A, at the instants of the sub-steps
    current_mean: Array | None = None  # A, over each sub-step
    winding: Array | None = None  # degC, at the samples of the fast clock
    housing: Array | None = None  # degC
    angle: Array | None = None  # rad, at the instants
    velocity: Array | None = None  # rad/s, over each sub-step
    torque: Array | None = None  # N*m, onto the shaft, at the instants
    load_velocity: Array | None = None  # rad/s, over each sub-step
    pull: Array | None = None  # N*m, torque that keeps a tracked rotor near its motion, at the instants
    starts: npt.NDArray[np.intp] | None = None  # samples at which the motion restarts
    first: int = 0  # sample at which the motion starts
    fast: dict[Key, Array] = field(default_factory=dict)  # readings of the fast clock's channels
    slow: dict[Key, Array] = field(default_factory=dict)
    at_ceiling: int = 0  # samples at the voltage ceiling, where the measured current is used
    restarts: bool = False  # whether the motion restarts every second
    notes: list[str] = field(default_factory=list)

    @property
    def clock(self) -> Clocked:
        """Fast clock of the run, which must have one."""
        assert self.record.fast is not None
        return self.record.fast

    @property
    def parts(self) -> int:
        """Sub-steps in a sample."""
        if not self.by_servo:
            return steps_in_sample(self.plant.model.bench, self.clock.interval)
        return max(1, int(np.ceil(self.clock.interval / self._longest_step() - 1e-6)))

    def _longest_step(self) -> float:
        """Return the longest sub-step [s] for a servo's response times."""
        model, gain = self.plant.model, self.record.setup.get("drive_gain")
        assert model.drive is not None
        load = load_of(self.record, model).inertia
        shortest, _ = servo_times(model, np.array([model.drive.gain if gain is None else gain]), load, load)
        return min(max(SERVO_SUB_STEP * shortest, self.clock.interval / MOST_STEPS), self.clock.interval)

    @property
    def by_servo(self) -> bool:
        """Whether the model's position servo drives the run."""
        return self.plant.model.drive is not None and self.clock.get("angle_reference") is not None

    @property
    def step(self) -> float:
        """Length of a sub-step [s]."""
        return self.clock.interval / self.parts

    def course(self) -> Course:
        """Return times and housing temperatures of the run, for effects that act before its motion is known."""
        time = self.clock.since_begin
        zeros = np.zeros_like(time)
        housing = self.housing if self.housing is not None else zeros + self.plant.model.reference_temperature
        return Course(time, self.clock.interval, zeros, housing)
