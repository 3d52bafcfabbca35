"""A demonstration in words: what was planted beside what was named, for the terminal, for programs and for the page."""

from pathlib import Path
from typing import Any, NamedTuple

from leactl.gap.blind.demonstration import Demonstration
from leactl.report.gap_words import (
    bare_units,
    listed,
    meaning,
    parameter_text,
    picture_words,
    probability,
    variable_words,
)
from leactl.report.html import Html, joined, table, tag
from leactl.report.terminal import aligned, list_line
from leactl.vocabulary.effect import effect_definition

FORMAT, VERSION = "leactl-gap-demo", 1
HEADINGS = ["parameter", "planted", "fitted ± std"]


class Files(NamedTuple):
    """What a demonstration writes; the key lies apart from the bench's runs."""

    bench: Path
    key: Path
    answer: Path
    page: Path


def files_of(folder: Path) -> Files:
    """The files of a demonstration in a folder."""
    return Files(folder / "bench", folder / "key", folder / "answer.json", folder / "gap.html")


def as_json(shown: Demonstration, seed: int, files: Files) -> dict[str, Any]:
    """The document for other programs."""
    return {
        "format": FORMAT,
        "format_version": VERSION,
        "seed": seed,
        "planted": {"effect": shown.planted, "strength": shown.strength, "parameters": dict(shown.parameters)},
        "outcome": shown.outcome,
        "answer": shown.answer.as_json(),
        "files": {name: str(path) for name, path in files._asdict().items()},
    }


def verdict(shown: Demonstration) -> str:
    """Planted and named in one sentence."""
    planted = f"Planted, at {shown.strength} strength: {shown.planted}"
    if shown.cause is None:
        others = listed([cause.effect for cause in shown.others])
        return f"{planted}. Missed: {f'named was {others}' if others else 'nothing was named'}."
    chance = probability(shown.cause.probability)
    if not shown.others:
        return f"{planted}. Named: {shown.planted}, with a probability {_of(chance)}, and nothing else."
    alike = [c.effect for c in shown.others if c.effect in shown.cause.indistinguishable_from]
    further = [c.effect for c in shown.others if c.effect not in shown.cause.indistinguishable_from]
    told = f", which these runs cannot tell from {listed(alike)}" if alike else ""
    beside = f"; named beside it, though not planted: {listed(further)}" if further else ""
    return f"{planted}. Named: {shown.planted}{told}, with a probability {_of(chance)}{beside}."


def _of(chance: str) -> str:
    return f"of {chance}" if chance[0].isdigit() else chance


def rows(shown: Demonstration) -> list[list[str]]:
    """Each parameter as planted and as fitted."""
    fitted = {} if shown.cause is None else {item.name: parameter_text(item) for item in shown.cause.parameters}
    units = effect_definition(shown.planted).parameters
    return [
        [name, f"{value:.5g} {bare_units(units[name].units)}".rstrip(), fitted.get(name, "")]
        for name, value in shown.parameters.items()
    ]


def lines(shown: Demonstration, seed: int, files: Files) -> list[str]:
    """For the terminal."""
    seen = shown.cause.picture if shown.cause is not None else None
    picture = [f"over {variable_words(seen)}, held-out runs: {picture_words(seen)}"] if seen is not None else []
    said = [verdict(shown), meaning(shown.planted), *picture]
    written = [f"wrote {files.page}", f"the same again: leactl gap demo --seed {seed}"]
    return [*(list_line("", text) for text in said), "", aligned(HEADINGS, rows(shown)), "", *written]


def preface(shown: Demonstration, seed: int) -> Html:
    """For the page: what the diagnosis was up against."""
    about = (
        "An effect, its size and the bench's parameters were drawn, ten runs were made on an emulated bench whose plant"
        " shares no equation with the diagnosis, and the key was opened after the answer was written."
        f" The same again: leactl gap demo --seed {seed}"
    )
    parts = [tag("p", tag("strong", verdict(shown))), tag("p", meaning(shown.planted))]
    return tag(
        "section",
        tag("h2", "Planted and named"),
        joined([*parts, table(HEADINGS, rows(shown), "figures"), tag("p", about, class_="about")]),
    )
