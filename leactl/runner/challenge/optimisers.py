"""Optimisers of a challenge: random changes of the genes that came nearest to a bound, or CMA-ES."""

from collections.abc import Callable, Generator
from typing import Protocol

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError

Array = npt.NDArray[np.float64]
FIRST_DRAWS, KEPT_PER_KIND = 6, 4  # draws at first, and best courses of each kind whose genes are kept
DRAWN_SHARE = 0.3  # of later proposals, which are drawn anew
CHANGED_SHARE, CHANGE_STD = 0.35, 0.15  # share of genes that a change affects, and standard deviation of the change
COLD_K = -1e3  # excess over the bound that counts for a course that has warmed nothing
MISSING_PACKAGE = "optimiser 'cma' needs the package cma: pip install 'leactl[cma]'"


class TriedGenes(Protocol):
    """Genes of a course that was tried, and their result."""

    @property
    def kind(self) -> str: ...  # noqa: D102 (of a course)
    @property
    def genes(self) -> Array: ...  # noqa: D102 (each from 0 to 1)
    @property
    def over_k(self) -> float: ...  # noqa: D102 (K over the bound)


Proposals = Generator[Array, TriedGenes, None]


def by_changes(count: int, random: np.random.Generator) -> Proposals:
    """Propose `count` genes: at first drawn genes, later also changed genes of the courses nearest to their bounds."""
    by_kind: dict[str, list[TriedGenes]] = {}
    attempts = 0
    while True:
        genes = random.random(count)
        if attempts >= FIRST_DRAWS and random.random() > DRAWN_SHARE:
            best_of_kind = by_kind[str(random.choice(sorted(by_kind)))]
            genes = _changed(best_of_kind[int(random.integers(len(best_of_kind)))].genes, random)
        attempt = yield genes
        attempts += 1
        nearest_first = sorted([*by_kind.get(attempt.kind, []), attempt], key=lambda tried: -tried.over_k)
        by_kind[attempt.kind] = nearest_first[:KEPT_PER_KIND]


def _changed(genes: Array, random: np.random.Generator) -> Array:
    """Return the genes with random changes of a share `CHANGED_SHARE` of them."""
    changes = CHANGE_STD * random.standard_normal(len(genes)) * (random.random(len(genes)) < CHANGED_SHARE)
    return _clipped(genes + changes)


def _clipped(genes: Array) -> Array:
    """Return the genes limited to the range from 0 to just below 1."""
    return np.asarray(np.clip(genes, 0.0, np.nextafter(1.0, 0.0)), np.float64)


def by_cma(count: int, random: np.random.Generator) -> Proposals:
    """Propose by CMA-ES (Hansen, 2016) from the nearest of a few draws until it stops, then again from new draws.

    Raises
    ------
    InputError : the package is not installed.
    """
    try:
        import cma
    except ImportError:
        raise InputError(MISSING_PACKAGE) from None
    while True:
        drawn: list[TriedGenes] = []
        for _ in range(FIRST_DRAWS):
            drawn.append((yield random.random(count)))  # noqa: PERF401 (a comprehension cannot yield)
        start = max(drawn, key=lambda attempt: attempt.over_k).genes
        options = {"bounds": [0.0, 1.0], "verbose": -9, "seed": int(random.integers(1, 2**31)), "tolfun": 1e-2}
        strategy = cma.CMAEvolutionStrategy(start, CHANGE_STD, options)
        while not strategy.stop():
            population, distances = strategy.ask(), []
            for genes in population:
                attempt = yield _clipped(np.asarray(genes))
                distances.append(-max(attempt.over_k, COLD_K))
            strategy.tell(population, distances)


OPTIMISERS: dict[str, Callable[[int, np.random.Generator], Proposals]] = {"changes": by_changes, "cma": by_cma}
