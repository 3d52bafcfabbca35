"""Comparison of a demonstration's planted effect with the named effects, as text, as JSON and for the page."""

from pathlib import Path
from typing import Any, NamedTuple

from leactl.gap.blind.demonstration import Demonstration
from leactl.report.gap_page import content
from leactl.report.gap_words import (
    bare_units,
    effect_meaning,
    enumerated,
    parameter_text,
    picture_text,
    probability_text,
    variable_text,
)
from leactl.report.html import render
from leactl.report.terminal import aligned, list_line
from leactl.vocabulary.effect import effect_definition

FORMAT, VERSION = "leactl-gap-demo", 1
HEADINGS = ["parameter", "planted", "fitted ± std"]


class Files(NamedTuple):
    """The files of a demonstration; the key is in a folder apart from that of the runs."""

    bench: Path
    key: Path
    answer: Path
    page: Path


def files_of(folder: Path) -> Files:
    """Return the paths of a demonstration's files in a folder."""
    return Files(folder / "bench", folder / "key", folder / "answer.json", folder / "gap.html")


def demonstration_json(demonstration: Demonstration, seed: int, files: Files) -> dict[str, Any]:
    """Return the demonstration as a JSON document."""
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
    """Return one sentence that says what was planted and what was named."""
    planted_text = f"Planted, at {demonstration.strength} strength: {demonstration.planted}"
    if demonstration.cause is None:
        named_effects = enumerated([cause.effect for cause in demonstration.others])
        return f"{planted_text}. Missed: {f'named was {named_effects}' if named_effects else 'nothing was named'}."
    chance = probability_text(demonstration.cause.probability)
    if not demonstration.others:
        return (
            f"{planted_text}. Named: {demonstration.planted}, with a probability {_phrase(chance)}, and nothing else."
        )
    similar_effects = demonstration.cause.indistinguishable_from
    indistinguishable = [cause.effect for cause in demonstration.others if cause.effect in similar_effects]
    other_effects = [cause.effect for cause in demonstration.others if cause.effect not in similar_effects]
    confusion = f", which these runs cannot tell from {enumerated(indistinguishable)}" if indistinguishable else ""
    addition = f"; named beside it, though not planted: {enumerated(other_effects)}" if other_effects else ""
    return f"{planted_text}. Named: {demonstration.planted}{confusion}, with a probability {_phrase(chance)}{addition}."


def _phrase(probability: str) -> str:
    """Return `of 0.93`, or a bound such as `> 0.99` without a preposition."""
    return f"of {probability}" if probability[0].isdigit() else probability


def parameter_rows(demonstration: Demonstration) -> list[list[str]]:
    """Return a row for each parameter: its name, its planted value and its fitted value."""
    fitted_texts = (
        {}
        if demonstration.cause is None
        else {parameter.name: parameter_text(parameter) for parameter in demonstration.cause.parameters}
    )
    definitions = effect_definition(demonstration.planted).parameters
    return [
        [name, f"{value:.5g} {bare_units(definitions[name].units)}".rstrip(), fitted_texts.get(name, "")]
        for name, value in demonstration.parameters.items()
    ]


def demonstration_lines(demonstration: Demonstration, seed: int, files: Files) -> list[str]:
    """Return the lines that the terminal shows."""
    picture = demonstration.cause.picture if demonstration.cause is not None else None
    picture_lines = (
        [f"over {variable_text(picture)}, held-out runs: {picture_text(picture)}"] if picture is not None else []
    )
    sentences = [verdict(demonstration), effect_meaning(demonstration.planted), *picture_lines]
    file_lines = [f"wrote {files.page}", f"the same again: leactl gap demo --seed {seed}"]
    return [
        *(list_line("", text) for text in sentences),
        "",
        aligned(HEADINGS, parameter_rows(demonstration)),
        "",
        *file_lines,
    ]


def page(demonstration: Demonstration, seed: int) -> str:
    """Return the page of the diagnosis with a section that says what was planted and what was named."""
    return render(
        "gap_demo.html",
        outcome=verdict(demonstration),
        meaning=effect_meaning(demonstration.planted),
        headings=HEADINGS,
        planted=parameter_rows(demonstration),
        seed=seed,
        **content(demonstration.answer),
    )
