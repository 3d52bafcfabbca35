"""A diagnosis as one HTML file: verdict, causes, how far the gap shrinks, where it sits, calibration, notes.

The page loads nothing and runs no script, so that it can be mailed, printed and kept.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from leactl.gap.diagnosis import Cause, Diagnosis, Shrinkage
from leactl.report.gap_figures import channel_cards, effect_cards, rest_cards
from leactl.report.gap_simulator import simulator_sentences, simulator_tables
from leactl.report.gap_words import (
    CLOSES_NOTHING,
    MENDED_FIRST,
    PRESENT_FROM,
    bare_units,
    calibration_rows,
    channel_label,
    claimed_effects,
    claimed_faults,
    closed_by_calibration,
    closed_count_text,
    closed_text,
    closes_nothing,
    effect_meaning,
    enumerated,
    largest_first,
    multiple_of_floor,
    open_gap,
    parameter_text,
    percent_text,
    probability_text,
    region_text,
    rest_channel,
    rest_words,
    three_digits,
    verdict_sentence,
)
from leactl.report.html import Html, document, joined, table, tag, with_code
from leactl.report.page_style import PAGE

NO_CONTENT = Html("")
MODELS = ("nominal", "calibrated", "augmented", "floor")
MOST_CARDS = 12  # channels with bars, where no effect is added
SCALE_START = 0.5  # of the smallest value, where the logarithmic scale of the bars begins
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


def page(answer: Diagnosis, preface: Html = NO_CONTENT) -> str:
    """Return the whole diagnosis as one self-contained page; the same answer gives the same page.

    preface : a section that follows the verdict.
    """
    model = answer.extra.get("augmented")
    model_name = f": {model.name}" if model is not None else ""
    cards = effect_cards(answer)
    notes = [tag("li", with_code(note)) for note in answer.notes]
    body = tag(
        "main",
        tag("h1", f"Gap between model and bench{model_name}"),
        headline(answer),
        preface,
        section("The simulator", simulator_content(answer)),
        section("Causes", causes_content(answer)),
        section("What each effect explains", tag("div", *cards, class_="pictures") if cards else NO_CONTENT),
        section("What is not explained", unexplained_content(answer)),
        section("How far the gap shrinks", shrinkage_content(answer)),
        section("Where the gap sits", joined([*channel_cards(answer), regions_table(answer)])),
        section("Calibration", calibration_table(answer)),
        section("Notes", tag("ul", *notes) if notes else NO_CONTENT),
    )
    return document(f"Gap{model_name}", STYLE, body)


def section(title: str, content: Html) -> Html:
    """Return a part of the page with its heading; empty where it has no content."""
    return tag("section", tag("h2", title), content) if content else content


def headline(answer: Diagnosis) -> Html:
    """Return the verdict, the probability that something unexplained acts, and the largest gap."""
    facts = [f"Probability that something unexplained acts: {probability_text(answer.unexplained_probability)}."]
    for channel in largest_first(answer.shrinkage)[:1]:
        after = f", {three_digits(channel.augmented_rms)} with the effects" if claimed_effects(answer) else ""
        closed = f"; closed {closed_text(channel)}" if claimed_effects(answer) else ""
        facts.append(
            f"Largest gap: {channel_label(channel, answer.shrinkage)},"
            f" {three_digits(channel.calibrated_rms)} {bare_units(channel.units)} after calibration{after},"
            f" floor {three_digits(channel.floor_rms)}{closed}."
        )
    if answer.shrinkage:
        facts += [MENDED_FIRST] if claimed_faults(answer) else []
        facts.append(f"{closed_count_text(answer.shrinkage)}.")
    return tag(
        "div",
        tag("p", tag("strong", answer.verdict, class_="verdict"), " ", verdict_sentence(answer), class_="lead"),
        *(tag("p", fact) for fact in facts),
        class_="headline",
    )


def causes_content(answer: Diagnosis) -> Html:
    """Return an entry with a bar of its probability for each cause."""
    if not answer.causes:
        return NO_CONTENT
    intro = "Each bar is the probability that the effect is present; they need not sum to 1."
    empty = closes_nothing(answer)
    parts = [tag("p", intro, class_="about")]
    parts += [tag("p", CLOSES_NOTHING)] if empty else []
    return joined([*parts, tag("ol", *(cause_entry(entry, empty) for entry in answer.causes), class_="causes")])


def cause_entry(entry: Cause, closes_no_gap: bool) -> Html:
    """Return a cause's name, probability, meaning, parameters, similar effects and separating experiment."""
    share = min(max(entry.probability, 0.0), 1.0) if math.isfinite(entry.probability) else 0.0
    bar = "bar weak" if closes_no_gap or share < PRESENT_FROM else "bar"
    parts = [
        tag(
            "div",
            tag("span", entry.effect, class_="name"),
            tag("span", probability_text(entry.probability)),
            class_="row",
        ),
        tag(
            "div",
            tag("i", style=f"width:{100 * share:.4g}%"),
            class_=bar,
        ),
    ]
    if words := effect_meaning(entry.effect):
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
            tag("p", f"Mended, {percent_text(entry.share)} of what the channel is off by is gone, on held-out runs.")
        )
    elif entry.share > 0.0:
        parts.append(tag("p", f"Its share of what all causes explain: {percent_text(entry.share)}."))
    if entry.indistinguishable_from:
        parts.append(tag("p", f"Cannot be told from {enumerated(entry.indistinguishable_from)} with these runs."))
    if entry.change:
        parts.append(tag("p", "To mend it: ", with_code(entry.change), "."))
    if entry.separating_experiment:
        parts.append(tag("p", "To separate: ", tag("code", f"leactl run {entry.separating_experiment}")))
    return tag("li", *parts)


