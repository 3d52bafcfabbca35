"""Run files written again with one channel spoiled, as a dead, hanging, turned or misread sensor would leave it."""

import numpy as np

from leactl.runfile.read.reader import Run
from leactl.runfile.write.writer import RunInfo, RunWriter


def zero(values):
    values[:] = 0.0


def constant(values):
    values[:] = values[np.isfinite(values)][len(values) // 3 if np.isfinite(values).all() else 0]


def frozen(values):
    half = len(values) // 2
    seen = values[:half][np.isfinite(values[:half])]
    values[half:] = seen[-1] if len(seen) else np.nan


def turned(values):
    values *= -1.0


def thousandfold(values):
    values *= 1000.0


def gappy(values):
    values[::10] = np.nan


CORRUPTIONS = (zero, constant, frozen, turned, thousandfold, gappy)


def rewritten(path, directory, spoiled="", corruption=None, thinned=1):
    """Write the run at `path` into a directory, the channel at `spoiled` (stream/name) corrupted; return its path."""
    directory.mkdir(parents=True, exist_ok=True)
    with Run.open(path) as run:
        known = run.attributes
        names = ("run_id", "protocol", "bench", "actuator", "condition", "operator", "software", "created")
        sources = {name: run.source(name) for name in ("protocol", "bench", "model")}
        info = RunInfo(
            **{name: str(known.get(name, "")) for name in names},
            simulated=bool(known.get("simulated", True)),
            mechanical=run.mechanical,
            sources={name: text for name, text in sources.items() if text is not None},
            setup={name: value for name, value in run.setup.items() if name != "mechanical"},
        )
        writer = RunWriter(directory, info, {stream: list(specs) for stream, specs in run.streams.items()})
        for stream, specs in run.streams.items():
            columns = [run.channel_at(f"{stream}/{spec.name}").values for spec in specs]
            for spec, values in zip(specs, columns, strict=True):
                if f"{stream}/{spec.name}" == spoiled:
                    corruption(values)
            writer.append(stream, run.time(stream)[::thinned], np.column_stack(columns)[::thinned])
        for step in run.steps:
            writer.step(step.name, step.start, step.stop, step.settle, step.parameters)
        writer.close("complete")
        return writer.path
