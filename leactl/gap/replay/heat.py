"""Temperatures of many runs stepped side by side: the paper's network, exact for heat that is held over a step.

Heat of the winding depends on its simulated temperature, extrapolated by half a step. Speed is the measured one: the
motion restarts from it every second in any case.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import expm

from leactl.effects.plant import Array
from leactl.gap.replay.job import Job
from leactl.gap.signals.derived import means_after_edges, winding_time_constant
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import WINDING, Clocked
from leactl.gap.signals.smoothing import smooth
from leactl.model.winding import resistance_ratio

START_SHARE = 0.3  # share of a winding's time constant from whose readings the start follows
MOST_START_SAMPLES = 20  # largest number of these readings
FED_WIDTH = 8.0  # samples, smoothing of the temperatures that give the share of the fed phases
NODES_FROM_START = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])  # a further body begins as the housing
FURTHER_BODY = np.array([0.0, 0.0, 1.0])  # a temperature of the further body alone, by node
NO_BODY_RESISTANCE = 1e9  # K/W, resistance to a body that does not exist


def replay_temperatures(jobs: Sequence[Job]) -> None:
    """Replay the temperatures of every run whose bench has a thermal network; use the measured ones elsewhere."""
    networked = [Network(job) for job in jobs if has_network(job)]
    if networked:
        temperatures = step_from_starts(networked)
        for index, network in enumerate(networked):
            network.write(temperatures[: network.count, index])
    for job in jobs:
        if not has_network(job):
            write_measured_temperatures(job)


def has_network(job: Job) -> bool:
    """Return whether a run's temperatures can be replayed."""
    clock, model = job.record.slow, job.plant.model
    if clock is None or clock.aside or model.thermal is None or model.phase_resistance is None:
        return False
    if clock.get("winding_temperature") is None or clock.get("ambient_temperature", "bench") is None:
        return False
    return clock.get("line_current") is not None or job.current is not None or "current_squared" in clock.driven


