"""Temperatures of many lanes: winding, housing and the fixture on it, by Heun's rule."""

from collections.abc import Sequence

import numpy as np

from leactl.emulation.plant.effects.contract import Value
from leactl.emulation.plant.stepped.lanes import Array, EffectGroup, Lane, column


class ThermalLanes:
    """`winding`, `housing` and `fixture` temperatures of the test actuators [degC], and their camera readings."""

    def __init__(self, lanes: Sequence[Lane], bound: dict[str, list[EffectGroup]]) -> None:
        self.logged_ambient = column(lanes, lambda lane: lane.bench.ambient_temperature)
        ambient = column(lanes, lambda lane: lane.bench.ambient_temperature)
        self._state = np.empty((3, len(lanes)))
        self.winding, self.housing, self.fixture = self._state
        for row, name in enumerate(("winding", "housing", "fixture")):
            for k, lane in enumerate(lanes):
                start = getattr(lane, name)
                self._state[row, k] = ambient[k] if start is None else start
        thermal = [lane.test.thermal for lane in lanes]
        self._winding_ambient = np.array([1.0 / p.winding_ambient_resistance for p in thermal])  # W/K
        self._winding_housing = np.array([1.0 / p.winding_housing_resistance for p in thermal])
        self._housing_ambient = np.array([1.0 / p.housing_ambient_resistance for p in thermal])
        self._per_capacitance = np.zeros((3, len(lanes)))  # K/J; a lane without a fixture keeps its start value
        self._per_capacitance[0] = [1.0 / p.winding_capacitance for p in thermal]
        self._per_capacitance[1] = [1.0 / p.housing_capacitance for p in thermal]
        self._fixed = np.zeros(len(lanes))  # W/K
        for group in bound["fixture"]:
            fixture = group.effect.fixture()
            if fixture is not None:
                self._per_capacitance[2, group.lanes] = 1.0 / fixture[0]
                self._fixed[group.lanes] = 1.0 / fixture[1]
        self._bound = bound
        self._heat = np.zeros((3, len(lanes)))
        self._friction = bool(bound["housing_heat"])

    @property
    def needs_friction(self) -> bool:
        """Whether the friction power heats the housing in any lane."""
        return self._friction

    def step(self, time: float, step_s: float, heat: Value, speed: Array, friction_power: Array) -> None:
        """Advance by a step of `step_s`.

        heat : into the winding [W]. speed : of the rotor [rad/s]. friction_power : [W].
        """
        self._heat[0] = heat
        for group in self._bound["housing_heat"]:
            self._heat[1, group.lanes] = group.effect.housing_heat(friction_power[group.lanes])
        ambient = self.true_ambient(time)
        before = self._state.copy()
        first = self._rates(ambient, speed)
        self._state += step_s * first
        second = self._rates(ambient, speed)
        np.add(before, 0.5 * step_s * (first + second), out=self._state)

    def true_ambient(self, time: float) -> Array:
        """True ambient temperature [degC]; an effect may move it away from the logged one."""
        if not self._bound["ambient_error"]:
            return self.logged_ambient
        ambient = self.logged_ambient.copy()
        for group in self._bound["ambient_error"]:
            ambient[group.lanes] += group.effect.ambient_error(time)
        return ambient

    def _rates(self, ambient: Array, speed: Array) -> Array:
        winding, housing, fixture = self._state
        conductance = self._housing_ambient
        if self._bound["housing_conductance"]:
            conductance = conductance.copy()
            for group in self._bound["housing_conductance"]:
                span = group.lanes
                conductance[span] *= group.effect.housing_conductance((housing - ambient)[span], speed[span])
        across = self._winding_housing * (winding - housing)
        into_fixture = self._fixed * (housing - fixture)
        flows = self._heat.copy()
        flows[0] -= across + self._winding_ambient * (winding - ambient)
        flows[1] += across - conductance * (housing - ambient) - into_fixture
        flows[2] += into_fixture
        flows *= self._per_capacitance
        return flows

    def camera(self) -> Array:
        """Winding and housing temperatures as the camera reads them [degC], shape (2, lanes)."""
        readings = self._state[:2].copy()
        for group in self._bound["camera_reading"]:
            ambient = self.logged_ambient[group.lanes]
            readings[:, group.lanes] = group.effect.camera_reading(readings[:, group.lanes], ambient)
        return readings
