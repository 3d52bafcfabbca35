"""Run files of control-loop experiments, made from closed forms: nothing here comes from the emulated bench."""
# ruff: noqa: N803 (a unit keeps its letter)

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from leactl.quantities import UNITS, ChannelSpec
from leactl.runfile.write.writer import RunInfo, RunWriter
from tests.loops import current_step

RATE = 1000
BANDWIDTH, LEAD, LEAD_TIME = 264.0, 0.0892, 0.0598
LEVELS = (2.5, 5.0, 7.5)
REST_S, TRIAL_S, SETTLE_S = 0.5, 2.5, 1.5
NOISE_S, HEAD_S = 8.7, 0.508


def paper_loop(time):
    """The answer of a loop with the paper's figures to a step of one."""
    return current_step(time, BANDWIDTH, LEAD, LEAD_TIME)


def ringing(natural, damping):
    """The step response of a second-order loop [rad/s, of critical]."""
    damped = natural * np.sqrt(1 - damping**2)

    def answer(time):
        swing = np.cos(damped * time) + damping * natural / damped * np.sin(damped * time)
        return 1 - np.exp(-damping * natural * time) * swing

    return answer


def write(directory, experiment, columns, steps, mechanical="locked", actuator="a1"):
    """A run of one stream; `steps` are (name, start, stop, settle, parameters)."""
    specs = [ChannelSpec(name, name, "test", "d", units=UNITS[name], dtype="f8") for name in columns if name != "time"]
    info = RunInfo(
        run_id=f"20261120T101530Z-{experiment}-{len(list(directory.iterdir())):04d}",
        protocol=experiment,
        bench="synthetic",
        actuator=actuator,
        condition="design",
        operator="",
        simulated=True,
        mechanical=mechanical,
        software="",
        created="2026-11-20T10:15:30Z",
        sources={},
    )
    writer = RunWriter(directory, info, {"loop": specs})
    rows = np.column_stack([columns[spec.name] for spec in specs])
    writer.append("loop", columns["time"], rows)
    for step in steps:
        writer.step(*step)
    writer.close("complete", "")
    return writer.path


def step_run(
    directory, *, answer=paper_loop, levels=LEVELS, trials=5, noise=0.0, quantum=0.0, seed=1, edit=None, lacks=()
):
    """A current step run; `edit` may change the columns, of which those that are lacking are left out."""
    rng = np.random.default_rng(seed)
    sent = [level for _ in range(trials) for level in levels]
    per = round(TRIAL_S * RATE)
    time = np.arange(len(sent) * per + 1) / RATE
    reference, response = np.zeros(len(time)), np.zeros(len(time))
    steps = []
    for number, level in enumerate(sent):
        start = number * TRIAL_S
        rows = slice(number * per + 1, (number + 1) * per + 1)  # the first row still is of the trial before
        since = time[rows] - start - REST_S
        reference[rows] = np.where(since > 1e-9, level, 0.0)
        response[rows] = np.where(since > 0, level * answer(np.maximum(since, 0)), 0.0)
        told = {"kind": "step", "from_current_A": 0.0, "to_current_A": level, "at_s": REST_S, "role": "test"}
        steps.append(("step", start, start + TRIAL_S, SETTLE_S, told | {"repeat": number}))
    response += rng.normal(0.0, noise, len(time))
    if quantum:
        response = quantum * np.round(response / quantum)
    columns = {"time": time, "q_axis_current_reference": reference, "q_axis_current": response}
    if edit is not None:
        edit(columns)
    return write(directory, "current-step", {name: c for name, c in columns.items() if name not in lacks}, steps)


def noise_run(
    directory,
    *,
    pole_Hz=8.0,
    cutoff_Hz=40.0,
    noise=0.0,
    levels=(1.0, 2.0),
    trials=3,
    seed=1,
    edit=None,
    sign=1.0,
    rate=RATE,
    lag=0.0,
):
    """A position noise run of a first-order loop with its reference held, and noise of its readings.

    The drive acts on a reference a `lag` of a sample after its row.
    """
    rng = np.random.default_rng(seed)
    decay = np.exp(-2 * np.pi * pole_Hz / rate)
    late = decay ** (1 - lag)
    columns = {"time": [], "angle_reference": [], "angle": []}
    steps, start = [], 0.0
    for number in range(trials):
        for level in levels:
            count = round(NOISE_S * rate)
            given = 0.1 * _unit(sosfilt(butter(10, cutoff_Hz, fs=rate, output="sos"), rng.standard_normal(count)))
            answer = level + lfilter([1 - late, late - decay], [1, -decay], given)
            columns["time"].append(start + np.arange(1, count + 1) / rate)
            columns["angle_reference"].append(level + given)
            columns["angle"].append(sign * answer + rng.normal(0.0, noise, count))
            told = {"kind": "noise", "offset_rad": level, "cutoff_Hz": cutoff_Hz, "role": "test"}
            told |= {"seed": 100 * number + round(level), "repeat": number}
            steps.append(("noise", start, start + NOISE_S, HEAD_S, told))
            start += NOISE_S
    columns = {name: np.concatenate(parts) for name, parts in columns.items()}
    if edit is not None:
        edit(columns)
    return write(directory, "position-noise", columns, steps, "free")


def _unit(values):
    return values / values.std()