def simulator_content(answer: Diagnosis) -> Html:
    """Return what a simulator that stands for the model contains and leaves over; empty where there is none."""
    nominal = answer.simulator
    if nominal is None:
        return NO_CONTENT
    summary_text = tag("p", " ".join(simulator_sentences(nominal, claimed_effects(answer))))
    pairs = [tag("li", f"{Path(pair.simulated).name} for {Path(pair.real).name}") for pair in nominal.runs]
    runs = tag("details", tag("summary", "Runs"), tag("ul", *pairs))
    return joined(
        [summary_text, *(table(list(heads), rows, "figures") for heads, rows in simulator_tables(nominal)), runs]
    )


def unexplained_content(answer: Diagnosis) -> Html:
    """Return what the unexplained rest depends on, the effects that come near, and the experiment that would decide."""
    rest = answer.unexplained
    if rest is None:
        return NO_CONTENT
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


def shrinkage_content(answer: Diagnosis) -> Html:
    """Return bars for the channels with a gap, and a table of all channels."""
    if not answer.shrinkage:
        return NO_CONTENT
    effects = bool(claimed_effects(answer))
    largest = largest_first(answer.shrinkage)
    shown = largest if effects else [*largest, *closed_by_calibration(answer.shrinkage)][:MOST_CARDS]
    parts = []
    if shown:
        intro = "RMS of measured minus simulated on held-out runs. The bars' scale is logarithmic, each over its floor."
        low, high = scale_ends(shown)
        parts += [tag("p", intro, class_="about")]
        parts += [
            tag(
                "div",
                *(channel_bars(channel, answer.shrinkage, low, high, effects) for channel in shown),
                class_="shrinkage",
            )
        ]
    parts.append(tag("p", f"{closed_count_text(answer.shrinkage)}."))
    rows = [
        [
            channel_label(channel, answer.shrinkage),
            *map(three_digits, rms_by_model(channel)),
            bare_units(channel.units),
            closed_text(channel),
        ]
        for channel in [*largest, *(channel for channel in answer.shrinkage if not open_gap(channel))]
    ]
    headings = ["channel", *MODELS, "units", "closed (95 %)"]
    if not effects:
        dropped = {headings.index("augmented"), headings.index("closed (95 %)")}
        headings, *rows = ([cell for k, cell in enumerate(row) if k not in dropped] for row in (headings, *rows))
    all_channels = table(headings, rows, "figures")
    return joined([*parts, tag("details", tag("summary", "All channels"), all_channels)])


def rms_by_model(channel: Shrinkage) -> tuple[float, float, float, float]:
    """Return a channel's RMS of the residuals in the order of `MODELS`."""
    return channel.nominal_rms, channel.calibrated_rms, channel.augmented_rms, channel.floor_rms


def scale_ends(channels: Sequence[Shrinkage]) -> tuple[float, float]:
    """Return both ends of the bars' common scale, as natural logarithms of multiples of the floor."""
    ratios = np.asarray([value / bar_unit(channel) for channel in channels for value in rms_by_model(channel)])
    positive = ratios[np.isfinite(ratios) & (ratios > 0.0)]
    return math.log(SCALE_START * float(positive.min())), math.log(float(positive.max()))


def bar_unit(channel: Shrinkage) -> float:
    """Return the RMS that a channel's bars are multiples of: its floor, or its smallest RMS where it has no floor."""
    positive = [value for value in rms_by_model(channel) if math.isfinite(value) and value > 0.0]
    return channel.floor_rms if channel.floor_rms in positive else min(positive, default=1.0)


def channel_bars(channel: Shrinkage, channels: Sequence[Shrinkage], low: float, high: float, effects: bool) -> Html:
    """Return one channel's bars; without an effect the augmented model has none, since it is the calibrated one."""
    drawn = []
    for name, value in zip(MODELS, rms_by_model(channel), strict=True):
        if name == "augmented" and not effects:
            continue
        positive = math.isfinite(value) and value > 0.0
        share = (math.log(value / bar_unit(channel)) - low) / (high - low) if positive else 0.0
        drawn += [
            tag("span", name),
            tag("div", tag("i", class_=name, style=f"width:{100 * share:.4g}%"), class_="bar"),
            tag("span", f"{three_digits(value)} {bare_units(channel.units)}"),
        ]
    remark = (
        f"closed {closed_text(channel)}" if effects else f"{multiple_of_floor(channel)} its floor after calibration"
    )
    head = tag("h3", channel_label(channel, channels), tag("small", remark))
    return tag("div", head, tag("div", *drawn, class_="bars"), class_="card")


def regions_table(answer: Diagnosis) -> Html:
    """Return a row for each channel with a gap and the region that holds most of it."""
    rows = [
        [
            channel_label(channel, answer.where),
            three_digits(channel.nominal_rms),
            three_digits(channel.calibrated_rms),
            three_digits(channel.floor_rms),
            bare_units(channel.units),
            multiple_of_floor(channel),
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
    return joined([table(headings, rows, "figures"), tag("p", about, class_="about")]) if rows else NO_CONTENT


def calibration_table(answer: Diagnosis) -> Html:
    """Return a row for each parameter of the nominal model, before and after calibration."""
    rows = calibration_rows(answer)
    return table(["parameter", "nominal", "fitted ± std", "units", "change"], rows, "figures") if rows else NO_CONTENT
