"""Runs of hours: a free joint with 14 channels, stepped in many lanes side by side, as long as anybody wants.

    python -m tests.gap.nights FOLDER [--rows 2650000] [--runs 2] [--effect drag]

writes `night-1.h5` ... and `nominal.yaml`. A lane begins some time constants early, so that it has forgotten its start
where the one before it ends; the angle goes on from lane to lane.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import yaml

from leactl.runfile import layout

RATE, PARTS = 1000.0, 4  # samples a second, steps in a sample
LANE, EARLY = 2000, 6000  # samples of a lane, and before it
BLOCK = 1_000_000  # samples that are made at once
CONSTANT, INERTIA, DAMPING, FRICTION = 0.4, 2.5e-3, 0.02, 0.15
RESISTANCE, INDUCTANCE, COPPER, LOOP, FILTER = 0.6, 2e-4, 0.0039, 150.0, 120.0
TOP, COUNT = 4.0, 2.0 * np.pi / 2**16
WINDING, HOUSING, INWARD, OUTWARD, BESIDE = 30.0, 400.0, 0.8, 1.6, 6.0  # J/K, J/K, K/W, K/W, K/W
DRAG = 3e-4  # N*m*s^2/rad^2
RUN_IN = 0.15  # of a run, in which its friction settles
HEATED = 10  # samples, over which heat is held
SEGMENT_S = 20.0  # of a programme of levels, ramps and waves
EFFECTS = ("none", "drag", "run-in", "clutch")  # the last one stands in no vocabulary
CHANNELS = {
    "q_axis_current_reference": ("A", "test", "instant"),
    "q_axis_current": ("A", "test", "mean"),
    "d_axis_current": ("A", "test", "mean"),
    "q_axis_voltage": ("V", "test", "instant"),
    "d_axis_voltage": ("V", "test", "instant"),
    "velocity": ("rad/s", "test", "instant"),
    "angle": ("rad", "test", "instant"),
    "bus_voltage": ("V", "bench", "instant"),
    "bus_current": ("A", "bench", "instant"),
    "drive_temperature": ("degC", "test", "instant"),
    "drive_enabled": ("1", "test", "instant"),
    "winding_temperature": ("degC", "test", "instant"),
    "housing_temperature": ("degC", "test", "instant"),
    "ambient_temperature": ("degC", "bench", "instant"),
}


@dataclass
class Night:
    """One run as it grows."""

    seed: int
    effect: str
    lasts: float  # s
    angle: float = 0.0
    winding: float = 25.0
    housing: float = 25.0

    def asked(self, at):
        """Current reference [A] at samples that may lie before the first."""
        time = np.maximum(at, 0) / RATE
        segment = (time / SEGMENT_S).astype(int)
        draw = np.random.default_rng(self.seed).uniform(-1.0, 1.0, (int(segment.max()) + 1, 3))
        level, wave, kind = draw[segment].T
        within = time / SEGMENT_S - segment
        ramp = np.sin(2.0 * np.pi * within)
        waves = sum(np.sin(2 * np.pi * (f * time + wave)) for f in (0.4, 1.1, 2.3, 4.7)) / 2.5
        return TOP * np.where(kind < -0.3, level, np.where(kind < 0.3, ramp, waves))

    def columns(self, first, count):
        """Channels of some samples; called for one block after the other."""
        lanes = -(-count // LANE)
        at = first - EARLY + LANE * np.arange(lanes)[:, None] + np.arange(EARLY + LANE)
        asked, flowing, mean, speed, reading, turned = self.stepped(at)
        flat = [values[:, EARLY:].reshape(-1)[:count] for values in (asked, flowing, mean, speed, reading, turned)]
        asked, flowing, mean, speed, reading, turned = flat
        angle = self.angle + np.cumsum(turned)
        self.angle = float(angle[-1])
        winding, housing = self.warmed(mean)
        draw = np.random.default_rng([self.seed, first])
        resistance = RESISTANCE * (1.0 + COPPER * (winding - 25.0))
        rising = 2.0 * np.pi * LOOP * (asked - flowing)
        volts = resistance * flowing + CONSTANT * speed + INDUCTANCE * rising
        none = np.zeros(count)
        return {
            "q_axis_current_reference": asked,
            "q_axis_current": mean + 8e-3 * draw.standard_normal(count),
            "d_axis_current": 8e-3 * draw.standard_normal(count),
            "q_axis_voltage": volts + 0.02 * draw.standard_normal(count),
            "d_axis_voltage": 0.02 * draw.standard_normal(count),
            "velocity": reading + 0.05 * draw.standard_normal(count),
            "angle": np.round(angle / COUNT) * COUNT,
            "bus_voltage": 96.0 + 0.02 * draw.standard_normal(count),
            "bus_current": mean * volts / 96.0 + 0.01 * draw.standard_normal(count),
            "drive_temperature": 30.0 + 0.2 * draw.standard_normal(count),
            "drive_enabled": none + 1.0,
            "winding_temperature": winding + 0.1 * draw.standard_normal(count),
            "housing_temperature": housing + 0.1 * draw.standard_normal(count),
            "ambient_temperature": none + 25.0,
        }

    def stepped(self, at):
        """Reference, current and its mean, speed, its reading, and the turn of each sample, for all lanes at once."""
        asked = np.stack([self.asked(lane) for lane in at])
        step = 1.0 / RATE / PARTS
        follows, filters = -np.expm1(-2.0 * np.pi * np.array([LOOP, FILTER]) * step)
        out = np.empty((6, *at.shape))
        flowing, speed, reading = np.zeros((3, len(at)))
        for sample in range(at.shape[1]):
            wanted, mean, turned = asked[:, sample], 0.0, 0.0
            rubs = self.rubs(at[:, sample] / RATE)
            held = FRICTION * rubs * step / INERTIA
            for _ in range(PARTS):
                before = flowing
                flowing = flowing + follows * (wanted - flowing)
                mean = mean + (before + flowing) / (2.0 * PARTS)
                ahead = speed + (CONSTANT * flowing - rubs * DAMPING * speed - self.drags(speed)) * step / INERTIA
                after = ahead - np.clip(ahead, -held, held)
                turned = turned + 0.5 * (speed + after) * step
                speed = after
                reading = reading + filters * (speed - reading)
            out[:, :, sample] = wanted, flowing, mean, speed, reading, turned
        return out

    def rubs(self, time):
        """Friction over what it settles to."""
        return 1.0 + (1.0 * np.exp(-np.maximum(time, 0.0) / (RUN_IN * self.lasts)) if self.effect == "run-in" else 0.0)

    def drags(self, speed):
        """Torque against the motion besides friction."""
        if self.effect == "drag":
            return DRAG * speed * np.abs(speed)
        if self.effect == "clutch":  # slips and grips as the speed rises
            return 0.25 * np.sin(speed / 4.0) * np.exp(-((speed / 25.0) ** 2))
        return 0.0

    def warmed(self, current):
        """Temperatures of winding and housing, of each sample: a network whose heat is held over a few."""
        starts = np.arange(0, len(current), HEATED)
        squared = np.add.reduceat(current**2, starts) / np.diff(np.append(starts, len(current)))
        nodes = np.empty((len(starts) + 1, 2))
        lasts = HEATED / RATE
        for step, heating in enumerate(squared.tolist()):
            nodes[step] = self.winding, self.housing
            heat = RESISTANCE * (1.0 + COPPER * (self.winding - 25.0)) * heating
            inward, outward = (self.winding - self.housing) / INWARD, (self.housing - 25.0) / OUTWARD
            self.winding += (heat - inward - (self.winding - 25.0) / BESIDE) / WINDING * lasts
            self.housing += (inward - outward) / HOUSING * lasts
        nodes[-1] = self.winding, self.housing
        at = (np.arange(len(current)) + 1) / HEATED
        return tuple(np.interp(at, np.arange(len(nodes)), node) for node in nodes.T)


def write_night(path, rows, effect="none", seed=1, protocol="night"):
    """Write one run, uncompressed and with checksums."""
    night = Night(seed, effect, rows / RATE)
    with h5py.File(path, "w", libver=layout.HDF5_FORMAT) as file:
        told = {"format": layout.FORMAT, "format_version": layout.VERSION, "run_id": path.stem, "protocol": protocol}
        file.attrs.update(told | {"status": "complete", "condition": "design", "simulated": 1})
        file.create_group("setup").attrs["mechanical"] = "free"
        stream = file.create_group("streams/loop")
        stream.create_dataset("time", (rows,), "f8").make_scale("time")
        for name, (units, role, sampling) in CHANNELS.items():
            column = stream.create_dataset(name, (rows,), "f8")
            column.attrs.update({"quantity": name, "role": role, "units": units, "sampling": sampling})
            column.attrs.update({"device": "drive", "long_name": name})
            column.dims[0].attach_scale(stream["time"])
        for first in range(0, rows, BLOCK):
            count = min(BLOCK, rows - first)
            stream["time"][first : first + count] = (first + 1 + np.arange(count)) / RATE
            for name, values in night.columns(first, count).items():
                stream[name][first : first + count] = values
        for _, column in layout.datasets(file):
            column.attrs["sha256"] = layout.digest(column)


def write_model(path):
    """Write a model that is off the joint by what is usual, and lacks its effects."""
    model = {
        "name": "joint of a night",
        "torque_constant": 0.97 * CONSTANT,
        "back_emf_constant": 0.97 * CONSTANT,
        "rotor_inertia": 1.08 * INERTIA,
        "viscous_damping": 0.9 * DAMPING,
        "coulomb_friction": 1.1 * FRICTION,
        "phase_resistance": 1.02 * RESISTANCE,
        "phase_inductance": INDUCTANCE,
        "resistance_coefficient": COPPER,
        "reference_temperature": 25.0,
        "thermal": {
            "winding_ambient_resistance": 1.1 * BESIDE,
            "winding_housing_resistance": 1.05 * INWARD,
            "housing_ambient_resistance": 0.95 * OUTWARD,
            "winding_capacitance": WINDING,
            "housing_capacitance": HOUSING,
        },
        "bench": {"current_loop_bandwidth": LOOP, "velocity_filter_bandwidth": FILTER, "bus_voltage": 96.0},
    }
    path.write_text(yaml.safe_dump(model, sort_keys=False))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rows", type=int, default=2_650_000)
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--effect", choices=EFFECTS, default="drag")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    write_model(given.folder / "nominal.yaml")
    for number in range(1, given.runs + 1):
        write_night(given.folder / f"night-{number}.h5", given.rows, given.effect, number)
