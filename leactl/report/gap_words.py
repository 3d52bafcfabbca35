"""What a diagnosis says in words and figures, alike for the terminal and the page."""

import math
from collections.abc import Sequence

from leactl.gap.diagnosis import (
    CalibratedParameter,
    Cause,
    Diagnosis,
    EffectParameter,
    Near,
    Picture,
    Region,
    Rest,
    Shrinkage,
    SimulatorFloor,
    Where,
)
from leactl.report.terminal import number
from leactl.vocabulary.effect import effect_definition, effect_names
from leactl.vocabulary.setup_fault import setup_faults
from leactl.vocabulary.variable import VARIABLES

CLOSES_NOTHING = "No gap of held-out runs shrinks with these effects by more than chance."
TIME = "time"  # as what a rest depends on
PRESENT = 0.5  # probability from which on a cause is said to act
NEAR_FLOOR = 1.1  # floors, below which no gap is left to close
VERDICTS = {
    "none": "The model explains these runs; no gap is left.",
    "calibration": "Other parameters explain these runs; no effect is missing.",
    "effect": "The model lacks {causes}.",
    "unknown": "A gap remains that no effect of the library explains.",
}
Channel = Where | Shrinkage


def sentence(answer: Diagnosis) -> str:
    """The verdict as one sentence that names the causes; faults of the set-up are nothing that a model lacks."""
    faults, lacking = (
        claims([cause for cause in answer.causes if (cause.family == "setup") is of_setup])
        for of_setup in (True, False)
    )
    if answer.verdict != "effect" or not faults:
        return VERDICTS[answer.verdict].format(causes=listed(lacking))
    lacks = f"; with it mended, the model lacks {listed(lacking)}" if lacking else ""
    return f"The set-up has {listed(faults)}{lacks}."


def claims(causes: Sequence[Cause]) -> list[str]:
    """Causes that are said to act, each class once."""
    names: list[str] = []
    claimed: set[str] = set()
    for cause in causes:
        if cause.probability < PRESENT or cause.effect in claimed:
            continue
        members = [cause.effect, *cause.indistinguishable_from]
        claimed.update(members)
        names.append(cause.effect if len(members) == 1 else f"one of {' / '.join(members)}")
    return names


def listed(items: Sequence[str]) -> str:
    """`a, b and c`."""
    return " and ".join(filter(None, [", ".join(items[:-1]), *items[-1:]]))


def meaning(effect: str) -> str:
    """What an effect of the library, or a fault of a set-up, is, in one sentence."""
    if effect in effect_names():
        return effect_definition(effect).meaning
    return setup_faults()[effect].meaning if effect in setup_faults() else ""


def label(channel: Channel | SimulatorFloor, channels: Sequence[Channel | SimulatorFloor]) -> str:
    """A channel's name; its role only where another of the same quantity and set-up stands beside it."""
    roles = {
        other.role for other in channels if (other.quantity, other.mechanical) == (channel.quantity, channel.mechanical)
    }
    return ", ".join(filter(None, [channel.quantity, channel.mechanical, channel.role if len(roles) > 1 else ""]))


def open_gap(channel: Channel) -> bool:
    """Whether the calibrated model leaves a gap in this channel."""
    return channel.calibrated_rms > 0.0 and channel.calibrated_rms >= NEAR_FLOOR * channel.floor_rms


def largest_first(channels: Sequence[Shrinkage]) -> list[Shrinkage]:
    """Channels with a gap, by how many floors it is."""
    return sorted(
        filter(open_gap, channels), key=lambda channel: -channel.calibrated_rms / max(channel.floor_rms, 1e-300)
    )


def closed_by_calibration(channels: Sequence[Shrinkage]) -> list[Shrinkage]:
    """Channels whose gap is gone once the model's own parameters are fitted, the largest first."""
    closed = [
        channel
        for channel in channels
        if not open_gap(channel) and channel.nominal_rms >= NEAR_FLOOR * channel.floor_rms
    ]
    return sorted(closed, key=lambda channel: -channel.nominal_rms / max(channel.floor_rms, 1e-300))


def closes_nothing(answer: Diagnosis) -> bool:
    """Whether effects are claimed, and no gap of held-out runs shrinks with them beyond chance."""
    shrinks = any(channel.closed_low is not None and channel.closed_low > 0.0 for channel in answer.shrinkage)
    effects = claims([cause for cause in answer.causes if cause.family != "setup"])  # faults are mended before
    return bool(effects) and bool(answer.shrinkage) and not shrinks


def counted(channels: Sequence[Shrinkage]) -> str:
    """How many channels have no gap, and how many of them owe it to calibration."""
    at_floor = sum(not open_gap(channel) for channel in channels)
    by_calibration = len(closed_by_calibration(channels))
    owed = f", {by_calibration} of them by calibration" if by_calibration else ""
    return f"{at_floor} of {len(channels)} channels are within 1.1 times their floor{owed}"


def figure(value: float) -> str:
    """Three significant digits."""
    if not math.isfinite(value):
        return "not known"
    if value == 0.0:
        return "0"
    if 1e-4 <= abs(value) < 1e5:
        return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"
    return f"{value:.2e}"


