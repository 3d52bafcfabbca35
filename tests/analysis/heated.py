"""Heated runs with known parameters: three phases and a housing, solved by the exponential of their matrix.

Nothing here comes from leactl's own networks: phases of a third of the winding with three times its resistances, heat
R(T) i^2 in the two that carry the current, means of their readings as a camera has them.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import expm

from leactl.quantities import UNITS, ChannelSpec
from leactl.runfile.write.writer import RunInfo, RunWriter

REGIONS = ("active", "inactive", "housing")


@dataclass(frozen=True)
class Plant:
    """The paper's LEA."""

    Rwa: float = 5.6  # K/W
    Rwh: float = 0.3
    Rha: float = 1.7
    Cw: float = 22.9  # J/K
    Ch: float = 469.1
    line_resistance: float = 0.528  # ohm, at 25 degC
    alpha: float = 4e-3  # 1/K

    @property
    def parallel(self):
        return 1.0 / (1.0 / self.Rwa + 1.0 / (self.Rwh + self.Rha))

    @property
    def known(self):
        """True values by the name of the result that estimates them."""
        return {
            "winding_ambient_resistance": self.Rwa,
            "winding_housing_resistance": self.Rwh,
            "housing_ambient_resistance": self.Rha,
            "winding_capacitance": self.Cw,
            "housing_capacitance": self.Ch,
            "parallel_thermal_resistance": self.parallel,
            "line_resistance": self.line_resistance,
            "phase_resistance": self.line_resistance / 2,
            "resistance_coefficient": self.alpha,
        }


def temperatures(plant, current, ambient, interval, start=None):
    """Phases a and b, which carry the current, phase c, and housing [degC] at every sample.

    Current [A] and ambient [degC] are held over the interval that begins at each sample.
    """
    capacities, flows = conduction(plant)
    to_air = np.array([1 / (3 * plant.Rwa)] * 3 + [1 / plant.Rha])
    slope, cold = 0.5 * plant.line_resistance * plant.alpha, 0.5 * plant.line_resistance * (1 - 25.0 * plant.alpha)
    state = np.full(4, ambient[0]) if start is None else np.asarray(start, float)
    steps, out, heats = {}, np.empty((len(current), 4)), np.array([1.0, 1.0, 0.0, 0.0])
    for index, (amperes, air) in enumerate(zip(current.tolist(), ambient.tolist(), strict=True)):
        out[index] = state
        if amperes not in steps:
            whole = np.zeros((6, 6))  # temperatures, one, ambient
            whole[:4, :4] = (np.diag(heats * slope * amperes**2) - flows) / capacities[:, None]
            whole[:4, 4], whole[:4, 5] = heats * cold * amperes**2 / capacities, to_air / capacities
            steps[amperes] = expm(whole * interval)[:4]
        state = steps[amperes] @ np.array([*state, 1.0, air])
    return out


def conduction(plant):
    """Capacitances [J/K] of three phases and the housing, and what flows off each for a kelvin of each [W/K]."""
    flows = np.zeros((4, 4))
    for k in range(3):
        flows[k, k] = 1 / (3 * plant.Rwa) + 1 / (3 * plant.Rwh)
        flows[k, 3] = flows[3, k] = -1 / (3 * plant.Rwh)
    flows[3, 3] = 1 / plant.Rwh + 1 / plant.Rha
    return np.array([plant.Cw / 3] * 3 + [plant.Ch]), flows


