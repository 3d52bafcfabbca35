"""One trial: a random protocol on a random plant, its forecast, what its run came to, and the true temperatures."""

import math
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from leactl.protocol.plan import Plan
from leactl.runner import state_folder
from leactl.runner.boot_time import ClockReadings
from leactl.runner.thermal_admission import motors_of
from leactl.runner.thermal_memory import Memory
from leactl.safety.thermal.box import Array, Box
from leactl.safety.thermal.foresight import Foresight
from leactl.safety.thermal.guard import ThermalGuard
from tests.monte_carlo import wire
from tests.monte_carlo.direct import Fault
from tests.monte_carlo.plants import LEA, OUTSIDE, ROLES, Truth, at_the_corner, drawn
from tests.monte_carlo.protocols import LONGEST_S, Protocol
from tests.monte_carlo.supervised import Course, MakeGuard, run, run_free, shipped
from tests.monte_carlo.truth import History, hottest

LIMIT_DEGC, MILD_DEGC = 130.0, 90.0
OFFSETS_RAD = tuple(math.pi / 12.0 * k for k in range(4))  # of commutation; from pi / 3 on they repeat other phases
WARM_SHARE, EARLIER_KILLED_SHARE = 0.3, 0.2
LONGEST_EARLIER_S, LONGEST_PAUSE_S = 90.0, 120.0
THERMAL = "winding: its hottest phase may be at"
UPTIME_S = 1e6  # of the machine, where an earlier run ends


@dataclass
class Trial:
    """What is known of a trial before the true temperatures are."""

    told: dict[str, Any]
    truth: Truth
    parts: list[Course | float]
    plan: Plan
    seed: int
    free: Course | None = None  # the same protocol where nothing interferes, if that is another course


@dataclass(frozen=True)
class Campaign:
    """How many trials of which kind, and from which seed."""

    count: int
    over_wire: int
    outside: int
    seed: int

    @property
    def numbers(self) -> range:
        """Of all trials; those outside the guard's model come last."""
        return range(self.count + self.outside)

    def kind(self, number: int) -> str:
        """Direct or wire, inside the tolerances; or direct, outside the guard's model."""
        if number >= self.count:
            return "outside"
        wired = (number + 1) * self.over_wire // self.count > number * self.over_wire // self.count
        return "wire" if wired else "direct"


def tried(campaign: Campaign, numbers: Iterable[int], guard_of: MakeGuard = ThermalGuard) -> list[dict[str, Any]]:
    """Results of these trials, of which those without a wire share their lanes of true temperatures."""
    found, open_ones = [], []
    for number in numbers:
        draw = np.random.default_rng([campaign.seed, number])
        kind = campaign.kind(number)
        began = time.process_time()
        if kind == "wire":
            told = wire.trial(draw, number, guard_of)
        else:
            trial = _direct(draw, number, kind == "outside", guard_of)
            told = trial.told
            open_ones.append(trial)
        told["cpu_s"] = round(time.process_time() - began, 3)
        found.append(told)
    _heat(open_ones)
    return found


def _direct(draw: np.random.Generator, number: int, beyond: bool, guard_of: MakeGuard) -> Trial:
    protocol = Protocol(draw, LONGEST_S)
    plan = protocol.plan()
    outside = str(draw.choice(OUTSIDE)) if beyond else ""
    truth = drawn(draw, outside, plan.duration_s)
    fault = Fault.drawn(draw, plan.duration_s) if draw.random() < 0.5 and not beyond else None
    seed = int(draw.integers(2**31))
    start, how, parts = _start(draw, truth, guard_of, seed)
    file, settings = shipped()
    forecast = Foresight(motors_of(file), settings, start).forecast(plan)
    course = run(plan, truth, fault, start, seed, guard_of)
    told = {
        "number": number,
        "kind": "outside" if beyond else "direct",
        "outside": outside,
        "misread": truth.misread,
        "setup": plan.setup,
        "rate_Hz": plan.rate_Hz,
        "duration_s": round(plan.duration_s, 2),
        "most_A": round(protocol.current, 3),
        "corner": truth.corner,
        "start": how,
        "fault": fault.kind if fault else "",
        "forecast": "refused" if forecast.passing else "accepted",
        "forecast_degC": round(max(forecast.peaks.values()), 2),
        "status": course.status,
        "reason": course.reason,
        "scaled": course.scaled,
        "bound_degC": round(max(float(nodes[0]) for nodes in course.kept.values()), 2),
        "energised": course.energised,
    }
    free = None
    if fault is None and (course.scaled or course.status != "complete"):
        free = run_free(plan, truth, seed)
    return Trial(told, truth, [*parts, course], plan, seed, free)


