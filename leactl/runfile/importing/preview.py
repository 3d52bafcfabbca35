"""Show an import before it is written: each run with its streams, ranges of channels and steps."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from leactl.runfile.importing.importer import ImportedRun
from leactl.runfile.importing.streams import Stream


def preview(run: ImportedRun, target: Path) -> dict[str, Any]:
    """Return one run as a JSON object."""
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
    """Return one stream as a JSON object."""
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


def preview_lines(run: dict[str, Any]) -> Iterator[str]:
    """Yield one run as lines for people, from its JSON object."""
    yield f"{run['file']}: {run['mechanical']}, created {run['created']}; not written"
    for name in ("protocol", "actuator"):
        if run[name]:
            yield f"  {name} {run[name]}"
    for name, value in (run["setup"] | run["parameters"]).items():
        yield f"  {name} = {value}"
    for name, stream in run["streams"].items():
        span = f"{stream['start_s']:.6g} .. {stream['stop_s']:.6g} s, every {stream['interval_s']:.4g} s"
        yield f"  stream {name}: {stream['rows']} rows, {span}{'; ' * bool(stream['aligned'])}{stream['aligned']}"
        for channel in stream["channels"]:
            numbers = "no number" if channel["low"] is None else f"{channel['low']:.6g} .. {channel['high']:.6g}"
            missing_text = f", {channel['missing']} missing" if channel["missing"] else ""
            summary = f"{numbers} {channel['units']}{missing_text}"
            yield f"    {channel['name']:<12} {channel['role']:<6} {channel['quantity']:<26} {summary}"
    yield f"  {len(run['steps'])} steps"
    for step in run["steps"]:
        parameters = ", ".join(
            f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in step["parameters"].items()
        )
        yield f"    {step['name']:<12} {step['start_s']:.6g} .. {step['stop_s']:.6g} s  {parameters}".rstrip()
