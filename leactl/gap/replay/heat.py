"""Temperatures of many runs stepped side by side: the paper's network, exact for heat that is held over a step.

Heat of the winding goes by its simulated temperature, half a step ahead. Speed is the measured one: the motion starts
again from it every second in any case.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import expm

from leactl.effects.plant import Array
from leactl.gap.replay.job import Job
from leactl.gap.signals.derived import binned, warming
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import WINDING, Clocked
from leactl.gap.signals.smoothing import smooth

STARTS, MOST_AT_START = 0.15, 10  # of a winding's time constant to either side of the start, and samples
FED_WIDTH = 8.0  # samples, smoothing of a share that a camera tells
AWAY = 1e9  # K/W of a body that is not there


def warm(jobs: Sequence[Job]) -> None:
    """Replay the temperatures of every run whose bench has a thermal network; take the measured ones elsewhere."""
    networked = [Network(job) for job in jobs if has_network(job)]
    if networked:
        answer = together(networked)
        for index, network in enumerate(networked):
            network.keep(answer[: network.count, index])
    for job in jobs:
        if not has_network(job):
            measured(job)


def has_network(job: Job) -> bool:
    """Whether a run's temperatures can be replayed."""
    clock, model = job.record.slow, job.plant.model
    if clock is None or clock.aside or model.thermal is None or model.phase_resistance is None:
        return False
    if clock.get("winding_temperature") is None or clock.get("ambient_temperature", "bench") is None:
        return False
    return clock.get("line_current") is not None or job.current is not None or "current_squared" in clock.driven


class Network:
    """One run's network with what drives it, sample by sample of the slow clock from the start on."""

    def __init__(self, job: Job) -> None:
        assert job.record.slow is not None and job.plant.model.thermal is not None
        self.job, self.clock, thermal = job, job.record.slow, job.plant.model.thermal
        clock, plant = self.clock, job.plant
        self.first = min(
            max(1, round(STARTS * warming(plant.model) / clock.interval)), MOST_AT_START, len(clock.time) // 4
        )
        self.count = len(clock.time) - self.first
        time = clock.time[self.first :] - clock.time[0]
        self.ambient = clock.values["ambient_temperature", "bench"][self.first :] + plant.model.ambient_offset
        for change in plant.ambient_change:
            self.ambient = self.ambient + change(time)
        self.cold = self._cold_heat()[self.first :]
        self.speed = self._speed()[self.first :]
        self.housing_heat = np.zeros(self.count)
        for heat in plant.housing_heat:
            self.housing_heat = self.housing_heat + heat(self.speed)
        self.start = self._start()
        wa, wh = 1 / thermal.winding_ambient_resistance, 1 / thermal.winding_housing_resistance
        self.to_air = 1 / thermal.housing_ambient_resistance
        capacity, resistance = plant.further_node or (1.0, AWAY)
        hf = 1.0 / resistance
        self.capacities = np.array([thermal.winding_capacitance, thermal.housing_capacitance, capacity])
        flows = np.array([[-(wa + wh), wh, 0.0], [wh, -(wh + self.to_air + hf), hf], [0.0, hf, -hf]])
        ambient = np.array([wa, self.to_air, 0.0])
        block = np.zeros((7, 7))  # temperatures; heats on each node and ambient held over the step
        block[:3, :3] = flows / self.capacities[:, None]
        block[:3, 3:6] = np.diag(1.0 / self.capacities)
        block[:3, 6] = ambient / self.capacities
        moved = expm(block * clock.interval)
        self.decay, self.gain, self.by_ambient = moved[:3, :3], moved[:3, 3:6], moved[:3, 6]

    def _cold_heat(self) -> Array:
        """Joule heat at the reference temperature [W], over the interval that begins at each sample."""
        resistance, line = self.job.plant.model.phase_resistance or 0.0, self.clock.get("line_current")
        if line is not None:
            return 2.0 * resistance * line**2 * self._fed_share()
        if "current_squared" in self.clock.driven:
            return resistance * self.clock.driven["current_squared"]
        assert self.job.current is not None
        squared = self.job.current[:: self.job.parts] ** 2
        return resistance * binned(self.job.clock.time, squared, self.clock.time)

    def _fed_share(self) -> Array | float:
        """Resistance of the phases that two leads feed over that of the whole winding, as their temperatures tell."""
        clock, plant = self.clock, self.job.plant
        if clock.fed is None:
            return 1.0
        cold = 1.0 - plant.resistance_coefficient * plant.model.reference_temperature
        fed, whole = (cold + plant.resistance_coefficient * values for values in (clock.fed, clock.values[WINDING]))
        return np.asarray(smooth(fed, FED_WIDTH) / smooth(whole, FED_WIDTH), np.float64)

    def _speed(self) -> Array:
        """Measured speed [rad/s], as root mean square over the interval that begins at each sample."""
        fast = self.job.record.fast
        if "speed_squared" in self.clock.driven:
            return np.sqrt(self.clock.driven["speed_squared"])
        if fast is None or self.job.record.mechanical in ("locked", "heated"):
            return np.zeros(len(self.clock.time))
        speed = fast.get("velocity")
        angle = fast.get("angle")
        if speed is None and angle is not None:
            speed = np.gradient(angle, fast.interval)
        if speed is None:
            return np.zeros(len(self.clock.time))
        return np.sqrt(binned(fast.time, speed**2, self.clock.time))

    def _start(self) -> Array:
        """Measured temperatures at the start, the camera's fraction undone; a further body has the housing's."""
        temperatures = []
        for name in ("winding_temperature", "housing_temperature"):
            values = self.clock.get(name)
            if values is None:
                values = self.clock.values["winding_temperature", "test"]
            around = values[: 2 * self.first + 1]
            reading = float(np.mean(around))
            if self.job.disturbance is not None:
                noise = noise_of(values) / np.sqrt(len(around))
                reading += noise * float(self.job.disturbance.standard_normal())
            air = float(self.ambient[0])
            temperatures.append(air + (reading - air) / self.job.plant.camera_fraction)
        return np.array([*temperatures, temperatures[1]])

    def keep(self, nodes: Array) -> None:
        """Put temperatures, and what camera and supply read of them, into the job."""
        job, clock, first = self.job, self.clock, self.first
        winding, housing = nodes[:, 0], nodes[:, 1]
        lead = np.full(first, np.nan)
        for name, values in (("winding_temperature", winding), ("housing_temperature", housing)):
            if clock.get(name) is not None:
                read = self.ambient + job.plant.camera_fraction * (values - self.ambient)
                job.slow[name, "test"] = np.concatenate([lead, read])
        line = clock.get("line_current")
        if line is not None and clock.get("line_voltage") is not None:
            cold = 2.0 * (job.plant.model.phase_resistance or 0.0) * line[first:]
            fed = winding
            if clock.fed is not None:  # the phases that carry the current, warmer than the mean as they were measured
                fed = winding + (clock.fed - clock.values[WINDING])[first:]
            job.slow["line_voltage", "test"] = np.concatenate([lead, cold * resistance_share(job, fed)])
        if job.record.fast is not None:
            stamps = clock.time[first:]
            job.winding = np.interp(job.clock.time, stamps, winding)
            job.housing = np.interp(job.clock.time, stamps, housing)


