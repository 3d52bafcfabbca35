"""Texts and figures of a diagnosis, which the terminal and the page share."""

import math
from collections.abc import Sequence

from leactl.gap.diagnosis import (
    LEAST_GAP_FLOORS,
    MOST_REPLAY_MISS,
    CalibratedParameter,
    Cause,
    DiagnosisResult,
    EffectParameter,
    Near,
    Picture,
    Region,
    Rest,
    Shrinkage,
    SimulatorFloor,
    Where,
)
from leactl.gap.verdict.decision import NAMED_PROBABILITY
from leactl.report.terminal import number
from leactl.vocabulary.effect import effect_definition, effect_names
from leactl.vocabulary.setup_fault import setup_faults
from leactl.vocabulary.variable import VARIABLES

CLOSES_NOTHING = "No gap of held-out runs shrinks with these effects by more than chance."
MENDED_FIRST = "Gaps are of the runs once the set-up is mended."
TIME = "time"  # name of time in `Rest.depends_on`
VERDICTS = {
    "none": "The model explains these runs; no effect is missing.",
    "calibration": "Other parameters explain these runs; no effect is missing.",
    "effect": "The model lacks {causes}.",
    "unknown": "A gap remains that no effect of the library explains.",
}
FAR_OFF = {  # the verdict if a replay is far from the data
    "none": (
        "Nothing in these runs shows what the model lacks, but a replay of {channel} stands {floors:.3g} floors off."
    ),
    "calibration": (
        "Other parameters explain what these runs tell of the model, but a replay of {channel} stands {floors:.3g}"
        " floors off."
    ),
}
ChannelGap = Where | Shrinkage


def verdict_sentence(diagnosis: DiagnosisResult) -> str:
    """Return the verdict as one sentence that names the causes: faults of the set-up, then missing effects."""
    faults, missing_effects = claimed_faults(diagnosis), claimed_effects(diagnosis)
    gap = next((channel for channel in open_gaps_largest_first(diagnosis.shrinkage) if channel.floor_rms > 0.0), None)
    if diagnosis.verdict in FAR_OFF and gap and gap.calibrated_rms > MOST_REPLAY_MISS * gap.floor_rms:
        floors = gap.calibrated_rms / gap.floor_rms
        return FAR_OFF[diagnosis.verdict].format(channel=channel_label(gap, diagnosis.shrinkage), floors=floors)
    if diagnosis.verdict != "effect" or not faults:
        return VERDICTS[diagnosis.verdict].format(causes=enumerated(missing_effects))
    missing_clause = f"; with it mended, the model lacks {enumerated(missing_effects)}" if missing_effects else ""
    return f"The set-up has {enumerated(faults)}{missing_clause}."


def claimed_faults(diagnosis: DiagnosisResult) -> list[str]:
    """Return the faults of the set-up that are said to act; the rest of a diagnosis is on the runs without them."""
    return claimed_causes([cause for cause in diagnosis.causes if cause.family == "setup"])


def claimed_effects(diagnosis: DiagnosisResult) -> list[str]:
    """Return the effects, other than faults of the set-up, that are said to act."""
    return claimed_causes([cause for cause in diagnosis.causes if cause.family != "setup"])


def claimed_causes(causes: Sequence[Cause]) -> list[str]:
    """Return the causes that are said to act; effects that cannot be distinguished are one entry."""
    names: list[str] = []
    covered_effects: set[str] = set()
    for cause in causes:
        if cause.probability < NAMED_PROBABILITY or cause.effect in covered_effects:
            continue
        alternatives = [cause.effect, *cause.indistinguishable_from]
        covered_effects.update(alternatives)
        names.append(cause.effect if len(alternatives) == 1 else f"one of {' / '.join(alternatives)}")
    return names


def enumerated(items: Sequence[str]) -> str:
    """Return items as an enumeration: `a, b and c`."""
    return " and ".join(filter(None, [", ".join(items[:-1]), *items[-1:]]))


def effect_meaning(effect: str) -> str:
    """Return the one-sentence meaning of an effect or of a fault of the set-up; empty if the name is unknown."""
    if effect in effect_names():
        return effect_definition(effect).meaning
    return setup_faults()[effect].meaning if effect in setup_faults() else ""


def channel_label(channel: ChannelGap | SimulatorFloor, channels: Sequence[ChannelGap | SimulatorFloor]) -> str:
    """Return the name of a channel, with its role if `channels` has its quantity and set-up in another role too."""
    roles = {
        candidate.role
        for candidate in channels
        if (candidate.quantity, candidate.mechanical) == (channel.quantity, channel.mechanical)
    }
    return ", ".join(filter(None, [channel.quantity, channel.mechanical, channel.role if len(roles) > 1 else ""]))


