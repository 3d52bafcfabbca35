"""Figures of a diagnosis: measured and simulated channels over time, and residuals over the variable of a region."""

import math
from typing import NamedTuple

import numpy as np

from leactl.gap.diagnosis import DiagnosisResult, Picture, Rest, Where
from leactl.gap.verdict.shrinkage import Trace
from leactl.gap.verdict.where import Profile
from leactl.report.chart import AxisRange, Bins, CaptionedChart, Layer, LineMarks, chart
from leactl.report.gap_words import (
    after_calibration,
    bare_units,
    channel_label,
    has_open_gap,
    is_gap,
    picture_text,
    region_text,
    residual_text,
    variable_text,
)

MOST_CARDS = 5  # each of one channel
MODELS = ("nominal", "calibrated", "augmented")
PICTURE = "Mean residual in each bin with its 95 % interval, on held-out runs"
WITHOUT_AND_WITH = ("before: calibrated without it", "after: with it")
LEFT_OUT_AND_WITH = ("before: left out, else as with it", "after: with it")
LOGGED_AND_MENDED = ("before: as logged", "after: mended")
LEFT_AND_CLOSED = ("what is left", "beyond a free function of the state")


class Card(NamedTuple):
    """Charts of one subject under its title."""

    title: str
    remark: str
    figures: list[CaptionedChart]


def channel_cards(diagnosis: DiagnosisResult) -> list[Card]:
    """Return a card for each channel with a large gap, open gaps first, then gaps that calibration closed."""
    traces = {(record.quantity, record.role, record.mechanical): record for record in diagnosis.extra.get("traces", ())}
    profiles = {
        (record.quantity, record.role, record.mechanical): record for record in diagnosis.extra.get("profiles", ())
    }
    cards = []
    closed_channels = sorted(
        (record for record in diagnosis.where if not has_open_gap(record)),
        key=lambda record: -record.nominal_rms / max(record.floor_rms, 1e-300),
    )
    for channel in [*filter(has_open_gap, diagnosis.where), *closed_channels]:
        key = (channel.quantity, channel.role, channel.mechanical)
        if key not in traces or not is_gap(max(channel.nominal_rms, channel.calibrated_rms), channel.floor_rms):
            continue
        figures = [trace_figure(traces[key])]
        if key in profiles and len(profiles[key].low):
            figures.append(profile_figure(profiles[key], channel))
        remark = after_calibration(channel, "practical floor")
        cards.append(Card(channel_label(channel, diagnosis.where), remark, figures))
    return cards[:MOST_CARDS]


def effect_cards(diagnosis: DiagnosisResult) -> list[Card]:
    """Return a card for each cause: the residual before and after it is added, over the variable on which it acts."""
    pictured_causes = [(cause, cause.picture) for cause in diagnosis.causes if cause.picture is not None]
    return [
        picture_card(cause.effect, picture, LOGGED_AND_MENDED, f"{PICTURE}, against what the channel should read")
        if cause.family == "setup"
        else picture_card(
            cause.effect,
            picture,
            LEFT_OUT_AND_WITH if picture.refitted is False else WITHOUT_AND_WITH,
            f"{PICTURE} where the effect acts",
        )
        for cause, picture in pictured_causes
    ]


def rest_cards(residual: Rest) -> list[Card]:
    """Return a card for each variable that an unexplained residual depends on."""
    return [picture_card(variable_text(picture), picture, LEFT_AND_CLOSED, PICTURE) for picture in residual.shapes]


def picture_card(title: str, picture: Picture, names: tuple[str, str], caption: str) -> Card:
    """Return the mean residual in each bin with its 95 % interval, before and after; `names` are their legend."""
    drawn_bins = [each_bin for each_bin in picture.bins if math.isfinite(each_bin.before)]
    low, high = (np.asarray([getattr(each_bin, name) for each_bin in drawn_bins]) for name in ("low", "high"))
    layers: list[Layer] = []
    for model, style, name in zip(("before", "after"), ("calibrated", "augmented"), names, strict=True):
        mean = np.asarray([getattr(each_bin, model) for each_bin in drawn_bins])
        half_width = np.asarray(
            [getattr(each_bin, f"{model}_high") - getattr(each_bin, model) for each_bin in drawn_bins]
        )
        layers.append(Bins(name, style, low, high, mean, np.nan_to_num(half_width)))
    zero_ends = np.asarray([low[0], high[-1]]) if len(drawn_bins) else np.zeros(0)
    layers.append(LineMarks("", "zero", zero_ends, np.zeros(len(zero_ends)), connected=True))
    keys = [(layer.style, layer.name) for layer in layers if layer.name]
    x_label = with_units(variable_text(picture), picture.variable_units)
    drawn_chart = chart(layers, x_label, with_units(residual_text(picture), picture.units), keys=keys)
    return Card(title, picture_text(picture), [CaptionedChart(caption, drawn_chart)])


def compared_models(has_effects: bool) -> tuple[tuple[str, str], tuple[str, str]]:
    """Return name and legend of two models: without and with the effects, else before and after calibration."""
    first_model, second_model = ("calibrated", "augmented") if has_effects else ("nominal", "calibrated")
    return (first_model, f"before ({first_model})"), (second_model, f"after ({second_model})")


def trace_figure(trace: Trace) -> CaptionedChart:
    """Return a chart of the measured and the simulated channel over a part of one run."""
    layers: list[Layer] = [LineMarks("measured", "measured", trace.time, trace.measured)]
    models = compared_models(not np.array_equal(trace.calibrated, trace.augmented))
    layers += [LineMarks(label, name, trace.time, getattr(trace, name)) for name, label in models]
    caption = f"Measured and simulated where the calibrated model is farthest off, {trace.run}"
    return CaptionedChart(caption, chart(layers, "time [s]", with_units(trace.quantity, trace.units)))


def profile_figure(profile: Profile, channel: Where) -> CaptionedChart:
    """Return a chart of the residuals: mean and standard deviation in bins of the region's variable."""
    layers: list[Layer] = []
    if channel.region is not None:
        layers.append(AxisRange("region", "region", channel.region.low, channel.region.high))
    for name, label in compared_models(not np.array_equal(profile.mean[1], profile.mean[2])):
        model_row = MODELS.index(name)
        layers.append(Bins(label, name, profile.low, profile.high, profile.mean[model_row], profile.std[model_row]))
    layers.append(AxisRange("± floor", "floor", -channel.floor_rms, channel.floor_rms, upright=False))
    region = region_text(channel.region, channel.share)
    caption = f"Measured minus simulated: mean ± standard deviation in each bin; {region}"
    drawn_chart = chart(layers, with_units(profile.variable, profile.variable_units), f"residual [{profile.units}]")
    return CaptionedChart(caption, drawn_chart)


def with_units(quantity: str, units: str) -> str:
    """Return the label of an axis: a quantity with its units in brackets, none for a ratio."""
    return f"{quantity} [{units}]" if bare_units(units) else quantity
