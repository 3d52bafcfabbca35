"""A diagnosis as one HTML file: verdict, causes, how far the gap shrinks, where it sits, calibration, notes.

Nothing is loaded from anywhere and nothing moves: it can be mailed, printed and read again in ten years.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from leactl.gap.diagnosis import Cause, Diagnosis, Shrinkage
from leactl.report.gap_figures import figures, pictures, shapes_of
from leactl.report.gap_simulator import (
    EFFECTS,
    FLOORS,
    PARAMETERS,
    effect_rows,
    floor_rows,
    parameter_rows,
    summary,
)
from leactl.report.gap_words import (
    CLOSES_NOTHING,
    PRESENT,
    bare_units,
    change,
    claims,
    closed_by_calibration,
    closed_text,
    closes_nothing,
    counted,
    figure,
    floors,
    label,
    largest_first,
    listed,
    meaning,
    open_gap,
    parameter_text,
    percent,
    probability,
    region_text,
    rest_channel,
    rest_words,
    sentence,
    with_std,
)
from leactl.report.html import Html, document, joined, table, tag
from leactl.report.page_style import PAGE

NOTHING = Html("")
MODELS = ("nominal", "calibrated", "augmented", "floor")
CARDS = 12  # channels with bars, where no effect is added
LEAST = 0.5  # of the smallest number, where the bars begin: on a log scale there is no zero
# colours that differ for the colour-blind too (Okabe, Ito 2008)
STYLE = (
    PAGE
    + """
:root { --nominal: #8a949e; --calibrated: #d55e00; --augmented: #0072b2; --floor: #009e73; }
@media (prefers-color-scheme: dark) { :root { --nominal: #8a949e; --calibrated: #f08a3c; --augmented: #56b4e9;
  --floor: #2fc69b; } }
.headline { border-left: 4px solid var(--augmented); padding-left: 0.75rem; }
.lead { font-size: 1.1rem; }
.verdict { border: 1px solid currentcolor; border-radius: 4px; padding: 0 0.4em; margin-right: 0.25em; }
.bar { background: var(--line); height: 0.75rem; border-radius: 2px; overflow: hidden; }
.bar i { display: block; height: 100%; background: var(--augmented); }
.bar.weak i { background: var(--nominal); }
.causes { list-style: none; margin: 0; padding: 0; display: grid; gap: 0.75rem;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 24rem), 1fr)); }
.causes li { background: var(--card); border: 1px solid var(--line); border-radius: 6px; padding: 0.75rem; }
.row { display: flex; justify-content: space-between; gap: 1rem; }
.name { font-weight: 600; }
dl { display: grid; grid-template-columns: auto 1fr; gap: 0 1rem; margin: 0.25rem 0; }
dt { color: var(--faint); }
dd { margin: 0; font-variant-numeric: tabular-nums; }
.shrinkage { display: grid; gap: 0.75rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 24rem), 1fr)); }
.shrinkage .card { margin: 0; }
.shrinkage + p { margin-top: 0.75rem; }
.bars { display: grid; grid-template-columns: auto 1fr auto; gap: 0.15rem 0.5rem; align-items: center;
  font-size: 0.875rem; font-variant-numeric: tabular-nums; }
