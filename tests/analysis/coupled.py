"""Runs of two coupled actuators with known parameters, from the equations alone: one drives, the other is driven.

Each hold settles for half a second with readings that are far off, so that an analysis that takes them in shows.
"""

from dataclasses import dataclass, field

import numpy as np

from leactl.quantities import UNITS, ChannelSpec
from leactl.runfile.write.writer import RunInfo, RunWriter

SPEEDS, CURRENTS = (5.0, 15.0, 25.0), (2.0, 8.0, 14.0, 20.0)
RATE_HZ, ZERO_S, HOLD_S, SETTLE_S = 50, 4.0, 2.5, 0.5
FAR_OFF = 77.0
MODEL = "phase_resistance: 0.264\nback_emf_constant: 0.49\nresistance_coefficient: 0.004\nreference_temperature: 25\n"
NOISE = {"q_axis_current": 0.015, "velocity": 0.002, "torque": 0.004, "q_axis_voltage": 0.02}


@dataclass(frozen=True)
class Truth:
    """Two equal actuators: currents, voltages and torque at a speed and a current of the driven one."""

    r: float = 0.264
    kt: float = 0.49
    b: float = 0.0238
    f: float = 0.208

    def drag(self, w):
        return self.b * w + self.f

    def torque(self, w, i):
        """What the shaft carries [N*m]."""
        return self.kt * i + self.drag(w)

    def driving(self, w, i):
        """Current, electrical power, mechanical power of the one that drives."""
        own = (self.torque(w, i) + self.drag(w)) / self.kt
        return own, (self.r * own + self.kt * w) * own, self.torque(w, i) * w

    def driven(self, w, i):
        """The same of the one that is driven, electrical power positive where it gives some."""
        return i, (self.kt * w - self.r * i) * i, self.torque(w, i) * w

    def efficiencies(self, speeds=SPEEDS, currents=CURRENTS):
        """Over the grid, driving and driven."""
        w, i = np.meshgrid(speeds, currents, indexing="ij")
        _, taken, given = self.driving(w, i)
        _, back, brought = self.driven(w, i)
        return given / taken, back / brought


@dataclass
class CoupledBench:
    """Writes runs into a directory; `rng` makes their noise."""

    directory: object
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    count: int = 0

    def run(
        self,
        truth=None,
        *,
        driver="test",
        speeds=SPEEDS,
        currents=CURRENTS,
        repeats=1,
        noise=1.0,
        zero=0.0,
        voltages=False,
        link=None,
        without=(),
        skip=(),
        model=MODEL,
        edit=None,
        edit_steps=None,
    ):
        """Write a run and return its path.

        `noise` scales that of the readings, `zero` is the torque sensor's [N*m], `link` the loss of both drives [W]
        where the current of the DC link is measured; `skip` are (repeat, speed, current) that were never run; `edit`
        may change the columns (time, columns), `edit_steps` the list of (name, start, stop, settle, parameters).
        """
        truth, self.count = truth or Truth(), self.count + 1
        holds = [(n, w, i) for n in range(1, repeats + 1) for w in speeds for i in currents if (n, w, i) not in skip]
        other = {"test": "load", "load": "test"}[driver]
        steps = [("zero", 0.0, ZERO_S, 0.0, {})]
        rows = [dict.fromkeys(("w", "test", "load", "vtest", "vload", "torque", "link"), 0.0)] * round(ZERO_S * RATE_HZ)
        for k, (n, w, i) in enumerate(holds):
            start = ZERO_S + k * HOLD_S
            told = {"velocity_rad_s": w, "current_A": -i, "role": other, "repeat": n}
            steps.append(("hold", start, start + HOLD_S, SETTLE_S, told))
            mine, taken, _ = truth.driving(w, i)
            _, back, _ = truth.driven(w, i)
            row = {
                "w": w, driver: mine, other: -i, f"v{driver}": taken / mine, f"v{other}": truth.kt * w - truth.r * i,
                "torque": truth.torque(w, i) * (1.0 if driver == "test" else -1.0),
                "link": (taken - back + (link or 0.0)) / 29.6,
            }  # fmt: skip
            rows += [dict.fromkeys(row, FAR_OFF)] * round(SETTLE_S * RATE_HZ)
            rows += [row] * round((HOLD_S - SETTLE_S) * RATE_HZ)
        names = {"velocity": ("w", "test"), "q_axis_current": ("test", "test"), "load_current": ("load", "load")}
        names |= {"torque": ("torque", "test"), "load_velocity": ("w", "load")}
        if voltages:
            names |= {"q_axis_voltage": ("vtest", "test"), "load_voltage": ("vload", "load")}
        if link is not None:
            names |= {"bus_current": ("link", "bench"), "bus_voltage": ("bus", "bench")}
        kinds = {"load_current": "q_axis_current", "load_velocity": "velocity", "load_voltage": "q_axis_voltage"}
        time, columns, specs = np.arange(len(rows)) / RATE_HZ, {}, []
        for name, (source, role) in names.items():
            if name in without:
                continue
            quantity = kinds.get(name, name)
            exact = np.array([row.get(source, 29.6) for row in rows])
            columns[name] = exact + self.rng.normal(0.0, noise * NOISE.get(quantity, 0.0) or 0.0, len(time))
            specs.append(ChannelSpec(name, quantity, role, "d", units=UNITS[quantity], dtype="f8"))
        columns["torque"] += zero
        if edit is not None:
            edit(time, columns)
        if edit_steps is not None:
            edit_steps(steps)
        info = RunInfo(
            run_id=f"20261120T101530Z-efficiency-{self.count:04d}",
            protocol="efficiency",
            bench="synthetic",
            actuator="a1",
            condition="design",
            operator="",
            simulated=True,
            mechanical="coupled",
            software="",
            created="2026-11-20T10:15:30Z",
            sources={"protocol": "name: x\nanalysis: efficiency\n"} | ({"model": model} if model else {}),
        )
        writer = RunWriter(self.directory, info, {"loop": specs})
        writer.append("loop", time, np.column_stack(list(columns.values())))
        for step in steps:
            writer.step(*step)
        writer.close("complete", "")
        return writer.path
