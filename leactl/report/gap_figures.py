"""Figures of a diagnosis: measured beside simulated, and what is left over over the variable of its region."""

import math

import numpy as np

from leactl.gap.diagnosis import Diagnosis, Picture, Rest, Where
from leactl.gap.verdict.shrinkage import Trace
from leactl.gap.verdict.where import Profile
from leactl.report.chart import AxisRange, Bins, Layer, LineMarks, chart
from leactl.report.gap_words import (
    NEAR_FLOOR,
    bare_units,
    floors,
    label,
    open_gap,
    picture_words,
    region_text,
    residual_words,
    variable_words,
)
from leactl.report.html import Html, tag

MOST_CARDS = 5  # channels
MODELS = ("nominal", "calibrated", "augmented")
PICTURE = "Mean residual in each bin with its 95 % interval, on held-out runs"
WITHOUT_AND_WITH = ("before: calibrated without it", "after: with it")
LOGGED_AND_MENDED = ("before: as logged", "after: mended")
LEFT_AND_CLOSED = ("what is left", "beyond a free function of the state")


def channel_cards(answer: Diagnosis) -> list[Html]:
    """A card for each of the channels with the largest gaps; a gap that calibration closed counts."""
    traces = {(entry.quantity, entry.role, entry.mechanical): entry for entry in answer.extra.get("traces", ())}
    profiles = {(entry.quantity, entry.role, entry.mechanical): entry for entry in answer.extra.get("profiles", ())}
    cards = []
    closed = sorted(
        (entry for entry in answer.where if not open_gap(entry)),
        key=lambda entry: -entry.nominal_rms / max(entry.floor_rms, 1e-300),
    )
    for channel in [*filter(open_gap, answer.where), *closed]:
        key = (channel.quantity, channel.role, channel.mechanical)
        if key not in traces or max(channel.nominal_rms, channel.calibrated_rms) < NEAR_FLOOR * channel.floor_rms:
            continue
        charts = [over_time(traces[key])]
        if key in profiles and len(profiles[key].low):
            charts.append(over_variable(profiles[key], channel))
        heading = tag(
            "h3", label(channel, answer.where), tag("small", f"{floors(channel)} its practical floor after calibration")
        )
        cards.append(tag("div", heading, tag("div", *charts, class_="pair"), class_="card"))
    return cards[:MOST_CARDS]


def effect_cards(answer: Diagnosis) -> list[Html]:
    """A card for each effect that is in the augmented model: what is left over, over the variable that it acts in."""
    drawn = [(cause, cause.picture) for cause in answer.causes if cause.picture is not None]
    return [
        picture_card(cause.effect, picture, LOGGED_AND_MENDED, f"{PICTURE}, against what the channel should read")
        if cause.family == "setup"
        else picture_card(cause.effect, picture, WITHOUT_AND_WITH, f"{PICTURE} where the effect acts")
        for cause, picture in drawn
    ]


def rest_cards(rest: Rest) -> list[Html]:
    """A card for each variable that a rest depends on."""
    return [picture_card(variable_words(picture), picture, LEFT_AND_CLOSED, PICTURE) for picture in rest.shapes]


def picture_card(title: str, picture: Picture, names: tuple[str, str], caption: str) -> Html:
    """A picture with its numbers."""
    heading = tag("h3", title, tag("small", picture_words(picture)))
    return tag("div", heading, tag("figure", tag("figcaption", caption), picture_chart(picture, names)), class_="card")


def picture_chart(picture: Picture, names: tuple[str, str]) -> Html:
    """Means in bins with their intervals, before and after, which are given names."""
    drawn_bins = [each_bin for each_bin in picture.bins if math.isfinite(each_bin.before)]
    low, high = (np.asarray([getattr(each_bin, name) for each_bin in drawn_bins]) for name in ("low", "high"))
    layers: list[Layer] = []
    for model, style, name in zip(("before", "after"), ("calibrated", "augmented"), names, strict=True):
        mean = np.asarray([getattr(each_bin, model) for each_bin in drawn_bins])
        spread = np.asarray([getattr(each_bin, f"{model}_high") - getattr(each_bin, model) for each_bin in drawn_bins])
        layers.append(Bins(name, style, low, high, mean, np.nan_to_num(spread)))
    ends = np.asarray([low[0], high[-1]]) if len(drawn_bins) else np.zeros(0)
    layers.append(LineMarks("", "zero", ends, np.zeros(len(ends)), whole=True))
    keys = [(layer.style, layer.name) for layer in layers if layer.name]
    over = with_units(variable_words(picture), picture.variable_units)
    return chart(layers, over, with_units(residual_words(picture), picture.units), keys=keys)


def before_and_after(effects: bool) -> tuple[tuple[str, str], tuple[str, str]]:
    """The models to compare, with their names: around the effects, or around the calibration where none is added."""
    before, after = ("calibrated", "augmented") if effects else ("nominal", "calibrated")
    return (before, f"before ({before})"), (after, f"after ({after})")


def over_time(trace: Trace) -> Html:
    """Measured and simulated over a stretch of one run."""
    layers: list[Layer] = [LineMarks("measured", "measured", trace.time, trace.measured)]
    both = before_and_after(not np.array_equal(trace.calibrated, trace.augmented))
    layers += [LineMarks(words, name, trace.time, getattr(trace, name)) for name, words in both]
    return tag(
        "figure",
        tag("figcaption", f"Measured and simulated where the calibrated model is farthest off, {trace.run}"),
        chart(layers, "time [s]", with_units(trace.quantity, trace.units)),
    )


def over_variable(profile: Profile, channel: Where) -> Html:
    """What the models leave over: mean and standard deviation in bins of the variable."""
    layers: list[Layer] = []
    if channel.region is not None:
        layers.append(AxisRange("region", "region", channel.region.low, channel.region.high))
    for name, words in before_and_after(not np.array_equal(profile.mean[1], profile.mean[2])):
        row = MODELS.index(name)
        layers.append(Bins(words, name, profile.low, profile.high, profile.mean[row], profile.std[row]))
    layers.append(AxisRange("± floor", "floor", -channel.floor_rms, channel.floor_rms, upright=False))
    where = region_text(channel.region, channel.share)
    return tag(
        "figure",
        tag("figcaption", f"Measured minus simulated: mean ± standard deviation in each bin; {where}"),
        chart(layers, with_units(profile.variable, profile.variable_units), f"residual [{profile.units}]"),
    )


def with_units(quantity: str, units: str) -> str:
    """A label for an axis."""
    return f"{quantity} [{units}]" if bare_units(units) else quantity
