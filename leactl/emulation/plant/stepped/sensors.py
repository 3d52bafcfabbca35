"""Convert simulated signals to recorded channels: noise, encoder counts, resolution, and faults over a whole run."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leactl.emulation.plant.stepped.heating import HeatedRun
from leactl.emulation.plant.stepped.lanes import Array, Lane
from leactl.emulation.plant.stepped.simulation import CAMERA_TICKS, DriveSignals

ENCODER_COUNTS = 40000  # per turn
RESOLUTION = {  # A, V, rad/s, N*m and K
    "q_axis_current": 0.002,
    "q_axis_voltage": 0.005,
    "velocity": 0.001,
    "torque": 0.000375,
    "bus_voltage": 0.005,
    "temperature": 0.01,
    "line_current": 0.002,
    "line_voltage": 0.005,
}


@dataclass(frozen=True)
class Spread:
    """Standard deviations of the sensors' noise; velocities have it in the run already, since the servo reads them."""

    q_axis_current: float = 0.02  # A
    q_axis_voltage: float = 0.03  # V
    velocity: float = 0.01  # rad/s
    torque: float = 0.008  # N*m
    bus_voltage: float = 0.02  # V
    temperature: float = 0.15  # K
    line_current: float = 0.01  # A
    line_voltage: float = 0.012  # V


class Sensors:
    """The sensors of one run, which make recorded channels of simulated signals."""

    def __init__(self, lane: Lane, spread: Spread, seed: int) -> None:
        self._lane, self._spread = lane, spread
        self._generator = np.random.default_rng([seed, 2])

    def loop(self, signals: DriveSignals) -> dict[str, Array]:
        """Return the channels of the drives' stream at 1 kHz, by name."""
        setup = self._lane.setup
        time = np.arange(1, len(signals.angle) + 1, dtype=np.float64) * 1e-3
        angle = signals.angle
        for effect in self._lane.effects:
            angle = effect.angle_record(angle[:, None], time[:, None])[:, 0]
        radians_per_count = 2.0 * np.pi / ENCODER_COUNTS
        channels = {
            "time": time,
            "current_reference": np.asarray(signals.reference, np.float64),
            "current": self._noisy("q_axis_current", signals.current),
            "voltage": self._noisy("q_axis_voltage", signals.voltage),
            "velocity": self._rounded("velocity", signals.velocity),
            "angle": np.floor(angle / radians_per_count + 0.5) * radians_per_count,
            "bus_voltage": self._noisy("bus_voltage", signals.bus_voltage),
        }
        if setup in ("locked", "coupled"):
            torque = np.asarray(signals.torque, np.float64)
            for effect in self._lane.effects:
                torque = effect.torque_record(torque[:, None], signals.angle[:, None], time[:, None])[:, 0]
            channels["torque"] = self._noisy("torque", torque)
        if setup == "coupled":
            channels["load_current"] = self._noisy("q_axis_current", signals.load_current)
            channels["load_velocity"] = self._rounded("velocity", signals.load_velocity)
        return channels

    def camera(self, signals: DriveSignals) -> dict[str, Array]:
        """Return the channels of the camera at 10 Hz in a run of the drives, by name."""
        time = np.arange(len(signals.winding), dtype=np.float64) * 1e-3 * CAMERA_TICKS + 1e-3
        return {"time": time, **self._temperatures(signals.winding, signals.housing)}

    def heated(self, run: HeatedRun) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return the channels of camera and supply in a heated run, by name, one value a second."""
        time = np.arange(len(run.current), dtype=np.float64)
        supply = {
            "time": time,
            "line_current": self._noisy("line_current", run.current),
            "line_voltage": self._noisy("line_voltage", run.voltage),
        }
        return {"time": time, **self._temperatures(run.winding, run.housing)}, supply

    def _temperatures(self, winding: NDArray[np.floating], housing: NDArray[np.floating]) -> dict[str, Array]:
        """Return the temperature channels of the camera, by name."""
        ambient = np.full(len(winding), self._lane.bench.ambient_temperature)
        return {
            "winding": self._noisy("temperature", winding),
            "housing": self._noisy("temperature", housing),
            "ambient": self._noisy("temperature", ambient),
        }

    def _noisy(self, sensor: str, values: NDArray[np.floating]) -> Array:
        """Add a sensor's noise to values, and round them to its resolution."""
        noise = getattr(self._spread, sensor) * self._generator.standard_normal(len(values))
        return self._rounded(sensor, values + noise)

    def _rounded(self, sensor: str, values: NDArray[np.floating]) -> Array:
        """Round values to a sensor's resolution."""
        step = RESOLUTION[sensor]
        rounded: Array = np.rint(np.asarray(values, np.float64) / step) * step
        return rounded
