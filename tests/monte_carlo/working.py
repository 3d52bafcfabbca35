"""What a process of the Monte Carlo does; apart from the command, so that a fresh interpreter finds it by name."""

import os
from pathlib import Path
from typing import Any

from tests.monte_carlo.trial import Campaign, tried


def own_state(place: str) -> None:
    """Keep latches and thermal states apart from every other process's."""
    os.environ["LEACTL_STATE"] = str(Path(place) / str(os.getpid()))


def one_batch(work: tuple[Campaign, list[int]]) -> list[dict[str, Any]]:
    """Results of some trials."""
    return tried(*work)