def together(networks: Sequence[Network]) -> Array:
    """Step all networks; temperatures of (step, network, node)."""
    longest = max(network.count for network in networks)

    def inputs(name: str) -> Array:
        rows = [getattr(network, name) for network in networks]
        return np.stack([np.pad(row, (0, longest - len(row)), mode="edge") for row in rows], axis=1)

    cold, ambient, housing_heat, speed = (inputs(name) for name in ("cold", "ambient", "housing_heat", "speed"))
    decay, gain = np.stack([n.decay for n in networks]), np.stack([n.gain for n in networks])
    by_ambient = np.stack([n.by_ambient for n in networks])
    given = gain[:, :, 1] * housing_heat[:, :, None] + by_ambient * ambient[:, :, None]
    by_winding = cold[:, :, None] * gain[:, :, 0]
    slope = np.array([n.job.plant.resistance_coefficient for n in networks])
    level = 1.0 - slope * np.array([n.job.plant.model.reference_temperature for n in networks])
    blown = [(index, n) for index, n in enumerate(networks) if n.job.plant.convection]
    state = np.stack([n.start for n in networks])
    ahead = state[:, 0].copy()
    out = np.empty((longest, len(networks), 3))
    for step in range(longest):
        out[step] = state
        share = level + slope * (1.5 * state[:, 0] - 0.5 * ahead)
        ahead = state[:, 0].copy()
        fresh = (decay @ state[:, :, None])[:, :, 0] + by_winding[step] * share[:, None] + given[step]
        for index, network in blown:
            rise = state[index, 1] - ambient[step, index]
            more = sum(float(c(rise, speed[step, index])) for c in network.job.plant.convection)
            fresh[index] -= network.gain[:, 1] * (network.to_air * rise * more)
        state = fresh
    return out


def measured(job: Job) -> None:
    """Measured temperatures, where no network says better."""
    clock: Clocked | None = job.record.slow
    if clock is None or job.record.fast is None:
        return
    for name in ("winding", "housing"):
        values = clock.get(f"{name}_temperature")
        if values is not None:
            setattr(job, name, np.interp(job.clock.time, clock.time, values))


def resistance_share(job: Job, winding: Array | None) -> Array | float:
    """Resistance over that at the reference temperature."""
    if winding is None:
        return 1.0
    return 1.0 + job.plant.resistance_coefficient * (winding - job.plant.model.reference_temperature)