class Network:
    """One run's thermal network with its inputs at the samples of the slow clock.

    Nodes are winding, housing and a further body, in this order.
    """

    def __init__(self, job: Job) -> None:
        assert job.record.slow is not None and job.plant.model.thermal is not None
        self.job, self.clock, thermal = job, job.record.slow, job.plant.model.thermal
        clock, plant = self.clock, job.plant
        self.count = len(clock.time)
        self.ambient = clock.values["ambient_temperature", "bench"] + plant.model.ambient_offset
        for change in plant.ambient_change:
            self.ambient = self.ambient + change(clock.time - clock.time[0])
        self.cold, self.speed = self._cold_heat(), self._speed()
        self.housing_heat = np.zeros(self.count)
        for heat in plant.housing_heat:
            self.housing_heat = self.housing_heat + heat(self.speed)
        # conductances [W/K]
        winding_to_air, winding_to_housing = (
            1 / thermal.winding_ambient_resistance,
            1 / thermal.winding_housing_resistance,
        )
        self.to_air = 1 / thermal.housing_ambient_resistance
        body_capacitance, body_resistance = plant.further_node or (1.0, NO_BODY_RESISTANCE)
        housing_to_body = 1.0 / body_resistance
        self.capacities = np.array([thermal.winding_capacitance, thermal.housing_capacitance, body_capacitance])
        conductances = np.array(
            [
                [-(winding_to_air + winding_to_housing), winding_to_housing, 0.0],
                [winding_to_housing, -(winding_to_housing + self.to_air + housing_to_body), housing_to_body],
                [0.0, housing_to_body, -housing_to_body],
            ]
        )
        conductance_to_ambient = np.array([winding_to_air, self.to_air, 0.0])
        state_matrix = np.zeros((7, 7))  # temperatures; heats on each node and ambient held over the step
        state_matrix[:3, :3] = conductances / self.capacities[:, None]
        state_matrix[:3, 3:6] = np.diag(1.0 / self.capacities)
        state_matrix[:3, 6] = conductance_to_ambient / self.capacities
        step_matrix = expm(state_matrix * clock.interval)
        self.decay, self.gain, self.by_ambient = step_matrix[:3, :3], step_matrix[:3, 3:6], step_matrix[:3, 6]
        self.start = self._start()

    def _cold_heat(self) -> Array:
        """Return the Joule heat [W] at the reference temperature, over the interval that begins at each sample."""
        resistance, line_current = self.job.plant.model.phase_resistance or 0.0, self.clock.get("line_current")
        if line_current is not None:
            return 2.0 * resistance * line_current**2 * self._fed_share()
        if "current_squared" in self.clock.driven:
            return resistance * self.clock.driven["current_squared"]
        assert self.job.current is not None
        current_squared = self.job.current[:: self.job.parts] ** 2
        return resistance * means_after_edges(self.job.clock.time, current_squared, self.clock.time)

    def _fed_share(self) -> Array | float:
        """Return the ratio of the fed phases' mean resistance to that of the whole winding, from their temperatures."""
        clock, plant = self.clock, self.job.plant
        if clock.fed is None:
            return 1.0
        # ratios are to the resistance at the reference temperature
        ratio_at_zero = 1.0 - plant.resistance_coefficient * plant.model.reference_temperature
        fed_ratio, winding_ratio = (
            ratio_at_zero + plant.resistance_coefficient * values for values in (clock.fed, clock.values[WINDING])
        )
        return np.asarray(smooth(fed_ratio, FED_WIDTH) / smooth(winding_ratio, FED_WIDTH), np.float64)

    def _speed(self) -> Array:
        """Return the measured speed [rad/s], root mean square over the interval after each sample, else zero."""
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
        return np.sqrt(means_after_edges(fast.time, speed**2, self.clock.time))

    def _start(self) -> Array:
        """Return the temperatures [degC] of winding, housing and further body at the start, shape (3,).

        Winding and housing start so that the means of their first readings come out, with the camera's fraction of the
        rise above ambient undone. A further body is not measured. In a heated run it starts as warm as the housing. Any
        other run may begin warm: there the start of the body is fitted to the readings of the whole run.
        """
        reading_count = min(
            max(1, round(START_SHARE * winding_time_constant(self.job.plant.model) / self.clock.interval)),
            MOST_START_SAMPLES,
        )
        first_samples = slice(0, min(reading_count, self.count // 4) + 1)
        readings = np.stack(
            [self._first_of("winding_temperature", first_samples), self._first_of("housing_temperature", first_samples)]
        )
        responses_to_start = [
            np.linalg.matrix_power(self.decay, step)[:2] @ NODES_FROM_START for step in range(readings.shape[1])
        ]
        start = self._measured_start(readings, responses_to_start, np.zeros(3))
        if self.job.plant.further_node is None or self.job.record.mechanical == "heated":
            return start
        return self._measured_start(
            readings, responses_to_start, self._excess_of_further_body(start, responses_to_start) * FURTHER_BODY
        )

    def _measured_start(self, readings: Array, responses: Sequence[Array], excess: Array) -> Array:
        """Return the start [degC], shape (3,), from which the means of the first readings come out.

        readings : degC, shape (2, samples), of winding and housing.
        responses : for each sample, shape (2, 2), K/K: what 1 K more of winding or housing at the start (columns)
            leaves in winding and housing (rows); a further body starts as warm as the housing.
        excess : K, shape (3,), by which a further body starts warmer than the housing; zero for the other nodes.
        """
        start = np.mean(readings, axis=1)
        for _ in range(2):  # one pass is exact but for heat that depends on the temperature
            course = step_networks([self], (NODES_FROM_START @ start + excess)[None], readings.shape[1])[:, 0, :2]
            start = start + np.linalg.solve(np.mean(responses, axis=0), np.mean(readings - course.T, axis=1))
        return np.asarray(NODES_FROM_START @ start + excess, np.float64)

    def _excess_of_further_body(self, start: Array, responses_to_start: Sequence[Array]) -> float:
        """Return by how much a further body is warmer than the housing at the start [K].

        It is fitted by least squares over the run, with a Gaussian prior of mean zero. Its standard deviation is the
        housing's rise above ambient at the start.
        """
        # what 1 K more at the start of the body, the winding, or housing and body together (columns) gives each node
        nodes = np.column_stack([FURTHER_BODY, NODES_FROM_START])
        responses = np.empty((self.count, 2, 3))  # K/K, of winding and housing
        for step in range(self.count):
            responses[step] = nodes[:2]
            nodes = self.decay @ nodes
        by_body, by_start = responses[:, :, 0], responses[:, :, 1:]
        # 1 K of excess warms the first samples; a start lower by this (K/K) undoes that on average
        lowered_start = np.linalg.solve(
            np.mean(responses_to_start, axis=0), np.mean(by_body[: len(responses_to_start)], axis=0)
        )
        change = by_body - by_start @ lowered_start
        course = step_networks([self], start[None], self.count)[:, 0, :2]
        prior_variance = (start[1] - self.ambient[0]) ** 2  # K^2
        weighted_change, information = 0.0, 1.0  # both times the prior's variance: the 1 is the prior itself
        for node, name in enumerate(("winding_temperature", "housing_temperature")):
            readings, measured_samples = self.clock.get(name), self.clock.all_valid((name, "test"))
            noise = noise_of(readings) / self.job.plant.camera_fraction if readings is not None else 0.0
            if noise > 0.0:
                residual = self._node_temperatures(name, slice(0, self.count)) - course[:, node]
                weight = prior_variance / noise**2
                weighted_change += weight * float(change[measured_samples, node] @ residual[measured_samples])
                information += weight * float(np.sum(change[measured_samples, node] ** 2))
        return weighted_change / information

    def _first_of(self, name: str, samples: slice) -> Array:
        """Return the first temperatures of a node [degC]; a disturbed replay adds the error of their mean."""
        temperatures = self._node_temperatures(name, samples)
        if self.job.disturbance is not None:
            error = (
                noise_of(self._camera_readings(name))
                / np.sqrt(len(temperatures))
                * float(self.job.disturbance.standard_normal())
            )
            temperatures = temperatures + error / self.job.plant.camera_fraction
        return temperatures

    def _node_temperatures(self, name: str, samples: slice) -> Array:
        """Return the temperatures of a node [degC]: the camera's readings with its fraction of the rise undone."""
        air = self.ambient[samples]
        return np.asarray(
            air + (self._camera_readings(name)[samples] - air) / self.job.plant.camera_fraction, np.float64
        )

    def _camera_readings(self, name: str) -> Array:
        """Return the camera's readings of a node, or of the winding where it did not see the node."""
        values = self.clock.get(name)
        return self.clock.values["winding_temperature", "test"] if values is None else values

    def write(self, nodes: Array) -> None:
        """Write the temperatures, and the readings of camera and supply, into the job.

        nodes : degC, shape (samples, 3).
        """
        job, clock = self.job, self.clock
        winding, housing = nodes[:, 0], nodes[:, 1]
        for name, values in (("winding_temperature", winding), ("housing_temperature", housing)):
            if clock.get(name) is not None:
                job.slow[name, "test"] = self.ambient + job.plant.camera_fraction * (values - self.ambient)
        line_current = clock.get("line_current")
        if line_current is not None and clock.get("line_voltage") is not None:
            cold_voltage = 2.0 * (job.plant.model.phase_resistance or 0.0) * line_current
            fed_temperature = winding
            if clock.fed is not None:  # the phases with current are warmer than the mean by the measured difference
                fed_temperature = winding + clock.fed - clock.values[WINDING]
            job.slow["line_voltage", "test"] = cold_voltage * resistance_share(job, fed_temperature)
        if job.record.fast is not None:
            job.winding = np.interp(job.clock.time, clock.time, winding)
            job.housing = np.interp(job.clock.time, clock.time, housing)


def step_from_starts(networks: Sequence[Network]) -> Array:
    """Return the temperatures [degC] of all networks stepped from their starts, shape (steps, networks, nodes)."""
    starts = np.stack([network.start for network in networks])
    return step_networks(networks, starts, max(network.count for network in networks))


def step_networks(networks: Sequence[Network], starts: Array, step_count: int) -> Array:
    """Return the temperatures [degC] of networks stepped from given starts, shape (steps, networks, nodes).

    starts : degC, shape (networks, nodes).
    step_count : number of steps; a network whose run ends earlier continues at its last inputs.
    """

    def inputs(name: str) -> Array:
        """Return an attribute of the networks at every step, shape (steps, networks)."""
        rows = [getattr(network, name)[:step_count] for network in networks]
        return np.stack([np.pad(row, (0, step_count - len(row)), mode="edge") for row in rows], axis=1)

    cold_heat, ambient, housing_heat, speed = (inputs(name) for name in ("cold", "ambient", "housing_heat", "speed"))
    decay, gain = np.stack([network.decay for network in networks]), np.stack([network.gain for network in networks])
    by_ambient = np.stack([network.by_ambient for network in networks])
    external_rise = gain[:, :, 1] * housing_heat[:, :, None] + by_ambient * ambient[:, :, None]
    by_winding = cold_heat[:, :, None] * gain[:, :, 0]
    ratio_per_kelvin = np.array([network.job.plant.resistance_coefficient for network in networks])
    ratio_at_zero = 1.0 - ratio_per_kelvin * np.array(
        [network.job.plant.model.reference_temperature for network in networks]
    )
    convective = [(index, network) for index, network in enumerate(networks) if network.job.plant.convection]
    state = starts
    previous_winding = state[:, 0].copy()
    temperatures = np.empty((step_count, len(networks), 3))
    for step in range(step_count):
        temperatures[step] = state
        ratio = ratio_at_zero + ratio_per_kelvin * (1.5 * state[:, 0] - 0.5 * previous_winding)
        previous_winding = state[:, 0].copy()
        next_state = (decay @ state[:, :, None])[:, :, 0] + by_winding[step] * ratio[:, None] + external_rise[step]
        for index, network in convective:
            rise = state[index, 1] - ambient[step, index]
            convection = sum(float(factor(rise, speed[step, index])) for factor in network.job.plant.convection)
            next_state[index] -= network.gain[:, 1] * (network.to_air * rise * convection)
        state = next_state
    return temperatures


def write_measured_temperatures(job: Job) -> None:
    """Write the measured temperatures into the job, where no network replays them."""
    clock: Clocked | None = job.record.slow
    if clock is None or job.record.fast is None:
        return
    for name in ("winding", "housing"):
        values = clock.get(f"{name}_temperature")
        if values is not None:
            setattr(job, name, np.interp(job.clock.time, clock.time, values))


def resistance_share(job: Job, winding: Array | None) -> Array | float:
    """Return the ratio of the resistance to that at the reference temperature; 1 without a temperature [degC]."""
    if winding is None:
        return 1.0
    return resistance_ratio(winding, job.plant.resistance_coefficient, job.plant.model.reference_temperature)