def _start(
    draw: np.random.Generator, truth: Truth, guard_of: MakeGuard, seed: int
) -> tuple[Mapping[str, Array], str, list[Course | float]]:
    """Bounds to start from: at ambient, or as remembered of an earlier run, which may have been killed."""
    cold = LEA_START
    if draw.random() >= WARM_SHARE:
        return cold, "cold", []
    earlier = Protocol(draw, LONGEST_EARLIER_S).plan()
    killed = draw.random() < EARLIER_KILLED_SHARE
    at = float(draw.uniform(0.3, 1.0)) * earlier.duration_s
    before = run(
        earlier, truth, Fault("process killed", at, 0.0, "test", 0.0) if killed else None, cold, seed + 1, guard_of
    )
    pause = round(float(np.exp(draw.uniform(np.log(1.0), np.log(LONGEST_PAUSE_S)))), 2)
    died = before.status == "killed"
    written = float(draw.uniform(0.0, 1.0)) if died else 0.0  # s before the end
    limit, ambient = shipped()[1].limit, shipped()[1].ambient
    start = {}
    for role in ROLES:
        memory = Memory(f"trial.{role}", LEA, limit, ambient, state_folder.of_user())
        memory.keep(before.kept[role], ClockReadings(0.0, "", UPTIME_S - written), running=died)
        start[role] = memory.recall(ClockReadings(0.0, "", UPTIME_S + pause)).nodes
    return start, "warm, killed" if died else "warm", [before, pause]


LEA_START = dict.fromkeys(ROLES, np.full(3, shipped()[1].ambient + Box.of(LEA).ambient_rise))


def _heat(trials: list[Trial]) -> None:
    """Add the true temperatures."""
    histories = [History(trial.truth, trial.parts) for trial in trials]
    undisturbed = [trial for trial in trials if trial.free is not None]
    histories += [History(t.truth, [*t.parts[:-1], t.free]) for t in undisturbed if t.free is not None]
    result = hottest(histories)
    for trial, (whole, own) in zip(trials, result, strict=False):
        trial.told["peak_degC"] = round(whole, 3)
        trial.told["undisturbed_degC"] = round(own, 3)
    for trial, (_, own) in zip(undisturbed, result[len(trials) :], strict=True):
        trial.told["undisturbed_degC"] = round(own, 3)
    for trial in trials:
        if needless(trial.told):
            trial.told["corner_degC"] = round(_at_the_corner(trial), 3)


def _at_the_corner(trial: Trial) -> float:
    """How hot the same protocol makes a cold plant of the box whose tolerances all add to its heat [degC]."""
    worst = [at_the_corner(offset) for offset in OFFSETS_RAD]
    result = hottest([History(truth, [run_free(trial.plan, truth, trial.seed)]) for truth in worst])
    return max(whole for whole, _ in result)


def violations(told: Mapping[str, Any]) -> list[str]:
    """What must not be of a plant inside the tolerances; a drive that has frozen can be stopped by nobody."""
    if told["kind"] == "outside" or told["fault"] in ("frozen drive", "frozen_drive"):
        return [f"run file: {text}" for text in told.get("file_faults", [])]
    results = []
    if not told["peak_degC"] <= LIMIT_DEGC:
        results.append(f"hottest phase at {told['peak_degC']:.2f} degC")
    if told["energised"]:
        results.append(f"left energised: {', '.join(told['energised'])}")
    return results + [f"run file: {text}" for text in told.get("file_faults", [])]


def needless(told: Mapping[str, Any]) -> bool | None:
    """Whether a fault-free protocol that stays mild was refused or tripped; None where that is not in question."""
    if told["fault"] or told["start"] == "warm, killed" or told["kind"] == "outside":
        return None
    if not told["undisturbed_degC"] < MILD_DEGC:
        return None
    return told["forecast"] == "refused" or told["status"] != "complete"
