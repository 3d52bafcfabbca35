"""What the emulated loops do, noise, wires and rounding apart: the plant of a run itself, looked at every 50 us."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.signal import butter, csd, sosfilt, welch

from leactl.bench import benchfile
from leactl.emulation.plant.exact.rig import Rig
from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters
from tests.loops import StepFigures, current_bandwidth, figures

DRAWN = (
    "current_loop_bandwidth",
    "setpoint_lead",
    "setpoint_lead_time",
    "position_gain",
    "velocity_gain",
    "speed_limit",
)
SPREAD = 0.05  # of each of these, uniform
CYCLE_S, FINE_S = 1e-3, 5e-5
JUMP = 0.3  # of a setpoint, in its unit: noise and ramps take less at once
FINELY_S, STEADY_S, WATCHED_S = 0.4, 1.0, 1.98  # since a jump
RECORDS, RECORD_S, HEAD = 60, 8.7, 500  # of fewer, the truth itself scatters as the estimate does


def drawn_loops(seed: int) -> dict[str, float]:
    """The loops of the shipped bench, each parameter a little off, so that seeds sample their responses elsewhere."""
    file, _, _ = benchfile.load("emulated")
    assert file.emulated is not None
    random = np.random.default_rng(seed)
    return {name: file.emulated.bench[name] * float(random.uniform(1 - SPREAD, 1 + SPREAD)) for name in DRAWN}


def drawn_lag(seed: int) -> float:
    """How long after the host's cycle a seed's drive acts on a jump [s]: anywhere in a cycle."""
    return float(np.random.default_rng([seed, 78]).uniform(0.0, CYCLE_S))


def drawn_levels(seed: int) -> list[str]:
    """Settings of position-step: up to 2 % below the protocol's, whose tenths are whole counts of the encoder."""
    random, levels = np.random.default_rng([seed, 79]), {"small": 1, "middle": 2, "large": 3}
    return [f"{name}_rad={math.pi / 4 * k * float(random.uniform(0.98, 1.0)):.6f}" for name, k in levels.items()]


def plant(loops: Mapping[str, float], setup: str, condition: str) -> Rig:
    """The plant with these loops in a set-up under a condition."""
    file, _, _ = benchfile.load("emulated")
    assert file.emulated is not None
    parameters = ActuatorParameters.from_mapping(file.emulated.conditions[condition])
    return Rig(setup, parameters, parameters, BenchParameters.from_mapping(loops))


class WatchedRig(Rig):
    """The plant of a run, looked at every 50 us for a while after each jump of the test drive's setpoint."""

    lag = 0.0  # s, within a cycle of the host, after which the test drive acts on a jump

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        self.jumps: list[list[tuple[float, float]]] = []  # time since the jump and what answers it
        self._awaited: tuple[float, str, float] | None = None  # when the drive acts on a jump, and on which
        super().__init__(*arguments, **settings)

    def take_command(self, k: int, mode: str, value: float) -> None:
        """Keep a jump to somewhere else than zero until the drive acts on it."""
        actuator = self.actuators["test"]
        if k == 0 and mode == actuator.mode and abs(value) > JUMP < abs(value - actuator.setpoint):
            self._awaited = self._awaited or (self.time + self.lag, mode, value)
        else:
            super().take_command(k, mode, value)

    def advance(self, to_time: float) -> None:
        """Go on in short steps where it counts."""
        if self._awaited and to_time >= self._awaited[0]:
            acts, mode, value = self._awaited
            self._awaited = None
            super().advance(acts)
            super().take_command(0, mode, value)
            self.jumps.append([(0.0, self._answer)])
            self._jumped = self.time
        while self.jumps and to_time < self._jumped + WATCHED_S and self.time + FINE_S < to_time:
            super().advance(min(self.time + (FINE_S if self.time < self._jumped + FINELY_S else CYCLE_S), to_time))
            self.jumps[-1].append((self.time - self._jumped, self._answer))
        super().advance(to_time)

    @property
    def _answer(self) -> float:
        actuator = self.actuators["test"]
        return actuator.angle if actuator.mode == "angle" else actuator.current

    def figures(self) -> StepFigures:
        """Figures of every jump, mean over all of them, each level having as many."""
        results = []
        for jump in self.jumps:
            time, values = np.array(jump).T
            one = values[time > STEADY_S].mean()
            results.append(figures(time, (values - values[0]) / (one - values[0])))
        names = ("rise_time", "overshoot", "settling_time")
        return StepFigures(*(float(np.mean([getattr(result, name) for result in results])) for name in names))


def position_bandwidth(loops: Mapping[str, float], condition: str, std: float, seed: int) -> float:
    """Where averaged periodograms of the servo's answer to noise fall to -3 dB [Hz]; friction is part of it."""
    rig = plant(loops, "free", condition)
    actuator, random, now, pairs = rig.actuators["test"], np.random.default_rng([seed, 77]), 0.0, []
    sections = butter(10, 40.0, fs=300.0, output="sos")
    for _ in range(RECORDS):
        noise = sosfilt(sections, random.standard_normal(round(RECORD_S * 300)))
        noise *= std / noise.std()
        given, answer = [], []
        for cycle in range(round(RECORD_S / CYCLE_S)):
            given.append(float(noise[int(cycle * CYCLE_S * 300 + 1e-6)]))
            actuator.command("angle", given[-1])
            now += CYCLE_S
            rig.advance(now)
            answer.append(actuator.angle)
        pairs.append((np.array(given[HEAD:]), np.array(answer[HEAD:])))
    settings = {"fs": 1 / CYCLE_S, "nperseg": 2048, "detrend": "constant"}
    cross = sum(csd(given, answer, **settings)[1] for given, answer in pairs)
    power = sum(welch(given, **settings)[1] for given, _ in pairs)
    frequency = np.fft.rfftfreq(2048, CYCLE_S)
    gain = np.abs(cross / power)
    near = (frequency > 4.0) & (frequency < 12.0)
    through = np.polynomial.Polynomial.fit(frequency[near], gain[near] - math.sqrt(0.5), 3)
    return float(min(root.real for root in through.roots() if not root.imag and 4.0 < root.real < 12.0))


def current_loop_bandwidth(loops: Mapping[str, float]) -> float:
    """Closed form of the current loop's -3 dB frequency [Hz]."""
    return current_bandwidth(*(loops[name] for name in DRAWN[:3]))
