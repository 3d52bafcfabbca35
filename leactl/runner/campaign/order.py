"""Sort the runs of a campaign by nested loops over its levels, each in the order of the file or shuffled."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Literal

Level = Literal["actuators", "conditions", "steps", "repeats"]
# outermost first: the level that takes a person longest to change is changed least often
DEFAULT_ORDER: tuple[Level, ...] = ("actuators", "conditions", "steps", "repeats")


@dataclass(frozen=True)
class Cell:
    """One run of a campaign, identified by its step, actuator, condition and repeat."""

    step: str
    actuator: str
    condition: str
    repeat: int  # from 1

    @property
    def key(self) -> str:
        """Name of the run in the journal and in its run file."""
        return f"{self.step}/{self.actuator}/{self.condition}/{self.repeat}"

    def at(self, level: Level) -> str | int:
        """Return the cell's name at one level, or its number for repeats."""
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
    level_values: Mapping[Level, Sequence[str | int]],
    shuffled: Collection[Level],
    seed: int,
) -> list[Cell]:
    """Return the cells sorted level by level.

    Parameters
    ----------
    order : the levels, outermost first.
    level_values : all names or numbers of each level, in the order of the file.
    shuffled : levels whose order is drawn anew within each block of the levels outside it. It is drawn by SHA-256 of
        the seed and the names of these levels, so that it is the same on every machine, and an added run does not
        change the order of the others.
    """
    return _arranged(cells, tuple(order), level_values, shuffled, str(seed))


def _arranged(
    cells: Sequence[Cell],
    order: tuple[Level, ...],
    level_values: Mapping[Level, Sequence[str | int]],
    shuffled: Collection[Level],
    block_path: str,  # the seed, then the names of the outer levels
) -> list[Cell]:
    """Return the cells of one block of the outer levels, sorted by the remaining levels."""
    if not order:
        return list(cells)
    level, *inner = order
    blocks: dict[str | int, list[Cell]] = {}
    for cell in cells:
        blocks.setdefault(cell.at(level), []).append(cell)
    names = [name for name in level_values[level] if name in blocks]
    if level in shuffled:
        names.sort(key=lambda name: hashed_number(f"{block_path}/{name}"))
    return [
        cell
        for name in names
        for cell in _arranged(blocks[name], tuple(inner), level_values, shuffled, f"{block_path}/{name}")
    ]


def hashed_number(text: str) -> int:
    """Return a number of 63 bits from the SHA-256 of a text."""
    return int.from_bytes(sha256(text.encode()).digest()[:8], "big") >> 1
