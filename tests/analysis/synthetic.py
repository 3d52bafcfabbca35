"""Run files with known parameters, made from the equations alone: nothing here comes from the emulated bench.

Each hold settles for half a second with readings that are far off, so that an analysis that takes them in shows.
"""

from dataclasses import dataclass, field

import numpy as np

from leactl.quantities import UNITS, ChannelSpec
from leactl.runfile.read.reader import Run
from leactl.runfile.write.writer import RunInfo, RunWriter

TORQUE_LEVELS = (4.9, 9.8, 14.7, 19.6, 24.5)
FRICTION_LEVELS = (0.6, 0.635, 0.67, 0.705, 0.74)
HOLD_S, SETTLE_S = 2.5, 0.5
FAR_OFF = 77.0


@dataclass
class Bench:
    """Writes runs into a directory; `rng` makes their noise."""

    directory: object
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    count: int = 0

    def run(
        self,
        experiment,
        holds,
        levels,
        *,
        rate_Hz=50,  # noqa: N803
        noise=0.0,
        edit=None,
        role="test",
        repeats=None,
        key="current_A",
        hold_s=HOLD_S,
        settle_s=SETTLE_S,
        before_s=0.0,
        **how,
    ):
        """Write a run and return its path.

        `holds` are (setpoint, direction), `key` is what their setpoint is told by, `levels` map a quantity to its value
        in each hold, `noise` is the standard deviation of single readings, one for all or by quantity; `edit` may
        change the columns before they are written. Before the first hold all read zero and noise for `before_s`.
        """
        per_hold, before = round(hold_s * rate_Hz), round(before_s * rate_Hz)
        time = np.arange(before + len(holds) * per_hold) / rate_Hz
        columns = {}
        for name, values in levels.items():
            deviation = noise.get(name, 0.0) if isinstance(noise, dict) else noise
            column = np.concatenate([np.zeros(before), np.repeat(np.asarray(values, float), per_hold)])
            column += self.rng.normal(0.0, deviation, len(time))
            settling = np.arange(len(time) - before) % per_hold < round(settle_s * rate_Hz)
            column[before:][settling] = FAR_OFF
            columns[name] = column
        if edit is not None:
            edit(time, columns)
        steps = []
        for index, (setpoint, direction) in enumerate(holds):
            told = {key: setpoint, "role": role} | ({"direction": direction} if direction else {})
            told |= {} if repeats is None else {"repeat": int(repeats[index])}
            start, stop = ((before + (index + k) * per_hold) / rate_Hz for k in (0, 1))  # as the stamps have them
            steps.append(("hold", start, stop, settle_s, told))
        return self.write(experiment, time, columns, steps, **how)

    def write(
        self,
        experiment,
        time,
        columns,
        steps,
        *,
        mechanical="coupled",
        actuator="a1",
        condition="design",
        torque_constant=0.49,
        status="complete",
        units=None,
        protocol="",
        model="",
        resolution=None,
        scale_std=0.0,
        parameters=None,
    ):
        """Write columns of the test actuator by quantity, and steps as the run file has them; return its path.

        `resolution` is the step between two readings of a quantity, `scale_std` what every channel says of its own.
        """
        self.count += 1
        for name, step in (resolution or {}).items():
            columns[name] = step * np.round(columns[name] / step)
        specs = [
            ChannelSpec(
                name, name, "test", "d", units=(units or {}).get(name, UNITS[name]), dtype="f8", scale_std=scale_std
            )
            for name in columns
        ]
        sources = {"protocol": protocol or f"name: x\nanalysis: {experiment}\n"}
        if torque_constant is not None:
            sources["model"] = f"torque_constant: {torque_constant}\n{model}"
        info = RunInfo(
            run_id=f"20261120T101530Z-{experiment}-{self.count:04d}",
            protocol=experiment,
            bench="synthetic",
            actuator=actuator,
            condition=condition,
            operator="",
            simulated=True,
            mechanical=mechanical,
            software="",
            created="2026-11-20T10:15:30Z",
            sources=sources,
            parameters=parameters or {},
        )
        writer = RunWriter(self.directory, info, {"loop": specs})
        writer.append("loop", time, np.column_stack(list(columns.values())))
        for step in steps:
            writer.step(*step)
        writer.close(status, "" if status == "complete" else "as the test says")
        return writer.path

    def torque(
        self,
        *,
        kt=0.49,
        sticking=0.2,
        offset=0.05,
        levels=TORQUE_LEVELS,
        trials=3,
        sides=("rising", "falling"),
        scatter=0.0,
        curve=0.0,
        current_error=0.0,
        **how,
    ):
        """A torque constant run: `scatter` moves single holds, `curve` what a level has in all its repeats [N*m].

        `kt` is one value, or one a trial.
        """
        holds = [
            (level, side)
            for _ in range(trials)
            for side in sides
            for level in (levels if side != "falling" else levels[::-1])
        ]
        current = np.array([level for level, _ in holds])
        sign = np.array([{"rising": 1, "falling": -1}.get(side, 0) for _, side in holds])
        cells = {hold: self.rng.normal(0.0, curve) for hold in dict.fromkeys(holds)}
        each = len(holds) // trials
        torque = (
            np.repeat(np.broadcast_to(kt, trials), each) * current
            + sticking * sign
            + offset
            + self.rng.normal(0.0, scatter, len(holds))
        )
        torque += np.array([cells[hold] for hold in holds])
        measured = current + self.rng.normal(0.0, current_error, len(holds))
        how = {"repeats": 1 + np.arange(len(holds)) // each} | how
        return self.run("torque-constant", holds, {"q_axis_current": measured, "torque": torque}, **how)

    def friction(
        self,
        *,
        b=0.0238,
        f=0.208,
        zero_A=0.0,  # noqa: N803
        kt=0.49,
        levels=FRICTION_LEVELS,
        trials=3,
        signs=(1, -1),
        scatter=0.0,
        **how,
    ):
        """A friction run: `scatter` moves the friction of single holds [N*m], `zero_A` the reading of current.

        `b` and `f` are one value each, or one a trial.
        """
        holds = [(sign * level, "") for _ in range(trials) for sign in signs for level in levels]
        current = np.array([setpoint for setpoint, _ in holds])
        each = len(holds) // trials
        b, f = (np.repeat(np.broadcast_to(value, trials), each) for value in (b, f))
        drag = f + self.rng.normal(0.0, scatter, len(holds))
        velocity = np.sign(current) * np.maximum(kt * np.abs(current) - drag, 0.0) / b
        how = {"mechanical": "free", "repeats": 1 + np.arange(len(holds)) // each} | how
        return self.run("friction", holds, {"q_axis_current": current + zero_A, "velocity": velocity}, **how)


def analyzed(analyze, *paths, **options):
    """The result of an analysis of these runs."""
    runs = [Run.open(path) for path in paths]
    try:
        return analyze(runs, **options)
    finally:
        for run in runs:
            run.close()


def covered(estimate, truth):
    return estimate.low <= truth <= estimate.high
