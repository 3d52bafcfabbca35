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


def demonstration_json(demonstration: Demonstration, seed: int, files: Files) -> dict[str, Any]:
    """The document for other programs."""
    return {
        "format": FORMAT,
        "format_version": VERSION,
        "seed": seed,
        "planted": {
            "effect": demonstration.planted,
            "strength": demonstration.strength,
            "parameters": dict(demonstration.parameters),
        },
        "outcome": demonstration.outcome,
        "answer": demonstration.answer.as_json(),
        "files": {name: str(path) for name, path in files._asdict().items()},
    }


def verdict(demonstration: Demonstration) -> str:
    """Planted and named in one sentence."""
    planted = f"Planted, at {demonstration.strength} strength: {demonstration.planted}"
    if demonstration.cause is None:
        others = listed([cause.effect for cause in demonstration.others])
        return f"{planted}. Missed: {f'named was {others}' if others else 'nothing was named'}."
    chance = probability(demonstration.cause.probability)
    if not demonstration.others:
        return f"{planted}. Named: {demonstration.planted}, with a probability {_of(chance)}, and nothing else."
    indistinguishable = [
        c.effect for c in demonstration.others if c.effect in demonstration.cause.indistinguishable_from
    ]
    further = [c.effect for c in demonstration.others if c.effect not in demonstration.cause.indistinguishable_from]
    confused = f", which these runs cannot tell from {listed(indistinguishable)}" if indistinguishable else ""
    beside = f"; named beside it, though not planted: {listed(further)}" if further else ""
    return f"{planted}. Named: {demonstration.planted}{confused}, with a probability {_of(chance)}{beside}."


def _of(chance: str) -> str:
    return f"of {chance}" if chance[0].isdigit() else chance


def parameter_rows(demonstration: Demonstration) -> list[list[str]]:
    """Each parameter as planted and as fitted."""
    fitted = (
        {}
        if demonstration.cause is None
        else {parameter.name: parameter_text(parameter) for parameter in demonstration.cause.parameters}
    )
    units = effect_definition(demonstration.planted).parameters
    return [
        [name, f"{value:.5g} {bare_units(units[name].units)}".rstrip(), fitted.get(name, "")]
        for name, value in demonstration.parameters.items()
    ]


def demonstration_lines(demonstration: Demonstration, seed: int, files: Files) -> list[str]:
    """For the terminal."""
    shape = demonstration.cause.picture if demonstration.cause is not None else None
    picture = [f"over {variable_words(shape)}, held-out runs: {picture_words(shape)}"] if shape is not None else []
    sentences = [verdict(demonstration), meaning(demonstration.planted), *picture]
    written = [f"wrote {files.page}", f"the same again: leactl gap demo --seed {seed}"]
    return [
        *(list_line("", text) for text in sentences),
        "",
        aligned(HEADINGS, parameter_rows(demonstration)),
        "",
        *written,
    ]


def demonstration_section(demonstration: Demonstration, seed: int) -> Html:
    """For the page: what the diagnosis was up against."""
    about = (
        "An effect, its size and the bench's parameters were drawn, ten runs were made on an emulated bench whose plant"
        " shares no equation with the diagnosis, and the key was opened after the answer was written."
        f" The same again: leactl gap demo --seed {seed}"
    )
    parts = [tag("p", tag("strong", verdict(demonstration))), tag("p", meaning(demonstration.planted))]
    return tag(
        "section",
        tag("h2", "Planted and named"),
        joined([*parts, table(HEADINGS, parameter_rows(demonstration), "figures"), tag("p", about, class_="about")]),
    )