.bars .bar { background: none; }
.bars .nominal { background: var(--nominal); }
.bars .calibrated { background: var(--calibrated); }
.bars .augmented { background: var(--augmented); }
.bars .floor { background: var(--floor); }
.pictures { display: grid; gap: 0.75rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 30rem), 1fr)); }
.pictures .card { margin: 0; }
path.zero { stroke: var(--faint); stroke-dasharray: 4 3; }
path.measured { stroke: var(--ink); }
path.nominal { stroke: var(--nominal); fill: var(--nominal); }
path.calibrated { stroke: var(--calibrated); fill: var(--calibrated); }
path.augmented { stroke: var(--augmented); fill: var(--augmented); }
path.floor { fill: var(--floor); }
path.region { fill: var(--nominal); fill-opacity: 0.2; }
.swatch.measured { background: var(--ink); }
.swatch.nominal { background: var(--nominal); }
.swatch.calibrated { background: var(--calibrated); }
.swatch.augmented { background: var(--augmented); }
.swatch.floor { background: var(--floor); opacity: 0.6; }
.swatch.region { background: var(--nominal); opacity: 0.4; }
@media print { .causes li { break-inside: avoid; } .bar, .bar i { print-color-adjust: exact; } }
"""
)


def page(answer: Diagnosis, preface: Html = NOTHING) -> str:
    """The whole answer as one self-contained page; the same answer gives the same page.

    preface : what is to stand after the verdict.
    """
    model = answer.extra.get("augmented")
    of = f": {model.name}" if model is not None else ""
    drawn = pictures(answer)
    body = tag(
        "main",
        tag("h1", f"Gap between model and bench{of}"),
        headline(answer),
        preface,
        section("The simulator", simulator(answer)),
        section("Causes", causes(answer)),
        section("What each effect explains", tag("div", *drawn, class_="pictures") if drawn else NOTHING),
        section("What is not explained", not_explained(answer)),
        section("How far the gap shrinks", shrinkage(answer)),
        section("Where the gap sits", joined([*figures(answer), where(answer)])),
        section("Calibration", calibration(answer)),
        section("Notes", tag("ul", *(tag("li", note) for note in answer.notes)) if answer.notes else NOTHING),
    )
    return document(f"Gap{of}", STYLE, body)


def section(title: str, content: Html) -> Html:
    """A part of the page; one without content is left out."""
    return tag("section", tag("h2", title), content) if content else content


def headline(answer: Diagnosis) -> Html:
    """The verdict, the chance that it misses something, and the largest gap closed."""
    facts = [f"Probability that something unexplained acts: {probability(answer.unexplained_probability)}."]
    for item in largest_first(answer.shrinkage)[:1]:
        after = f", {figure(item.augmented_rms)} with the effects" if claims(answer.causes) else ""
        closed = f"; closed {closed_text(item)}" if claims(answer.causes) else ""
        facts.append(
            f"Largest gap: {label(item, answer.shrinkage)}, {figure(item.calibrated_rms)} {bare_units(item.units)}"
            f" after calibration{after}, floor {figure(item.floor_rms)}{closed}."
        )
    facts += [f"{counted(answer.shrinkage)}."] if answer.shrinkage else []
    return tag(
        "div",
        tag("p", tag("strong", answer.verdict, class_="verdict"), " ", sentence(answer), class_="lead"),
        *(tag("p", fact) for fact in facts),
        class_="headline",
    )


def causes(answer: Diagnosis) -> Html:
    """One entry for each effect, a bar for its probability."""
    if not answer.causes:
        return NOTHING
    intro = "Each bar is the probability that the effect is present; they need not sum to 1."
    empty = closes_nothing(answer)
    parts = [tag("p", intro, class_="about")]
    parts += [tag("p", CLOSES_NOTHING)] if empty else []
    return joined([*parts, tag("ol", *(cause(item, empty) for item in answer.causes), class_="causes")])


def cause(item: Cause, closes_no_gap: bool) -> Html:
    """Name, bar (pale where effects close no gap), meaning, parameters, class and the experiment that separates it."""
    share = min(max(item.probability, 0.0), 1.0) if math.isfinite(item.probability) else 0.0
    bar = "bar weak" if closes_no_gap or share < PRESENT else "bar"
    said = [
        tag("div", tag("span", item.effect, class_="name"), tag("span", probability(item.probability)), class_="row"),
        tag(
            "div",
            tag("i", style=f"width:{100 * share:.4g}%"),
            class_=bar,
        ),
    ]
    if words := meaning(item.effect):
        said.append(tag("p", words))
    if item.parameters:
        said.append(tag("dl", *(p for q in item.parameters for p in (tag("dt", q.name), tag("dd", parameter_text(q))))))
    if item.share > 0.0 and item.family == "setup":
        said.append(tag("p", f"Mended, {percent(item.share)} of what the channel is off by is gone, on held-out runs."))
    elif item.share > 0.0:
        said.append(tag("p", f"Its share of what all causes explain: {percent(item.share)}."))
    if item.indistinguishable_from:
        said.append(tag("p", f"Cannot be told from {listed(item.indistinguishable_from)} with these runs."))
    if item.change:
        said.append(tag("p", f"To mend it: {item.change}."))
    if item.separating_experiment:
        said.append(tag("p", "To separate: ", tag("code", f"leactl run {item.separating_experiment}")))
    return tag("li", *said)


def simulator(answer: Diagnosis) -> Html:
    """What a simulator that stands for the model contains, and what it leaves over; empty where none does."""
    nominal = answer.simulator
    if nominal is None:
        return NOTHING
    tables = (
        (PARAMETERS, parameter_rows(nominal)),
        (EFFECTS, effect_rows(nominal)),
        (FLOORS, floor_rows(nominal)),
    )
    said = tag("p", " ".join(summary(nominal, claims(answer.causes))))
    pairs = [tag("li", f"{Path(pair.simulated).name} for {Path(pair.real).name}") for pair in nominal.runs]
    runs = tag("details", tag("summary", "Runs"), tag("ul", *pairs))
    return joined([said, *(table(list(heads), rows, "figures") for heads, rows in tables if rows), runs])


def not_explained(answer: Diagnosis) -> Html:
    """What the rest depends on, its shape, what comes nearest, and what would decide."""
    rest = answer.unexplained
    if rest is None:
        return NOTHING
    parts = [tag("p", tag("strong", rest_channel(rest)), ": ", rest_words(rest), ".")]
    if rest.nearest:
        items = [
            tag("li", tag("span", near.effect, class_="name"), f": {near.refused_because}") for near in rest.nearest
        ]
        parts += [tag("p", "Effects that come near, and why each was refused:"), tag("ul", *items)]
    if rest.experiment:
        parts.append(tag("p", "To decide: ", tag("code", f"leactl run {rest.experiment}")))
    if rest.shapes:
        parts.append(tag("div", *shapes_of(rest), class_="pictures"))
    return joined(parts)


def shrinkage(answer: Diagnosis) -> Html:
    """Bars for the channels with a gap, and a table of all."""
    if not answer.shrinkage:
        return NOTHING
    effects = bool(claims(answer.causes))
    largest = largest_first(answer.shrinkage)
    shown = largest if effects else [*largest, *closed_by_calibration(answer.shrinkage)][:CARDS]
    parts = []
    if shown:
        intro = "RMS of measured minus simulated on held-out runs. The bars' scale is logarithmic, each over its floor."
        low, high = span(shown)
        parts += [tag("p", intro, class_="about")]
        parts += [tag("div", *(bars(item, answer.shrinkage, low, high, effects) for item in shown), class_="shrinkage")]
    parts.append(tag("p", f"{counted(answer.shrinkage)}."))
    rows = [
        [label(item, answer.shrinkage), *map(figure, rms(item)), bare_units(item.units), closed_text(item)]
        for item in [*largest, *(item for item in answer.shrinkage if not open_gap(item))]
    ]
    every = table(["channel", *MODELS, "units", "closed (95 %)"], rows, "figures")
    return joined([*parts, tag("details", tag("summary", "All channels"), every)])


def rms(item: Shrinkage) -> tuple[float, float, float, float]:
    """The four numbers in the order of `MODELS`."""
    return item.nominal_rms, item.calibrated_rms, item.augmented_rms, item.floor_rms


def span(items: Sequence[Shrinkage]) -> tuple[float, float]:
    """Ends of the bars' common scale, as logarithms of multiples of the floor."""
    every = np.asarray([value / base(item) for item in items for value in rms(item)])
    positive = every[np.isfinite(every) & (every > 0.0)]
    return math.log(LEAST * float(positive.min())), math.log(float(positive.max()))