@dataclass
class HeatedBench:
    """Writes heated runs into a directory; `rng` makes their noise."""

    directory: object
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    plant: Plant = Plant()
    count: int = 0

    def run(
        self,
        *,
        rate_Hz=5.0,  # noqa: N803
        heat_s=4500.0,
        cool_s=4500.0,
        lead_s=60.0,
        current=9.0,
        ambient=25.0,
        places=3,
        noise=0.15,
        drift=0.0,
        drift_s=60.0,
        offset=0.0,
        gain=1.0,
        lag=0.0,
        moment=0.5,
        volts=0.003,
        amperes=0.01,
        start=None,
        leave_out=(),
        edit=None,
        units=None,
        status="complete",
        model="winding: wye\nlimits: {winding_temperature: 130}\n",
        mechanical="heated",
        labels=None,
        actuator="a1",
        bench="synthetic",
    ):
        """Write a run and return its path.

        `current` is held for `heat_s` after `lead_s` without, or is a function of the time; `ambient` likewise. `noise`
        is that of a place from frame to frame, `drift` what all places share; the supply is read a `moment` after the
        current was set, a part of the pace; `edit` may change the columns before they are written.
        """
        self.count += 1
        time = np.arange(round((lead_s + heat_s + cool_s) * rate_Hz)) / rate_Hz
        heated = (time >= lead_s) & (time < lead_s + heat_s)
        flowing = current(time) if callable(current) else np.where(heated, float(current), 0.0)
        air = ambient(time) if callable(ambient) else np.full(len(time), float(ambient))
        phases = temperatures(self.plant, flowing, air, 1 / rate_Hz, start)
        heated = 0.5 * (phases[:, 0] + phases[:, 1])
        then = np.append(heated[:-1] + moment * np.diff(heated), heated[-1])
        resistance = self.plant.line_resistance * (1.0 + self.plant.alpha * (then - 25.0))
        camera = self.camera(phases, air, time, places, noise, drift, drift_s, offset, gain)
        camera |= {"ambient": air + self.rng.normal(0.0, 0.02, len(time))}
        supply = {
            "line_current": flowing + self.rng.normal(0.0, amperes, len(time)),
            "line_voltage": flowing * resistance + self.rng.normal(0.0, volts, len(time)),
        }
        clocks = {"camera": time + lag, "supply": time + moment / rate_Hz}
        if edit is not None:
            edit(time, camera, supply)
        for name in leave_out:
            camera.pop(name, None), supply.pop(name, None)
        streams = {"camera": camera, "supply": supply}
        specs = {
            stream: [self.spec(name, (units or {}).get(name), labels) for name in columns]
            for stream, columns in streams.items()
            if columns
        }
        info = RunInfo(
            run_id=f"20261120T101530Z-thermal-{self.count:04d}",
            protocol="thermal",
            bench=bench,
            actuator=actuator,
            condition="design",
            operator="",
            simulated=True,
            mechanical=mechanical,
            software="",
            created="2026-11-20T10:15:30Z",
            sources={"protocol": "name: thermal\nanalysis: thermal\n"} | ({"model": model} if model else {}),
        )
        writer = RunWriter(self.directory, info, specs)
        for stream in specs:
            writer.append(stream, clocks[stream], np.column_stack(list(streams[stream].values())))
        writer.close(status, "" if status == "complete" else "as the test says")
        return writer.path

    def camera(self, phases, air, time, places, noise, drift, drift_s, offset, gain):
        """What the camera has of each place."""
        shown = air[:, None] + gain * (phases - air[:, None]) + offset
        stays = np.exp(-(time[1] - time[0]) / drift_s)
        pushes = self.rng.normal(0.0, drift * np.sqrt(1 - stays**2), len(time))
        from scipy.signal import lfilter

        wander = lfilter([1.0], [1.0, -stays], pushes)
        of = {"active": (0, 1), "inactive": (2,), "housing": (3,)}
        columns = {}
        for region in REGIONS:
            for place in range(places):
                node = of[region][place % len(of[region])]
                reading = shown[:, node] + wander + self.rng.normal(0.0, noise, len(time))
                columns[f"{region}_{place + 1}"] = reading
        return columns

    @staticmethod
    def spec(name, unit, labels):
        """What a column is."""
        region = name.partition("_")[0]
        quantity = {
            "active": "winding_temperature",
            "inactive": "winding_temperature",
            "housing": "housing_temperature",
            "ambient": "ambient_temperature",
        }.get(region, name)
        role, location = ("bench", "") if region == "ambient" else ("test", name if region in REGIONS else "")
        location = (labels or {}).get(name, location)
        return ChannelSpec(name, quantity, role, "d", location=location, units=unit or UNITS[quantity], dtype="f8")