def is_gap(rms: float, floor_rms: float) -> bool:
    """Return whether the RMS of an error counts as a gap beside its floor, in the same unit."""
    return rms > 0.0 and rms >= LEAST_GAP_FLOORS * floor_rms


def has_open_gap(channel: ChannelGap) -> bool:
    """Return whether the calibrated model leaves a gap in this channel."""
    return is_gap(channel.calibrated_rms, channel.floor_rms)


def open_gaps_largest_first(channels: Sequence[Shrinkage]) -> list[Shrinkage]:
    """Return the channels with a gap, the largest multiple of the floor first."""
    # a floor of zero comes first
    return sorted(
        filter(has_open_gap, channels), key=lambda channel: -channel.calibrated_rms / max(channel.floor_rms, 1e-300)
    )


def closed_by_calibration(channels: Sequence[Shrinkage]) -> list[Shrinkage]:
    """Return the channels whose gap calibration closes, the largest first."""
    closed_channels = [
        channel for channel in channels if not has_open_gap(channel) and is_gap(channel.nominal_rms, channel.floor_rms)
    ]
    # a floor of zero comes first
    return sorted(closed_channels, key=lambda channel: -channel.nominal_rms / max(channel.floor_rms, 1e-300))


def closes_nothing(diagnosis: DiagnosisResult) -> bool:
    """Return whether effects are claimed although no gap of held-out runs shrinks with them by more than chance."""
    some_gap_shrinks = any(
        channel.closed_low is not None and channel.closed_low > 0.0 for channel in diagnosis.shrinkage
    )
    return bool(claimed_effects(diagnosis)) and bool(diagnosis.shrinkage) and not some_gap_shrinks


def closed_count_text(channels: Sequence[Shrinkage]) -> str:
    """Return as text how many channels have no gap, and in how many of these calibration has closed it."""
    gapless_count = sum(not has_open_gap(channel) for channel in channels)
    calibrated_count = len(closed_by_calibration(channels))
    suffix = f", {calibrated_count} of them by calibration" if calibrated_count else ""
    return f"{gapless_count} of {len(channels)} channels are within {LEAST_GAP_FLOORS:g} times their floor{suffix}"


def three_digits(value: float) -> str:
    """Return a value with three significant digits, a number from 1000 to 100 000 with all digits before the point."""
    if not math.isfinite(value):
        return "not known"
    if value == 0.0:
        return "0"
    if 1e-4 <= abs(value) < 1e5:
        exponent = math.floor(math.log10(float(f"{abs(value):.2e}")))  # of the rounded number
        return f"{value:.{max(0, 2 - exponent)}f}"
    return f"{value:.2e}"


def with_std(value: float, std: float, units: str = "") -> str:
    """Return a text such as `0.0288600 ± 0.0000080 N*m`; a value without an uncertainty stands alone."""
    if not math.isfinite(std) or std <= 0.0:
        value_text = f"{value:.4g}" if math.isfinite(value) else "not known"
    else:
        value_text = f"{number(value, std)} ± {number(std, std)}"
    return f"{value_text} {bare_units(units)}".rstrip()


def bare_units(units: str) -> str:
    """Return units as they are printed behind a number: an empty text for a ratio."""
    return "" if units == "1" else units


def parameter_text(parameter: EffectParameter) -> str:
    """Return value, standard uncertainty and units of an effect's parameter."""
    return with_std(parameter.value, parameter.std, parameter.units)


def change_text(parameter: CalibratedParameter) -> str:
    """Return the change of a parameter by calibration, in percent; empty if a ratio has no meaning for it."""
    if parameter.not_told_by_these_runs:
        return "not told by these runs"
    if not (parameter.has_ratio and math.isfinite(parameter.fitted)):
        return ""
    return f"{100.0 * (parameter.fitted / parameter.nominal - 1.0):+.2f} %"


def calibration_rows(diagnosis: DiagnosisResult) -> list[list[str]]:
    """Return a row for each calibrated parameter: name, nominal and fitted value, units, change."""
    return [
        [
            parameter.parameter,
            f"{parameter.nominal:.6g}",
            with_std(parameter.fitted, parameter.std),
            bare_units(parameter.units),
            change_text(parameter),
        ]
        for parameter in diagnosis.calibration
    ]


def closed_text(channel: Shrinkage) -> str:
    """Return the closed share of a gap in percent, with its 95 % interval."""
    if channel.closed is None:
        return "no gap"
    if channel.closed_low is None or channel.closed_high is None:
        return percent_text(channel.closed)
    low, high = (percent_text(share).removesuffix(" %") for share in (channel.closed_low, channel.closed_high))
    return f"{percent_text(channel.closed)} ({low} .. {high})"


