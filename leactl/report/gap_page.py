"""A diagnosis as one HTML file: verdict, causes, reduction and regions of the gap, calibration, notes.

The page loads nothing and runs no script, so that it can be mailed, printed and kept.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from leactl.gap.diagnosis import Cause, DiagnosisResult, Rest, Shrinkage, SimulatorAnswer
from leactl.gap.verdict.decision import NAMED_PROBABILITY
from leactl.report.gap_figures import channel_cards, effect_cards, rest_cards
from leactl.report.gap_simulator import simulator_sentences, simulator_tables
from leactl.report.gap_words import (
    CLOSES_NOTHING,
    MENDED_FIRST,
    after_calibration,
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
    has_open_gap,
    multiple_of_floor,
    open_gaps_largest_first,
    parameter_text,
    percent_text,
    probability_text,
    region_text,
    rest_channel,
    rest_text,
    three_digits,
    verdict_sentence,
)
from leactl.report.html import code_parts, render

MODELS = ("nominal", "calibrated", "augmented", "floor")
MOST_CARDS = 12  # channels that have bars if no effect is added
SCALE_START = 0.5  # start of the logarithmic scale of the bars, as a multiple of the smallest value


def page(diagnosis: DiagnosisResult) -> str:
    """Return the whole diagnosis as one self-contained page; the same diagnosis gives the same page."""
    return render("gap.html", **content(diagnosis))


def content(diagnosis: DiagnosisResult) -> dict[str, Any]:
    """Return the variables of the template `gap.html` for a diagnosis."""
    augmented_model, nothing_closes = diagnosis.extra.get("augmented"), closes_nothing(diagnosis)
    return {
        "of_model": f": {augmented_model.name}" if augmented_model is not None else "",
        "verdict": diagnosis.verdict,
        "sentence": verdict_sentence(diagnosis),
        "facts": headline_facts(diagnosis),
        "simulator": simulator_content(diagnosis.simulator, claimed_effects(diagnosis))
        if diagnosis.simulator
        else None,
        "causes": [cause_content(cause, nothing_closes) for cause in diagnosis.causes],
        "closes_nothing": CLOSES_NOTHING if nothing_closes else "",
        "effect_cards": effect_cards(diagnosis),
        "rest": rest_content(diagnosis.unexplained) if diagnosis.unexplained else None,
        "shrinkage": shrinkage_content(diagnosis) if diagnosis.shrinkage else None,
        "channel_cards": channel_cards(diagnosis),
        "regions": region_rows(diagnosis),
        "calibration": calibration_rows(diagnosis),
        "notes": [code_parts(note) for note in diagnosis.notes],
    }


def headline_facts(diagnosis: DiagnosisResult) -> list[str]:
    """Return the probability that something unexplained acts, the largest gap, and how many channels have none."""
    facts = [f"Probability that something unexplained acts: {probability_text(diagnosis.unexplained_probability)}."]
    for channel in open_gaps_largest_first(diagnosis.shrinkage)[:1]:
        augmented_text = (
            f", {three_digits(channel.augmented_rms)} with the effects" if claimed_effects(diagnosis) else ""
        )
        closed_clause = f"; closed {closed_text(channel)}" if claimed_effects(diagnosis) else ""
        facts.append(
            f"Largest gap: {channel_label(channel, diagnosis.shrinkage)},"
            f" {three_digits(channel.calibrated_rms)} {bare_units(channel.units)} after calibration{augmented_text},"
            f" floor {three_digits(channel.floor_rms)}{closed_clause}."
        )
    if diagnosis.shrinkage:
        facts += [MENDED_FIRST] if claimed_faults(diagnosis) else []
        facts.append(f"{closed_count_text(diagnosis.shrinkage)}.")
    return facts


def cause_content(cause: Cause, closes_no_gap: bool) -> dict[str, Any]:
    """Return a cause's bar, meaning, parameters, similar effects, remedy and separating experiment."""
    probability = min(max(cause.probability, 0.0), 1.0) if math.isfinite(cause.probability) else 0.0
    return {
        "effect": cause.effect,
        "probability": probability_text(cause.probability),
        "width": f"{100 * probability:.4g}%",
        "weak": closes_no_gap or probability < NAMED_PROBABILITY,
        "meaning": effect_meaning(cause.effect),
        "parameters": [(parameter.name, parameter_text(parameter)) for parameter in cause.parameters],
        "of_setup": cause.family == "setup",
        "share": percent_text(cause.share) if cause.share > 0.0 else "",
        "indistinguishable_from": enumerated(cause.indistinguishable_from),
        "change": code_parts(cause.change) if cause.change else None,
        "experiment": cause.separating_experiment,
    }


