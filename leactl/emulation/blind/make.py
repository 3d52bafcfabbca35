"""Make cases: draw them, simulate all their benches together, write runs and key."""

import secrets
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from leactl.emulation.blind.case_counts import KINDS, counts, faults_of, in_turn
from leactl.emulation.blind.draws import STRENGTHS, BlindCase, draw_case, usual_effects
from leactl.emulation.blind.files import entry, write_heated, write_model, write_moving
from leactl.emulation.blind.key import write_key
from leactl.emulation.plant.effects_outside_library import unlisted_effects
from leactl.emulation.plant.stepped.heating import heat
from leactl.emulation.plant.stepped.simulation import DriveReferences, simulate
from leactl.errors import InputError
from leactl.vocabulary.effect import effects_on

CASES_AT_ONCE = 40  # simulated together; their 320 lanes take about 1 GB


def make(
    count: int,
    out: Path,
    key_dir: Path,
    seed: int | None = None,
    kinds: Sequence[str] = KINDS,
    effects: Sequence[str] | None = None,
    strengths: Sequence[str] = tuple(STRENGTHS),
    prefix: str = "case",
    progress: Callable[[str], None] = lambda _: None,
) -> str:
    """Make cases in `out`, each in its own folder, and their key in `key_dir`; return the key's hash.

    Parameters
    ----------
    seed : the same seed and arguments give the same cases; None draws a seed from the system's entropy.
    kinds : some of `none`, `single`, `pair` and `unknown`, drawn in their usual shares.
    effects : identifiers that may be drawn; by default all that this bench may have. Single effects are drawn in turn,
        each before any comes twice.
    strengths : some of `faint`, `plain` and `strong`.

    Raises
    ------
    InputError : an argument names an unknown kind, effect or strength, or a folder is not empty.
    """
    chosen_effects = tuple(effects) if effects else usual_effects()
    _check(count, out, key_dir, kinds, chosen_effects, strengths)
    seed_number = secrets.randbits(128) if seed is None else seed
    plan_generator = np.random.default_rng([seed_number, 0])
    plans = _plans(plan_generator, count, kinds, chosen_effects, strengths)
    digits = max(3, len(str(count)))
    entries: dict[str, Any] = {}
    out.mkdir(parents=True, exist_ok=True)
    start_time = time.monotonic()
    for first_case in range(0, count, CASES_AT_ONCE):
        time_left = (
            f", about {(time.monotonic() - start_time) / first_case * (count - first_case) / 60:.1f} min left"
            if first_case
            else ""
        )
        progress(f"{first_case} of {count} cases made{time_left}")
        batch = [
            draw_case(np.random.default_rng([seed_number, 1, k]), f"{prefix}-{k + 1:0{digits}d}", *plans[k])
            for k in range(first_case, min(first_case + CASES_AT_ONCE, count))
        ]
        write([out / case.name for case in batch], batch)
        entries |= {case.name: entry(case) for case in batch}
    salt = secrets.token_hex(16) if seed is None else bytes(plan_generator.integers(0, 256, 16, np.uint8)).hex()
    return write_key(key_dir, out, entries, seed_number, salt)


def _check(
    count: int, out: Path, key_dir: Path, kinds: Sequence[str], effects: Sequence[str], strengths: Sequence[str]
) -> None:
    """Raise InputError with a line for each argument from which cases cannot be made."""
    faults = faults_of(count, out, key_dir, kinds)
    for argument, given_names, known_names in (
        ("effect", effects, effects_on("bench")),
        ("strength", strengths, tuple(STRENGTHS)),
    ):
        faults += [
            f"{argument} {name!r} is not known; known: {', '.join(known_names)}"
            for name in given_names
            if name not in known_names
        ]
        faults += [] if given_names else [f"no {argument} given; known: {', '.join(known_names)}"]
    if "pair" in kinds and len(set(effects)) < 2:
        faults.append("a pair needs two effects to be drawn from; give more, or leave out the kind pair")
    if faults:
        raise InputError(faults)


def _plans(
    draw: np.random.Generator, count: int, kinds: Sequence[str], effects: Sequence[str], strengths: Sequence[str]
) -> list[tuple[str, tuple[str, ...], str]]:
    """Draw kind, names of effects and strength of each case; the cases are in random order."""
    singles, unknowns = in_turn(draw, effects), in_turn(draw, tuple(unlisted_effects()))
    plans: list[tuple[str, tuple[str, ...], str]] = []
    for kind, kind_count in counts(count, kinds).items():
        for _ in range(kind_count):
            names: tuple[str, ...] = ()
            if kind == "single":
                names = (next(singles),)
            elif kind == "pair":
                names = tuple(str(name) for name in draw.choice(sorted(set(effects)), 2, replace=False))
            elif kind == "unknown":
                names = (next(unknowns),)
            plans.append((kind, names, str(draw.choice(list(strengths)))))
    return [plans[k] for k in draw.permutation(count)]


def write(folders: Sequence[Path], batch: Sequence[BlindCase]) -> None:
    """Simulate the benches of some cases together, and write each case into its folder."""
    cases = list(zip(folders, batch, strict=True))
    for folder, case in cases:
        write_model(folder, case)
    runs = [(folder, case, run) for folder, case in cases for run in case.runs]
    moving_runs = [
        (folder, case, run, run.program) for folder, case, run in runs if isinstance(run.program, DriveReferences)
    ]
    heated_runs = [
        (folder, case, run, run.program) for folder, case, run in runs if not isinstance(run.program, DriveReferences)
    ]
    moving_signals = simulate([run.lane for _, _, run, _ in moving_runs], [program for *_, program in moving_runs])
    for (folder, case, run, _), moving_signal in zip(moving_runs, moving_signals, strict=True):
        write_moving(folder, case, run, moving_signal)
    heated_signals = heat([run.lane for _, _, run, _ in heated_runs], [current for *_, current in heated_runs])
    for (folder, case, run, _), heated_signal in zip(heated_runs, heated_signals, strict=True):
        write_heated(folder, case, run, heated_signal)
