"""A diagnosis as one HTML file: verdict, causes, how far the gap shrinks, where it sits, calibration, notes.

Nothing is loaded from anywhere and nothing moves: it can be mailed, printed and read again in ten years.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from leactl.gap.diagnosis import Cause, Diagnosis, Shrinkage
from leactl.report.gap_figures import channel_cards, effect_cards, rest_cards
from leactl.report.gap_simulator import summary, tables
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
MOST_CARDS = 12  # channels with bars, where no effect is added
SCALE_START = 0.5  # of the smallest number, where the bars begin: on a log scale there is no zero
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
    model_name = f": {model.name}" if model is not None else ""
    cards = effect_cards(answer)
    body = tag(
        "main",
        tag("h1", f"Gap between model and bench{model_name}"),
        headline(answer),
        preface,
        section("The simulator", simulator(answer)),
        section("Causes", causes(answer)),
        section("What each effect explains", tag("div", *cards, class_="pictures") if cards else NOTHING),
        section("What is not explained", not_explained(answer)),
        section("How far the gap shrinks", shrinkage(answer)),
        section("Where the gap sits", joined([*channel_cards(answer), where(answer)])),
        section("Calibration", calibration(answer)),
        section("Notes", tag("ul", *(tag("li", note) for note in answer.notes)) if answer.notes else NOTHING),
    )
    return document(f"Gap{model_name}", STYLE, body)


def section(title: str, content: Html) -> Html:
    """A part of the page; one without content is left out."""
    return tag("section", tag("h2", title), content) if content else content


def headline(answer: Diagnosis) -> Html:
    """The verdict, the chance that it misses something, and the largest gap closed."""
    facts = [f"Probability that something unexplained acts: {probability(answer.unexplained_probability)}."]
    for channel in largest_first(answer.shrinkage)[:1]:
        after = f", {figure(channel.augmented_rms)} with the effects" if claims(answer.causes) else ""
        closed = f"; closed {closed_text(channel)}" if claims(answer.causes) else ""
        facts.append(
            f"Largest gap: {label(channel, answer.shrinkage)},"
            f" {figure(channel.calibrated_rms)} {bare_units(channel.units)} after calibration{after},"
            f" floor {figure(channel.floor_rms)}{closed}."
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
    return joined([*parts, tag("ol", *(cause_entry(entry, empty) for entry in answer.causes), class_="causes")])


def cause_entry(entry: Cause, closes_no_gap: bool) -> Html:
    """Name, bar (pale where effects close no gap), meaning, parameters, class and the experiment that separates it."""
    share = min(max(entry.probability, 0.0), 1.0) if math.isfinite(entry.probability) else 0.0
    bar = "bar weak" if closes_no_gap or share < PRESENT else "bar"
    parts = [
        tag("div", tag("span", entry.effect, class_="name"), tag("span", probability(entry.probability)), class_="row"),
        tag(
            "div",
            tag("i", style=f"width:{100 * share:.4g}%"),
            class_=bar,
        ),
    ]
    if words := meaning(entry.effect):
        parts.append(tag("p", words))
    if entry.parameters:
        parts.append(
            tag(
                "dl",
                *(
                    element
                    for parameter in entry.parameters
                    for element in (tag("dt", parameter.name), tag("dd", parameter_text(parameter)))
                ),
            )
        )
    if entry.share > 0.0 and entry.family == "setup":
        parts.append(
            tag("p", f"Mended, {percent(entry.share)} of what the channel is off by is gone, on held-out runs.")
        )
    elif entry.share > 0.0:
        parts.append(tag("p", f"Its share of what all causes explain: {percent(entry.share)}."))
    if entry.indistinguishable_from:
        parts.append(tag("p", f"Cannot be told from {listed(entry.indistinguishable_from)} with these runs."))
    if entry.change:
        parts.append(tag("p", f"To mend it: {entry.change}."))
    if entry.separating_experiment:
        parts.append(tag("p", "To separate: ", tag("code", f"leactl run {entry.separating_experiment}")))
    return tag("li", *parts)


def simulator(answer: Diagnosis) -> Html:
    """What a simulator that stands for the model contains, and what it leaves over; empty where none does."""
    nominal = answer.simulator
    if nominal is None:
        return NOTHING
    summary_text = tag("p", " ".join(summary(nominal, claims(answer.causes))))
    pairs = [tag("li", f"{Path(pair.simulated).name} for {Path(pair.real).name}") for pair in nominal.runs]
    runs = tag("details", tag("summary", "Runs"), tag("ul", *pairs))
    return joined([summary_text, *(table(list(heads), rows, "figures") for heads, rows in tables(nominal)), runs])


def not_explained(answer: Diagnosis) -> Html:
    """What the rest depends on, its shape, what comes nearest, and what would decide."""
    rest = answer.unexplained
    if rest is None:
        return NOTHING
    parts = [tag("p", tag("strong", rest_channel(rest)), ": ", rest_words(rest), ".")]
    if rest.nearest:
        refusals = [
            tag("li", tag("span", near.effect, class_="name"), f": {near.refused_because}") for near in rest.nearest
        ]
        parts += [tag("p", "Effects that come near, and why each was refused:"), tag("ul", *refusals)]
    if rest.experiment:
        parts.append(tag("p", "To decide: ", tag("code", f"leactl run {rest.experiment}")))
    if rest.shapes:
        parts.append(tag("div", *rest_cards(rest), class_="pictures"))
    return joined(parts)


def shrinkage(answer: Diagnosis) -> Html:
    """Bars for the channels with a gap, and a table of all."""
    if not answer.shrinkage:
        return NOTHING
    effects = bool(claims(answer.causes))
    largest = largest_first(answer.shrinkage)
    shown = largest if effects else [*largest, *closed_by_calibration(answer.shrinkage)][:MOST_CARDS]
    parts = []
    if shown:
        intro = "RMS of measured minus simulated on held-out runs. The bars' scale is logarithmic, each over its floor."
        low, high = span(shown)
        parts += [tag("p", intro, class_="about")]
        parts += [
            tag("div", *(bars(channel, answer.shrinkage, low, high, effects) for channel in shown), class_="shrinkage")
        ]
    parts.append(tag("p", f"{counted(answer.shrinkage)}."))
    rows = [
        [label(channel, answer.shrinkage), *map(figure, rms(channel)), bare_units(channel.units), closed_text(channel)]
        for channel in [*largest, *(channel for channel in answer.shrinkage if not open_gap(channel))]
    ]
    all_channels = table(["channel", *MODELS, "units", "closed (95 %)"], rows, "figures")
    return joined([*parts, tag("details", tag("summary", "All channels"), all_channels)])


def rms(channel: Shrinkage) -> tuple[float, float, float, float]:
    """The four numbers in the order of `MODELS`."""
    return channel.nominal_rms, channel.calibrated_rms, channel.augmented_rms, channel.floor_rms


def span(channels: Sequence[Shrinkage]) -> tuple[float, float]:
    """Ends of the bars' common scale, as logarithms of multiples of the floor."""
    ratios = np.asarray([value / base(channel) for channel in channels for value in rms(channel)])
    positive = ratios[np.isfinite(ratios) & (ratios > 0.0)]
    return math.log(SCALE_START * float(positive.min())), math.log(float(positive.max()))