def base(item: Shrinkage) -> float:
    """What a channel's bars are multiples of: its floor, or the smallest number where there is none."""
    positive = [value for value in rms(item) if math.isfinite(value) and value > 0.0]
    return item.floor_rms if item.floor_rms in positive else min(positive, default=1.0)


def bars(item: Shrinkage, among: Sequence[Shrinkage], low: float, high: float, effects: bool) -> Html:
    """The bars of one channel; without an effect the augmented model is the calibrated one and has none."""
    drawn = []
    for name, value in zip(MODELS, rms(item), strict=True):
        if name == "augmented" and not effects:
            continue
        positive = math.isfinite(value) and value > 0.0
        share = (math.log(value / base(item)) - low) / (high - low) if positive else 0.0
        drawn += [
            tag("span", name),
            tag("div", tag("i", class_=name, style=f"width:{100 * share:.4g}%"), class_="bar"),
            tag("span", f"{figure(value)} {bare_units(item.units)}"),
        ]
    told = f"closed {closed_text(item)}" if effects else f"{floors(item)} its floor after calibration"
    head = tag("h3", label(item, among), tag("small", told))
    return tag("div", head, tag("div", *drawn, class_="bars"), class_="card")


def where(answer: Diagnosis) -> Html:
    """Every channel with a gap, and the region that holds most of it."""
    rows = [
        [
            label(item, answer.where),
            figure(item.nominal_rms),
            figure(item.calibrated_rms),
            figure(item.floor_rms),
            bare_units(item.units),
            floors(item),
            region_text(item.region, item.share),
        ]
        for item in answer.where
        if open_gap(item)
    ]
    headings = [
        "channel",
        "nominal",
        "calibrated",
        "practical floor",
        "units",
        "over floor",
        "region and its share of the square",
    ]
    about = "The practical floor is what noise leaves, or a replay that explains the channel, up to a few times that."
    return joined([table(headings, rows, "figures"), tag("p", about, class_="about")]) if rows else NOTHING


def calibration(answer: Diagnosis) -> Html:
    """Parameters of the nominal model before and after."""
    rows = [
        [item.parameter, f"{item.nominal:.6g}", with_std(item.fitted, item.std), bare_units(item.units), change(item)]
        for item in answer.calibration
    ]
    return table(["parameter", "nominal", "fitted ± std", "units", "change"], rows, "figures") if rows else NOTHING
