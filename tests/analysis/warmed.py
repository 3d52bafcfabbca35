"""Records of a winding that a direct current warms by two exponentials, read with a display's steps."""

import numpy as np

from leactl.quantities import ChannelSpec
from leactl.runfile.write.writer import RunInfo, RunWriter

LEADS, ALPHA = 0.528, 0.004  # ohm at 25 degC, 1/K
BEFORE = 10.0  # s of rest
MODEL = "resistance_coefficient: 0.004\nreference_temperature: 25.0\ntolerances: {resistance_coefficient: 0.0}\n"
FAST, SLOW = (12.0, 6.5), (60.0, 620.0)  # K and s


def rise(time, slow=SLOW, fast=FAST):
    return fast[0] * (1 - np.exp(-time / fast[1])) + slow[0] * (1 - np.exp(-time / slow[1]))


def warmed(bench, *, lasts=4500.0, amperes=8.0, cold=25.0, slow=SLOW, fast=FAST, step=0.01, air=(), sign=1.0,
           model=MODEL, lack="", air_role="test", alpha=ALPHA, leads=LEADS, gains=(1.0, 1.0), noise=0.0):  # fmt: skip
    """Write a record of heating for some time, and return its path.

    `gains` are those of the readings of voltage and current, `noise` [V] is of single readings before their steps.
    """
    bench.count += 1
    into = np.concatenate([np.arange(0.0, 5.0, 1 / 30), np.arange(5.0, lasts, 1.0)])
    into = into[into < lasts]
    volts = sign * amperes * leads * (1 + alpha * (cold - 25.0 + rise(into, slow, fast)))
    volts = gains[0] * volts + bench.rng.normal(0.0, noise, len(into))
    rest = np.arange(0.0, BEFORE, 1 / 30)
    shown = {
        "line_voltage": np.concatenate([np.zeros_like(rest), step * np.round(volts / step) if step else volts]),
        "line_current": np.concatenate([np.zeros_like(rest), np.full_like(into, gains[1] * amperes)]),
    }
    info = RunInfo(
        run_id=f"20261120T101530Z-winding-rise-{bench.count:04d}",
        protocol="winding-rise",
        bench="b",
        actuator="a1",
        condition="",
        operator="",
        simulated=True,
        mechanical="heated",
        software="",
        created="2026-11-20T10:15:30Z",
        sources={"protocol": "name: x\nanalysis: winding-rise\n", "model": model},
    )
    names = [name for name in shown if name != lack]
    streams = {"supply": tuple(ChannelSpec(name, name, "test", "s", dtype="f8") for name in names)}
    if len(air):
        streams["air"] = (ChannelSpec("ambient", "ambient_temperature", air_role, "t", dtype="f8"),)
    writer = RunWriter(bench.directory, info, streams)
    time = np.concatenate([rest, BEFORE + into])
    writer.append("supply", time, np.column_stack([shown[name] for name in names]))
    if len(air):
        writer.append("air", np.arange(len(air), dtype=float), np.asarray(air, float)[:, np.newaxis])
    writer.close("complete", "")
    return writer.path
