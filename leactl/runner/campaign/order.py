"""In which order the runs of a campaign are made: one level inside the other, shuffled where statistics want it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Literal

Level = Literal["actuators", "conditions", "steps", "repeats"]
USUAL: tuple[Level, ...] = ("actuators", "conditions", "steps", "repeats")  # the dearest change outermost


@dataclass(frozen=True)
class Cell:
    """One run of a campaign, by what sets it apart from the others."""

    step: str
    actuator: str
    condition: str
    repeat: int  # from 1

    @property
    def key(self) -> str:
        """Its name in journal and run file."""
        return f"{self.step}/{self.actuator}/{self.condition}/{self.repeat}"

    def at(self, level: Level) -> str | int:
        """What it is at one level."""
        values: dict[Level, str | int] = {
            "actuators": self.actuator,
            "conditions": self.condition,
            "steps": self.step,
            "repeats": self.repeat,
        }
        return values[level]

    def __str__(self) -> str:
        return ", ".join(filter(None, (self.step, self.actuator, self.condition, f"repeat {self.repeat}")))


def arranged(
    cells: Sequence[Cell],
    order: Sequence[Level],
    written: Mapping[Level, Sequence[str | int]],
    shuffled: Collection[Level],
    seed: int,
) -> list[Cell]:
    """The cells level by level, outermost first.

    Parameters
    ----------
    written : what there is at each level, in the order of the file.
    shuffled : levels whose order is drawn anew within each block of the levels outside it. It is drawn by SHA-256 of
        seed and place, so that it is the same on every machine and adding a run leaves the others as they were.
    """
    return _arranged(cells, tuple(order), written, shuffled, str(seed))


def _arranged(
    cells: Sequence[Cell],
    order: tuple[Level, ...],
    written: Mapping[Level, Sequence[str | int]],
    shuffled: Collection[Level],
    place: str,
) -> list[Cell]:
    if not order:
        return list(cells)
    level, *inner = order
    blocks: dict[str | int, list[Cell]] = {}
    for cell in cells:
        blocks.setdefault(cell.at(level), []).append(cell)
    names = [name for name in written[level] if name in blocks]
    if level in shuffled:
        names.sort(key=lambda name: drawn(f"{place}/{name}"))
    return [
        cell for name in names for cell in _arranged(blocks[name], tuple(inner), written, shuffled, f"{place}/{name}")
    ]


def drawn(text: str) -> int:
    """A number of 63 bits that only the text determines."""
    return int.from_bytes(sha256(text.encode()).digest()[:8], "big") >> 1
