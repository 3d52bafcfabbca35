"""Number of cases of each kind, names drawn in turn, and a check of the arguments that they are made with."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

KINDS = ("none", "single", "pair", "unknown")
SHARES = {"none": 0.2, "single": 0.5, "pair": 0.15, "unknown": 0.15}  # of the cases


def faults_of(count: int, out: Path, key_dir: Path, kinds: Sequence[str]) -> list[str]:
    """Return a line for each reason why the cases cannot be made with these arguments; empty if they can."""
    faults = [f"cases: {count} is not a number of cases; give 1 or more"] if count < 1 else []
    faults += [f"kind {name!r} is not known; known: {', '.join(KINDS)}" for name in kinds if name not in KINDS]
    faults += [] if kinds else [f"no kind given; known: {', '.join(KINDS)}"]
    if out.resolve() == key_dir.resolve() or out.resolve() in key_dir.resolve().parents:
        faults.append(f"{key_dir}: the key belongs apart from the runs; choose a folder outside {out}")
    for folder in {out, key_dir}:
        if folder.exists() and any(folder.iterdir()):
            faults.append(f"{folder}: is not empty; choose a new folder")
    return faults


def counts(count: int, kinds: Sequence[str]) -> dict[str, int]:
    """Return the number of cases of each kind, in their usual shares; the numbers add up to `count`."""
    shares = np.array([SHARES[kind] for kind in kinds])
    exact_numbers = count * shares / shares.sum()
    numbers = np.floor(exact_numbers).astype(int)
    for k in np.argsort(numbers - exact_numbers)[: count - int(numbers.sum())]:
        numbers[k] += 1
    return dict(zip(kinds, numbers.tolist(), strict=True))


def in_turn(draw: np.random.Generator, names: Sequence[str]) -> Iterator[str]:
    """Yield the names in endless rounds; each round has every name once, in an order that is drawn anew."""
    while True:
        yield from (str(name) for name in draw.permutation(list(names)))