def base(channel: Shrinkage) -> float:
    """What a channel's bars are multiples of: its floor, or the smallest number where there is none."""
    positive = [value for value in rms(channel) if math.isfinite(value) and value > 0.0]
    return channel.floor_rms if channel.floor_rms in positive else min(positive, default=1.0)


def bars(channel: Shrinkage, channels: Sequence[Shrinkage], low: float, high: float, effects: bool) -> Html:
    """The bars of one channel; without an effect the augmented model is the calibrated one and has none."""
    drawn = []
    for name, value in zip(MODELS, rms(channel), strict=True):
        if name == "augmented" and not effects:
            continue
        positive = math.isfinite(value) and value > 0.0
        share = (math.log(value / base(channel)) - low) / (high - low) if positive else 0.0
        drawn += [
            tag("span", name),
            tag("div", tag("i", class_=name, style=f"width:{100 * share:.4g}%"), class_="bar"),
            tag("span", f"{figure(value)} {bare_units(channel.units)}"),
        ]
    remark = f"closed {closed_text(channel)}" if effects else f"{floors(channel)} its floor after calibration"
    head = tag("h3", label(channel, channels), tag("small", remark))
    return tag("div", head, tag("div", *drawn, class_="bars"), class_="card")


def where(answer: Diagnosis) -> Html:
    """Every channel with a gap, and the region that holds most of it."""
    rows = [
        [
            label(channel, answer.where),
            figure(channel.nominal_rms),
            figure(channel.calibrated_rms),
            figure(channel.floor_rms),
            bare_units(channel.units),
            floors(channel),
            region_text(channel.region, channel.share),
        ]
        for channel in answer.where
        if open_gap(channel)
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
        [
            parameter.parameter,
            f"{parameter.nominal:.6g}",
            with_std(parameter.fitted, parameter.std),
            bare_units(parameter.units),
            change(parameter),
        ]
        for parameter in answer.calibration
    ]
    return table(["parameter", "nominal", "fitted ± std", "units", "change"], rows, "figures") if rows else NOTHING