def probability_text(value: float) -> str:
    """Return a probability with two decimals, `> 0.99` or `< 0.01` at the ends."""
    if not math.isfinite(value):
        return "not known"
    return "> 0.99" if value > 0.99 else "< 0.01" if value < 0.01 else f"{value:.2f}"


def percent_text(share: float) -> str:
    """Return a share in percent, without a negative zero."""
    return f"{100.0 * share:.0f} %".replace("-0 %", "0 %") if math.isfinite(share) else "not known"


def multiple_of_floor(channel: ChannelGap) -> str:
    """Return the calibrated gap as a multiple of the channel's floor."""
    return f"{three_digits(channel.calibrated_rms / channel.floor_rms)} x" if channel.floor_rms > 0.0 else "no floor"


def after_calibration(channel: ChannelGap, floor_name: str) -> str:
    """Return a text with the calibrated gap as a multiple of the channel's floor, which is called `floor_name`."""
    return f"{multiple_of_floor(channel)} its {floor_name} after calibration" if channel.floor_rms > 0.0 else "no floor"


def region_text(region: Region | None, share: float) -> str:
    """Return the region that holds most of a gap, and its share of the gap."""
    if region is None:
        return "no narrow region"
    if region.variable == "direction":
        direction = "forward" if region.low >= 0.0 else "backward" if region.high <= 0.0 else "of both signs"
        return f"direction {direction}, {percent_text(share)}"
    range_text = f"{three_digits(region.low)} to {three_digits(region.high)} {bare_units(region.units)}".rstrip()
    turn_text = " within a turn" if region.within_turn else ""
    return f"{region.variable}{turn_text} {range_text}, {percent_text(share)}"


def variable_text(picture: Picture) -> str:
    """Return the name of the variable of a picture; for a folded angle, with the number of periods in a turn."""
    if picture.periods is not None:
        period_text = f"one of {picture.periods:.4g} periods of " if picture.periods > 1.0 else ""
        return f"angle within {period_text}a turn"
    return VARIABLES[picture.variable].label if picture.variable in VARIABLES else picture.variable


def residual_text(picture: Picture) -> str:
    """Return the name of the residual that a picture shows over its variable."""
    sign_label = VARIABLES[picture.along].label if picture.along in VARIABLES else picture.along
    sign_text = f" x sign of {sign_label}" if sign_label else ""
    return f"{picture.quantity}, {picture.mechanical}: residual{sign_text}"


def picture_text(picture: Picture) -> str:
    """Return a text on the RMS of a picture before and after, and the number of bins whose mean differs from zero."""
    units, bins = bare_units(picture.units), len(picture.bins)
    rms_text = f"{three_digits(picture.before_rms)} {units} before, {three_digits(picture.after_rms)} {units} after"
    bins_text = f"off zero in {picture.off_zero_before} bins before, in {picture.off_zero_after} after"
    fit_note = "; before is the effect left out, all else as fitted with it" if picture.refitted is False else ""
    return f"{rms_text} (RMS of {bins} means); {bins_text}{fit_note}"


def rest_channel(residual: Rest) -> str:
    """Return the channel of an unexplained residual and its equation."""
    return f"{residual.quantity}, {residual.mechanical} ({residual.equation})"


def rest_text(residual: Rest) -> str:
    """Return a text on the variables of an unexplained residual, and the share that a free function of them closes."""
    if residual.closable is None:
        return "held-out runs leave no gap beyond noise there"
    # the free function of an angle is periodic in a turn
    labels = {name: variable.label for name, variable in VARIABLES.items()} | {"angle": "angle within a turn"}
    variables, share = (
        [labels[name] for name in residual.depends_on if name != TIME],
        percent_text(residual.closable),
    )
    repetition = None if residual.repeats_Hz is None else f"repeats in time, {residual.repeats_Hz:.4g} times a second"
    if variables:
        suffix = f"; what that leaves {repetition or 'changes slowly with time'}" if TIME in residual.depends_on else ""
        return f"it follows {enumerated(variables)}: a free function closes {share} of the gap on held-out runs{suffix}"
    closable_text = f"a free function of the logged state closes {share} of the gap on held-out runs"
    if repetition:
        return f"it {repetition}, whatever the state is; {closable_text}"
    if TIME in residual.depends_on:
        return f"it changes slowly with time, each stretch of a run like its neighbours; {closable_text}"
    return f"it follows nothing that is logged, nor changes slowly with time; {closable_text}"


def refusal_text(near: Near) -> str:
    """Return a text with a near effect and the reason why it is not named."""
    return f"{near.effect}, refused: {near.refused_because}"
