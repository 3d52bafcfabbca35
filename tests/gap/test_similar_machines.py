"""Drawn machines at another size and at a lower rate get the same answer, read from their files anew."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leactl.gap.diagnose import Case, diagnose, hold_out_runs
from leactl.gap.signals.record import build_record
from leactl.joints.make import make
from leactl.model.nominal import Model, as_mapping, read_model
from leactl.runfile.read.reader import Run

CASES = int(os.environ.get("SIMILAR", "60"))
MACHINES = 10
SAME = 0.99  # of the answers
SIZES = {"torque x 20, current x 2, time x 1.6": (20.0, 2.0, 1.6), "x 0.02, 0.4, 0.5": (0.02, 0.4, 0.5)} | {
    "time x 4": (1.0, 1.0, 4.0)
}
# of a sample or less, or many times a turn: a lower rate cannot show them
BEYOND_HALF_THE_RATE = {
    "transport_delay",
    "velocity_filter_lag",
    "command_slew_limit",
    "cogging",
    "torque_ripple",
    "joint_elasticity",
}


def factors(torque, current, time):
    """Of every unit that a joint's log has."""
    return {"A": current, "rad": 1.0, "rad/s": 1.0 / time, "s": time}


def model_of_size(model, torque, current, time):
    """The model of a machine that is similar in the sense of dimensional analysis."""
    document = as_mapping(model)
    by = {
        "torque_constant": torque / current,
        "back_emf_constant": torque / current,
        "rotor_inertia": torque * time**2,
        "viscous_damping": torque * time,
        "coulomb_friction": torque,
    }
    scaled = {name: document[name] * factor for name, factor in by.items()}
    bench = {name: value / time for name, value in document["bench"].items()}
    return Model.model_validate(document | scaled | {"bench": bench})


def thinned(channel, divide):
    """Every so many samples one; means over them for means, as `sampling` says or as every drive has its current."""
    rows = len(channel.time) // divide * divide
    values = channel.values[divide - 1 : rows : divide]
    if channel.sampling == "mean" or channel.quantity == "q_axis_current":
        values = channel.values[:rows].reshape(-1, divide).mean(axis=1)
    return replace(channel, time=channel.time[divide - 1 : rows : divide], values=values)


def case_of(folder: Path, size=(1.0, 1.0, 1.0), divide=1):
    by, records = factors(*size), []
    for path in sorted(folder.glob("*.h5")):
        with Run.open(path) as run:
            results = [channel for spec in run.streams["loop"] for channel in run.channels(spec.quantity, spec.role)]
            scaled = [
                replace(result, time=result.time * by["s"], values=np.asarray(result.values, float) * by[result.units])
                for result in results
            ]
            channels = [thinned(item, divide) for item in scaled]
            records.append(build_record(path, str(run.attributes["protocol"]), run.mechanical, channels, {}))
    model, _ = read_model(folder / "nominal.yaml")
    return Case(model_of_size(model, *size), *hold_out_runs(records))


def named(case):
    diagnosis = diagnose(case)
    return diagnosis.verdict, {cause.effect for cause in diagnosis.causes if cause.probability >= 0.5}


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    """Folders of drawn cases with what the key says of each."""
    folder = tmp_path_factory.mktemp("similar")
    make(CASES, folder / "cases", folder / "key", MACHINES, "stepped", seed=77)
    key = json.loads((folder / "key" / "key.json").read_text())["cases"]
    return [(folder / "cases" / name, told) for name, told in key.items()]


@pytest.fixture(scope="module")
def before(cases):
    """The answers to the cases as they are."""
    return [named(case_of(folder)) for folder, _ in cases]


def compared(cases, before, change, **kwargs):
    """Share of the cases whose answer stays; every other is printed."""
    same = 0
    for (folder, told), answer in zip(cases, before, strict=True):
        after = named(case_of(folder, **kwargs))
        same += after == answer
        if after != answer:
            acts = " + ".join(told["unlisted"] or told["effects"]) or "nothing"
            print(f"{folder.name} {told['machine']}, {acts}: {change}: {answer} -> {after}")
    print(f"{change}: {same} of {len(cases)} the same")
    return same / len(cases)


@pytest.mark.long
@pytest.mark.parametrize("change", SIZES)
def test_a_drawn_machine_of_another_size_gets_the_same_answer(cases, before, change):
    assert compared(cases, before, change, size=SIZES[change]) >= SAME


@pytest.mark.long
@pytest.mark.parametrize("divide", [2, 4])
def test_a_drawn_machine_at_a_lower_rate_gets_the_same_answer(cases, before, divide):
    slow = [not {*told["effects"], *told["unlisted"]} & BEYOND_HALF_THE_RATE for _, told in cases]
    kept, answers = ([one for one, keep in zip(row, slow, strict=True) if keep] for row in (cases, before))
    assert compared(kept, answers, f"every {divide} samples", divide=divide) >= SAME
