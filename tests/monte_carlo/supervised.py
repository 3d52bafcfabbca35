"""One protocol on the direct bench under the real supervisor, guard and control loop, and what became of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from leactl.bench import benchfile
from leactl.driver.contract import Mode
from leactl.protocol.plan import Plan
from leactl.runner.channel_limits import ChannelLimits
from leactl.runner.flushing import Recording
from leactl.runner.loop import Loop
from leactl.runner.operators import confirm_at_once
from leactl.runner.progress import Progress
from leactl.runner.stop_requests import OperatorInput, RunControl, StopRequest
from leactl.runner.thermal_admission import guard_settings, motors_of
from leactl.runner.watchdog import NoWatchdog
from leactl.safety.current_tracking import VoltageNeed
from leactl.safety.supervisor import Axis, Supervisor
from leactl.safety.thermal.box import Array
from leactl.safety.thermal.guard import GuardSettings, ThermalGuard
from leactl.safety.witnesses import SENSED_ROLES, TorqueModel
from tests.monte_carlo.direct import DirectBench, Fault, Killed
from tests.monte_carlo.plants import LEA, Truth
from tests.monte_carlo.rotors import CONSUMER_S

AFTER_S = CONSUMER_S + 0.3  # looked on after the end, by which every drive's dead-man has acted
SCALED = "is scaled down"
MakeGuard = Callable[[Mapping, GuardSettings, Mapping[str, Array]], ThermalGuard]


@cache
def shipped() -> tuple[benchfile.BenchFile, GuardSettings]:
    """The emulated bench's limits and interlocks, and what its guard is told."""
    file, devices, _ = benchfile.load("emulated")
    return file, guard_settings(file, devices, motors_of(file))


@dataclass(frozen=True)
class Course:
    """A run as it went."""

    status: str
    reason: str
    scaled: bool
    energised: list[str]
    currents: tuple[Array, Array]  # true, of each tick, test and load
    velocity: Array
    coupled: bool
    kept: Mapping[str, Array]  # the guard's last bounds


class NoFile:
    """Takes what a run's file and its flush would."""

    free_bytes = float("inf")

    def append_row(self, stream: str, time: float, values: object) -> None:
        """Nothing is kept."""

    def event(self, time: float, level: str, source: str, message: str) -> None:
        """Nothing is kept."""

    def step(self, *_what: object) -> None:
        """Nothing is kept."""

    def warnings(self) -> list[str]:
        """None."""
        return []

    def notes(self) -> list[str]:
        """None."""
        return []

    def after_cycle(self) -> None:
        """Nothing is kept."""


class Unsupervised:
    """What a plan does where nothing interferes: the loop's side of a supervisor that lets everything pass."""

    windings: tuple[dict, dict] = ({}, {})
    time_left = dict[str, float]  # an empty one

    def __init__(self, bench: DirectBench) -> None:
        self._drives, self.warnings = bench.drives, []

    def begin(self, period: float) -> None:
        """Nothing is judged."""

    def engage(self, role: str, mode: Mode) -> None:
        """Pass it on."""
        self._drives[role].engage(mode)

    def release(self, role: str) -> None:
        """Pass it on."""
        self._drives[role].release()

    def engaged(self, role: str) -> bool:
        """Ask the drive."""
        return self._drives[role].engaged

    def command(self, role: str, value: float) -> None:
        """Pass it on."""
        self._drives[role].command(value)

    def check(self, now: float) -> None:
        """Nothing is judged."""

    def receive(self, row: object) -> None:
        """Nothing is judged."""

    def free_space(self, free_bytes: float) -> None:
        """Nothing is judged."""

    def take_warnings(self) -> list[str]:
        """None."""
        return []

    def latch(self, cause: str) -> None:
        """Nothing latches."""


def run(
    plan: Plan,
    truth: Truth,
    fault: Fault | None,
    start: Mapping[str, Array],
    seed: int,
    guard_of: MakeGuard = ThermalGuard,
) -> Course:
    """Run a plan as `leactl run` would, from bounds of the windings [degC]."""
    file, settings = shipped()
    bench = DirectBench(truth, plan.setup, fault, seed)
    guard = guard_of(motors_of(file), settings, start)
    axes = {role: Axis(drive, drive) for role, drive in bench.drives.items()}
    supervisor = Supervisor(
        file.limits,
        axes,
        [bench.sensor],
        bench.clock,
        guard,
        file.interlocks,
        dict.fromkeys(SENSED_ROLES.get(plan.setup, ()), TorqueModel.of(LEA)),
        dict.fromkeys(axes, VoltageNeed(LEA.back_emf_constant, LEA.resistance(LEA.limits.winding_temperature))),
    )
    status, reason, warnings = _loop(plan, bench, supervisor)
    bench.time.sleep_until(bench.time.now() + AFTER_S)
    scaled = any(SCALED in text for text in warnings)
    return _course(bench, status, reason, scaled, guard.node_bounds)


def run_free(plan: Plan, truth: Truth, seed: int) -> Course:
    """Run a plan to its end, whatever becomes of the windings."""
    bench = DirectBench(truth, plan.setup, None, seed)
    status, reason, _ = _loop(plan, bench, Unsupervised(bench))
    if status != "complete":
        raise AssertionError(f"nothing interferes, and yet the run {status}: {reason}")
    return _course(bench, status, reason, False, {})


def _loop(plan: Plan, bench: DirectBench, supervisor: Supervisor | Unsupervised) -> tuple[str, str, list[str]]:
    nothing = NoFile()
    progress = Progress(plan.name, plan.duration_s, bench.streams())
    limits = ChannelLimits((), bench.streams(), bench.file.name)
    control = RunControl(StopRequest(), OperatorInput(), confirm_at_once)
    recording = Recording(nothing, nothing, progress, limits)  # type: ignore[arg-type]
    loop = Loop(plan, bench, supervisor, NoWatchdog(), control, recording)  # type: ignore[arg-type]
    status, reason = "complete", ""
    try:
        loop.run()
    except Killed:
        return "killed", "", progress.warnings
    except Exception as error:
        from leactl.errors import SafetyTrip

        status = "tripped" if isinstance(error, SafetyTrip) else "failed"
        reason = str(error) or type(error).__name__
    if isinstance(supervisor, Supervisor):
        supervisor.make_safe()
    return status, reason, progress.warnings


def _course(bench: DirectBench, status: str, reason: str, scaled: bool, kept: Mapping[str, Array]) -> Course:
    rotors = bench.rotors
    currents = tuple(np.array(item) for item in rotors.currents)
    velocity = np.array(rotors.velocities)
    return Course(
        status,
        reason,
        scaled,
        bench.energised,
        currents,
        velocity,
        bench.setup == "coupled",
        dict(kept),  # type: ignore[arg-type]
    )
