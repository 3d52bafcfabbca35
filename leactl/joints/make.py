"""Make cases of drawn machines: each is a specimen of a machine, its runs simulated by one of two simulators."""

import secrets
import time
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from leactl.emulation.blind.case_counts import KINDS, counts, faults_of, in_turn
from leactl.emulation.blind.key import write_key
from leactl.errors import InputError
from leactl.joints import by_mujoco, stepped
from leactl.joints.effects import (
    STRENGTHS,
    DrawnEffect,
    draw_effect,
    excluded_effects,
    listed_rules,
    showable_effects,
    unlisted_rules,
)
from leactl.joints.files import key_entry, write_run
from leactl.joints.machine import Generator, JointMachine, draw_machine, draw_specimen, kinds, nominal_text
from leactl.joints.programs import draw_program
from leactl.joints.run import JointRun, JointSignals, draw_log

SIMULATORS: dict[str, Callable[[Sequence[JointRun]], list[JointSignals]]] = {
    "stepped": stepped.simulate,
    "mujoco": by_mujoco.simulate,
}
CASES_PER_BATCH = 20  # cases that are simulated at once; their signals take about 100 MB
REPEAT_LABELS = ("a", "b")  # each protocol runs twice, so that one run can be held out


def make(
    count: int,
    out: Path,
    key_dir: Path,
    machines: int,
    simulator: str,
    seed: int | None = None,
    wanted: Sequence[str] = KINDS,
    progress: Callable[[str], None] = lambda _: None,
) -> str:
    """Make cases in `out`, each in its own folder, and their key in `key_dir`; return the key's hash.

    Parameters
    ----------
    machines : number of machines to draw; cases use them in turn.
    simulator : `stepped` or `mujoco`.
    seed : the same seed and arguments give the same values; without a seed, fresh entropy is used.
    wanted : kinds of cases, of `none`, `single`, `pair` and `unknown`, drawn in their usual shares.

    Raises
    ------
    InputError : an argument has an unknown value, a folder is not empty, or the simulator is not installed.
    """
    faults = faults_of(count, out, key_dir, wanted)
    faults += [f"machines: {machines} is not a number of machines; give 1 or more"] if machines < 1 else []
    if simulator not in SIMULATORS:
        faults.append(f"simulator {simulator!r} is not known; known: {', '.join(SIMULATORS)}")
    if simulator == "mujoco" and find_spec("mujoco") is None:
        faults.append(by_mujoco.MUJOCO_MISSING)
    if faults:
        raise InputError(faults)
    seed_number = secrets.randbits(128) if seed is None else seed
    draw = np.random.default_rng([seed_number, 0])
    drawn_machines = draw_machines(draw, machines)
    plans = plan(draw, count, drawn_machines, wanted)
    digit_count, entries = max(3, len(str(count))), dict[str, Any]()
    out.mkdir(parents=True, exist_ok=True)
    start_time = time.monotonic()
    for start in range(0, count, CASES_PER_BATCH):
        time_left = (
            f", about {(time.monotonic() - start_time) / start * (count - start) / 60:.1f} min left" if start else ""
        )
        progress(f"{start} of {count} cases made{time_left}")
        batch: list[tuple[str, JointRun]] = []
        for case_index in range(start, min(start + CASES_PER_BATCH, count)):
            name, machine_index, (kind, effects, strength) = (
                f"case-{case_index + 1:0{digit_count}d}",
                case_index % machines,
                plans[case_index],
            )
            runs = draw_runs(
                np.random.default_rng([seed_number, 1, case_index]), drawn_machines[machine_index], effects, strength
            )
            batch += [(name, run) for run in runs]
            machine_label = f"{drawn_machines[machine_index].kind} {machine_index + 1}"
            case_strength = strength if effects else None
            entries[name] = key_entry(runs[0].specimen, kind, runs[0].effects, case_strength, machine_label, simulator)
            (out / name).mkdir()
            (out / name / "nominal.yaml").write_text(nominal_text(drawn_machines[machine_index]), encoding="utf-8")
        for (name, run), signals in zip(batch, SIMULATORS[simulator]([run for _, run in batch]), strict=True):
            write_run(out / name, name, run, signals)
    salt = secrets.token_hex(16) if seed is None else bytes(draw.integers(0, 256, 16, np.uint8)).hex()
    return write_key(key_dir, out, entries, seed_number, salt)


def draw_machines(draw: Generator, count: int) -> list[JointMachine]:
    """Draw machines, one of each kind before any kind comes twice."""
    names = in_turn(draw, tuple(kinds()))
    return [draw_machine(draw, next(names)) for _ in range(count)]


def plan(
    draw: Generator, count: int, machines: Sequence[JointMachine], wanted: Sequence[str]
) -> list[tuple[str, tuple[str, ...], str]]:
    """Draw kind, effects and strength of each case; a machine gets only effects that its channels can show."""
    drawn_kinds = [kind for kind, number in counts(count, wanted).items() for _ in range(number)]
    listed_names, unlisted_names = in_turn(draw, tuple(listed_rules())), in_turn(draw, tuple(unlisted_rules()))
    plans: list[tuple[str, tuple[str, ...], str]] = []
    for index, kind in enumerate(draw.permutation(drawn_kinds).tolist()):
        names: tuple[str, ...] = ()
        if kind == "unknown":
            names = (next(unlisted_names),)
        elif kind in ("single", "pair"):
            names = (next_shown(listed_names, machines[index % len(machines)], ()),)
        if kind == "pair":
            names = (*names, next_shown(listed_names, machines[index % len(machines)], names))
        plans.append((str(kind), tuple(sorted(names)), str(draw.choice(STRENGTHS))))
    return plans


def next_shown(names: Iterator[str], machine: JointMachine, chosen: Sequence[str]) -> str:
    """Return the next effect that a machine can show together with those in `chosen`."""
    excluded = {*chosen, *(name for effect in chosen for name in excluded_effects(effect))}
    allowed = set(showable_effects(machine)) - excluded
    return next(name for name in names if name in allowed)


def draw_runs(draw: Generator, machine: JointMachine, effects: Sequence[str], strength: str) -> list[JointRun]:
    """Draw a specimen with its effects, and the runs made with it."""
    specimen, log = draw_specimen(draw, machine), draw_log(draw, machine.sampling)
    drawn: tuple[DrawnEffect, ...] = tuple(draw_effect(draw, machine, name, strength) for name in effects)
    return [
        JointRun(
            name=f"{protocol}-{repeat}",
            protocol=protocol,
            specimen=specimen,
            effects=drawn,
            program=draw_program(draw, machine, protocol),
            log=log,
            angle=float(draw.uniform(0.0, 2.0 * np.pi)),
            seed=int(draw.integers(0, 2**63)),
        )
        for protocol in machine.protocols
        for repeat in REPEAT_LABELS
    ]