def with_std(value: float, std: float, units: str = "") -> str:
    """`0.0288600 ± 0.0000080 N*m`; without an uncertainty the value alone."""
    if not math.isfinite(std) or std <= 0.0:
        shown = f"{value:.4g}" if math.isfinite(value) else "not known"
    else:
        shown = f"{number(value, std)} ± {number(std, std)}"
    return f"{shown} {bare_units(units)}".rstrip()


def bare_units(units: str) -> str:
    """Units as they are written behind a number: none for a ratio."""
    return "" if units == "1" else units


def parameter_text(parameter: EffectParameter) -> str:
    """Value, uncertainty and units."""
    return with_std(parameter.value, parameter.std, parameter.units)


def change(parameter: CalibratedParameter) -> str:
    """What calibration changed, in percent; an offset from zero has none."""
    if parameter.not_told_by_these_runs:
        return "not told by these runs"
    if parameter.nominal == 0.0 or not math.isfinite(parameter.fitted):
        return ""
    return f"{100.0 * (parameter.fitted / parameter.nominal - 1.0):+.2f} %"


def closed_text(channel: Shrinkage) -> str:
    """Share closed with its interval, in percent."""
    if channel.closed is None:
        return "no gap"
    if channel.closed_low is None or channel.closed_high is None:
        return percent(channel.closed)
    low, high = (percent(share).removesuffix(" %") for share in (channel.closed_low, channel.closed_high))
    return f"{percent(channel.closed)} ({low} .. {high})"


def probability(value: float) -> str:
    """Two decimals, and never quite 0 or 1."""
    if not math.isfinite(value):
        return "not known"
    return "> 0.99" if value > 0.99 else "< 0.01" if value < 0.01 else f"{value:.2f}"


def percent(share: float) -> str:
    """A share of one; -0 is 0."""
    return f"{100.0 * share:.0f} %".replace("-0 %", "0 %") if math.isfinite(share) else "not known"


def floors(channel: Channel) -> str:
    """The calibrated gap as a multiple of the floor."""
    return f"{figure(channel.calibrated_rms / channel.floor_rms)} x" if channel.floor_rms > 0.0 else "no floor"


def region_text(region: Region | None, share: float) -> str:
    """Where most of a gap sits."""
    if region is None:
        return "no narrow region"
    if region.variable == "direction":
        word = "forward" if region.low >= 0.0 else "backward" if region.high <= 0.0 else "of both signs"
        return f"direction {word}, {percent(share)}"
    span = f"{figure(region.low)} to {figure(region.high)} {bare_units(region.units)}".rstrip()
    return f"{region.variable} {span}, {percent(share)}"


def variable_words(picture: Picture) -> str:
    """The variable of a picture; of an angle how many periods lie on each other."""
    if picture.periods is not None and picture.periods > 1.0:
        return f"angle within one of {picture.periods:.4g} periods of a turn"
    return VARIABLES[picture.variable].label if picture.variable in VARIABLES else picture.variable


def residual_words(picture: Picture) -> str:
    """What is drawn over it."""
    sign = f" x sign of {VARIABLES[picture.along].label}" if picture.along in VARIABLES else ""
    return f"{picture.quantity}, {picture.mechanical}: residual{sign}"


def picture_words(picture: Picture) -> str:
    """The numbers of a picture in one line."""
    units, bins = bare_units(picture.units), len(picture.bins)
    rms = f"{figure(picture.before_rms)} {units} before, {figure(picture.after_rms)} {units} after"
    off_zero = f"off zero in {picture.off_zero_before} bins before, in {picture.off_zero_after} after"
    return f"{rms} (RMS of {bins} means); {off_zero}"


def rest_channel(rest: Rest) -> str:
    """The channel that is looked at, and its equation."""
    return f"{rest.quantity}, {rest.mechanical} ({rest.equation})"


def rest_words(rest: Rest) -> str:
    """What a rest depends on, and how much of it a function of the state closes."""
    if rest.closable is None:
        return "held-out runs leave no gap beyond noise there"
    state, share = [VARIABLES[name].label for name in rest.depends_on if name != TIME], percent(rest.closable)
    repeats = None if rest.repeats_Hz is None else f"repeats in time, {rest.repeats_Hz:.4g} times a second"
    if state:
        changes = f"; what that leaves {repeats or 'changes slowly with time'}" if TIME in rest.depends_on else ""
        return f"it follows {listed(state)}: a free function closes {share} of the gap on held-out runs{changes}"
    closes = f"a free function of the logged state closes {share} of the gap on held-out runs"
    if repeats:
        return f"it {repeats}, whatever the state is; {closes}"
    if TIME in rest.depends_on:
        return f"it changes slowly with time, each stretch of a run like its neighbours; {closes}"
    return f"it follows nothing that is logged, nor changes slowly with time; {closes}"


def refusal_words(near: Near) -> str:
    """Why an effect that comes near is not named."""
    return f"{near.effect}, refused: {near.refused_because}"