def simulator_content(simulator: SimulatorAnswer, real_effects: Sequence[str]) -> dict[str, Any]:
    """Return sentences and tables on a simulator that takes the place of the model, and the pairs of runs."""
    return {
        "summary": " ".join(simulator_sentences(simulator, real_effects)),
        "tables": simulator_tables(simulator),
        "runs": [(Path(pair.simulated).name, Path(pair.real).name) for pair in simulator.runs],
    }


def rest_content(residual: Rest) -> dict[str, Any]:
    """Return the dependences of the unexplained residual, the nearest effects, and the deciding experiment."""
    return {
        "channel": rest_channel(residual),
        "words": rest_text(residual),
        "nearest": residual.nearest,
        "experiment": residual.experiment,
        "cards": rest_cards(residual),
    }


def shrinkage_content(diagnosis: DiagnosisResult) -> dict[str, Any]:
    """Return the bars of the channels with a gap, and a table of all channels."""
    has_effects = bool(claimed_effects(diagnosis))
    open_channels = open_gaps_largest_first(diagnosis.shrinkage)
    shown_channels = (
        open_channels if has_effects else [*open_channels, *closed_by_calibration(diagnosis.shrinkage)][:MOST_CARDS]
    )
    scale = scale_ends(shown_channels) if shown_channels else (0.0, 0.0)
    rows = [
        [
            channel_label(channel, diagnosis.shrinkage),
            *map(three_digits, rms_by_model(channel)),
            bare_units(channel.units),
            closed_text(channel),
        ]
        for channel in [*open_channels, *(channel for channel in diagnosis.shrinkage if not has_open_gap(channel))]
    ]
    headings = ["channel", *MODELS, "units", "closed (95 %)"]
    if not has_effects:
        dropped_columns = {headings.index("augmented"), headings.index("closed (95 %)")}
        headings, *rows = (
            [cell for k, cell in enumerate(row) if k not in dropped_columns] for row in (headings, *rows)
        )
    return {
        "channels": [channel_bars(channel, diagnosis.shrinkage, *scale, has_effects) for channel in shown_channels],
        "count": closed_count_text(diagnosis.shrinkage),
        "headings": headings,
        "rows": rows,
    }


def rms_by_model(channel: Shrinkage) -> tuple[float, float, float, float]:
    """Return a channel's RMS of the residuals in the order of `MODELS`."""
    return channel.nominal_rms, channel.calibrated_rms, channel.augmented_rms, channel.floor_rms


def scale_ends(channels: Sequence[Shrinkage]) -> tuple[float, float]:
    """Return both ends of the bars' common scale, as natural logarithms of multiples of the floor."""
    ratios = np.asarray([value / bar_unit(channel) for channel in channels for value in rms_by_model(channel)])
    positive = ratios[np.isfinite(ratios) & (ratios > 0.0)]
    return math.log(SCALE_START * float(positive.min())), math.log(float(positive.max()))


def bar_unit(channel: Shrinkage) -> float:
    """Return the unit of the bars of a channel: the RMS of its floor, or its smallest RMS if it has no floor."""
    positive = [value for value in rms_by_model(channel) if math.isfinite(value) and value > 0.0]
    return channel.floor_rms if channel.floor_rms in positive else min(positive, default=1.0)


def channel_bars(
    channel: Shrinkage, channels: Sequence[Shrinkage], scale_start: float, scale_end: float, has_effects: bool
) -> dict[str, Any]:
    """Return the bars of one channel; without effects the augmented model has no bar, since it is the calibrated one.

    Parameters
    ----------
    scale_start, scale_end : as `scale_ends` returns them.
    has_effects : whether effects are claimed.
    """
    bars = []
    for name, value in zip(MODELS, rms_by_model(channel), strict=True):
        if name == "augmented" and not has_effects:
            continue
        is_positive = math.isfinite(value) and value > 0.0
        share = (math.log(value / bar_unit(channel)) - scale_start) / (scale_end - scale_start) if is_positive else 0.0
        bars.append((name, f"{100 * share:.4g}%", f"{three_digits(value)} {bare_units(channel.units)}"))
    remark = f"closed {closed_text(channel)}" if has_effects else after_calibration(channel, "floor")
    return {"label": channel_label(channel, channels), "remark": remark, "bars": bars}


def region_rows(diagnosis: DiagnosisResult) -> list[list[str]]:
    """Return a row for each channel with a gap: RMS by model, and the region with most of the gap."""
    return [
        [
            channel_label(channel, diagnosis.where),
            three_digits(channel.nominal_rms),
            three_digits(channel.calibrated_rms),
            three_digits(channel.floor_rms),
            bare_units(channel.units),
            multiple_of_floor(channel),
            region_text(channel.region, channel.share),
        ]
        for channel in diagnosis.where
        if has_open_gap(channel)
    ]
