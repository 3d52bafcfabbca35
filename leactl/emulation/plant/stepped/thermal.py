"""Temperatures of many lanes: winding, housing and the fixture on it, by Heun's rule."""

from collections.abc import Sequence

import numpy as np

from leactl.emulation.plant.effects.contract import Value
from leactl.emulation.plant.stepped.lanes import Array, EffectGroup, Lane, column


class ThermalLanes:
    """`winding`, `housing` and `fixture` temperatures of the test actuators [degC], and their camera readings."""

    def __init__(self, lanes: Sequence[Lane], groups_by_hook: dict[str, list[EffectGroup]]) -> None:
        self.logged_ambient = column(lanes, lambda lane: lane.bench.ambient_temperature)
        ambient = column(lanes, lambda lane: lane.bench.ambient_temperature)
        self._state = np.empty((3, len(lanes)))
        self.winding, self.housing, self.fixture = self._state
        for row, name in enumerate(("winding", "housing", "fixture")):
            for k, lane in enumerate(lanes):
                start_temperature = getattr(lane, name)
                self._state[row, k] = ambient[k] if start_temperature is None else start_temperature
        thermal = [lane.test.thermal for lane in lanes]
        self._winding_ambient = np.array([1.0 / p.winding_ambient_resistance for p in thermal])  # W/K
        self._winding_housing = np.array([1.0 / p.winding_housing_resistance for p in thermal])
        self._housing_ambient = np.array([1.0 / p.housing_ambient_resistance for p in thermal])
        self._per_capacitance = np.zeros((3, len(lanes)))  # K/J; a lane without a fixture keeps its start value
        self._per_capacitance[0] = [1.0 / p.winding_capacitance for p in thermal]
        self._per_capacitance[1] = [1.0 / p.housing_capacitance for p in thermal]
        self._fixture_conductance = np.zeros(len(lanes))  # W/K
        for group in groups_by_hook["fixture"]:
            fixture = group.effect.fixture()
            if fixture is not None:
                self._per_capacitance[2, group.lanes] = 1.0 / fixture[0]
                self._fixture_conductance[group.lanes] = 1.0 / fixture[1]
        self._groups_by_hook = groups_by_hook
        self._heat = np.zeros((3, len(lanes)))
        self._has_housing_heat = bool(groups_by_hook["housing_heat"])

    @property
    def needs_friction(self) -> bool:
        """Whether the friction power heats the housing in any lane."""
        return self._has_housing_heat

    def step(self, time: float, step_s: float, heat: Value, speed: Array, friction_power: Array) -> None:
        """Advance by a step of `step_s` from a time [s].

        heat : heat into the winding [W]. speed : of the rotor [rad/s]. friction_power : power of the friction [W].
        """
        self._heat[0] = heat
        for group in self._groups_by_hook["housing_heat"]:
            self._heat[1, group.lanes] = group.effect.housing_heat(friction_power[group.lanes])
        ambient = self.true_ambient(time)
        start_state = self._state.copy()
        start_rates = self._rates(ambient, speed)
        self._state += step_s * start_rates
        end_rates = self._rates(ambient, speed)
        np.add(start_state, 0.5 * step_s * (start_rates + end_rates), out=self._state)

    def true_ambient(self, time: float) -> Array:
        """Return the true ambient temperature [degC] at a time [s]; an effect may move it away from the logged one."""
        if not self._groups_by_hook["ambient_error"]:
            return self.logged_ambient
        ambient = self.logged_ambient.copy()
        for group in self._groups_by_hook["ambient_error"]:
            ambient[group.lanes] += group.effect.ambient_error(time)
        return ambient

    def _rates(self, ambient: Array, speed: Array) -> Array:
        """Return the rates of all nodes [K/s], shape (3, lanes)."""
        winding, housing, fixture = self._state
        conductance = self._housing_ambient
        if self._groups_by_hook["housing_conductance"]:
            conductance = conductance.copy()
            for group in self._groups_by_hook["housing_conductance"]:
                lane_slice = group.lanes
                conductance[lane_slice] *= group.effect.housing_conductance(
                    (housing - ambient)[lane_slice], speed[lane_slice]
                )
        winding_to_housing = self._winding_housing * (winding - housing)
        housing_to_fixture = self._fixture_conductance * (housing - fixture)
        flows = self._heat.copy()
        flows[0] -= winding_to_housing + self._winding_ambient * (winding - ambient)
        flows[1] += winding_to_housing - conductance * (housing - ambient) - housing_to_fixture
        flows[2] += housing_to_fixture
        flows *= self._per_capacitance
        return flows

    def camera(self) -> Array:
        """Return winding and housing temperatures as the camera reads them [degC], shape (2, lanes)."""
        readings = self._state[:2].copy()
        for group in self._groups_by_hook["camera_reading"]:
            ambient = self.logged_ambient[group.lanes]
            readings[:, group.lanes] = group.effect.camera_reading(readings[:, group.lanes], ambient)
        return readings
