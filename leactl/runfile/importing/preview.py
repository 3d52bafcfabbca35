"""Show an import before it is written: each run with its streams, ranges of channels and steps."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from leactl.runfile.importing.importer import ImportedRun
from leactl.runfile.importing.streams import Stream


def preview(run: ImportedRun, target: Path) -> dict[str, Any]:
    """Return what an import of one run would write, as JSON takes it."""
    return {
        "file": str(target),
        "created": run.info.created,
        "mechanical": run.info.mechanical,
        "protocol": run.info.protocol,
        "actuator": run.info.actuator,
        "setup": dict(run.info.setup),
        "parameters": dict(run.info.parameters),
        "streams": {name: stream_preview(stream) for name, stream in run.streams.items()},
        "steps": [
            {"name": step.name, "start_s": step.start, "stop_s": step.stop, "settle_s": step.settle}
            | {"parameters": step.parameters}
            for step in run.steps
        ],
    }


def stream_preview(stream: Stream) -> dict[str, Any]:
    """Return what an import of one stream would write, as JSON takes it."""
    channels = []
    for spec, values in zip(stream.specs, stream.values, strict=True):
        finite_values = values[np.isfinite(values)]
        low, high = (float(finite_values.min()), float(finite_values.max())) if len(finite_values) else (None, None)
        description = {"name": spec.name, "quantity": spec.quantity, "role": spec.role, "units": spec.unit}
        channels.append(description | {"low": low, "high": high, "missing": len(values) - len(finite_values)})
    return {
        "rows": len(stream.time),
        "start_s": float(stream.time[0]),
        "stop_s": float(stream.time[-1]),
        "interval_s": float(np.median(np.diff(stream.time))),
        "aligned": stream.aligned,
        "channels": channels,
    }


def preview_lines(description: dict[str, Any]) -> Iterator[str]:
    """Yield the lines that show a run, from the object of `preview`."""
    yield f"{description['file']}: {description['mechanical']}, created {description['created']}; not written"
    for name in ("protocol", "actuator"):
        if description[name]:
            yield f"  {name} {description[name]}"
    for name, value in (description["setup"] | description["parameters"]).items():
        yield f"  {name} = {value}"
    for name, stream in description["streams"].items():
        aligned_text = f"; {stream['aligned']}" if stream["aligned"] else ""
        span = f"{stream['start_s']:.6g} .. {stream['stop_s']:.6g} s, every {stream['interval_s']:.4g} s"
        yield f"  stream {name}: {stream['rows']} rows, {span}{aligned_text}"
        for channel in stream["channels"]:
            numbers = "no number" if channel["low"] is None else f"{channel['low']:.6g} .. {channel['high']:.6g}"
            missing_text = f", {channel['missing']} missing" if channel["missing"] else ""
            summary = f"{numbers} {channel['units']}{missing_text}"
            yield f"    {channel['name']:<12} {channel['role']:<6} {channel['quantity']:<26} {summary}"
    yield f"  {len(description['steps'])} steps"
    for step in description["steps"]:
        parameters = ", ".join(
            f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in step["parameters"].items()
        )
        yield f"    {step['name']:<12} {step['start_s']:.6g} .. {step['stop_s']:.6g} s  {parameters}".rstrip()
