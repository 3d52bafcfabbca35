"""Mark one answer against the truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from leactl.gap.blind.truth import Truth
from leactl.gap.diagnosis import LEAST_GAP_FLOORS
from leactl.gap.verdict.decision import NAMED_PROBABILITY
from leactl.gap.verdict.withdrawal import MOST_EQUAL_RATIO

LEAST_MOVED_FLOORS = 1.0  # floors; a smaller gap is hidden in noise
EQUAL_MOVE_SHARE = 0.9  # share of the largest move from which a move is as large: two actuators measure one shaft
DUPLICATE_PARAMETER = "back_emf_constant"  # equals the torque constant in power-invariant units
REPLACED_PARAMETERS = {"shaft_compliance": "bench.shaft_stiffness"}  # parameter of the model that an effect replaces
PARAMETER_WITHOUT_TRUTH = "ambient_offset"  # the plant has no true value of it
Document = Mapping[str, Any]


@dataclass(frozen=True)
class Departure:
    """A calibrated parameter against its true value."""

    parameter: str
    stds: float  # fitted minus true, in standard errors


@dataclass(frozen=True)
class Mark:
    """Marks of one case."""

    name: str
    truth: Truth
    verdict: str
    causes: tuple[tuple[str, float], ...]  # effect and probability, as in the answer
    reported: tuple[str, ...]  # first cause, and the causes that it cannot be told from
    moved_right: bool | None  # whether `where` begins with the channel that the effects move most; None if none moves
    left_right: bool | None  # whether it begins with the channel of the largest gap after recalibration
    closed: float | None  # share of that channel's gap that the answer closes
    oracle_closed: float | None  # share that a diagnosis closes which knows the effects
    departures: tuple[Departure, ...]
    effect_closes: bool | None = None  # whether the effects narrow the held-out gap; None if no cause is named
    calibration_closes: bool | None = None  # whether recalibration does so alone; None if nothing is recalibrated

    @property
    def first(self) -> str | None:
        """Effect of the first cause; None if the answer has no cause."""
        return self.causes[0][0] if self.causes else None

    @property
    def first_probability(self) -> float:
        """Probability of the first cause; zero if the answer has no cause."""
        return self.causes[0][1] if self.causes else 0.0

    @property
    def first_right(self) -> bool:
        """Whether the first cause acts, or no record can tell it from an effect that acts."""
        return self.first in self.truth.guises

    @property
    def in_set(self) -> bool:
        """Whether the reported set has an effect that acts, or that no record can tell from one."""
        return any(name in self.truth.guises for name in self.reported)

    @property
    def all_named(self) -> bool:
        """Whether every effect that acts, or one like it, is named at even odds or better or in the reported set."""
        named = {*self.named, *self.reported}
        return all({name, *self.truth.alike.get(name, ())} & named for name in self.truth.effects)

    @property
    def named(self) -> tuple[str, ...]:
        """Causes at even odds or better."""
        return tuple(name for name, probability in self.causes if probability >= NAMED_PROBABILITY)

    @property
    def names_what_is_not_there(self) -> bool:
        """Whether a cause is named, first or further, that neither acts nor is like an effect that acts."""
        return not set(self.named) <= self.truth.guises

    @property
    def names_a_cause(self) -> bool:
        """Whether any cause is named at even odds or better."""
        return bool(self.named)

    @property
    def sound(self) -> bool:
        """Whether the answer says that nothing acts."""
        return self.verdict in ("none", "calibration") and not self.named

    @property
    def says_unknown(self) -> bool:
        """Whether the answer says that something acts, and names no cause."""
        return self.verdict == "unknown" and not self.names_a_cause


def mark(name: str, truth: Truth, answer: Document, measured: Document) -> Mark:
    """Compare one answer with the truth and with the measurements made with the key."""
    causes = tuple((cause["effect"], float(cause["probability"])) for cause in answer["causes"])
    first_cause: Sequence[Document] = answer["causes"][:1]
    reported = tuple(effect for cause in first_cause for effect in (cause["effect"], *cause["indistinguishable_from"]))
    closed = oracle_closed = None
    moved_channels, gap_channels = (
        most_moved_channels(measured["moved"], quantity) for quantity in ("by_effects", "after_calibration")
    )
    if gap_channels:
        closed, oracle_closed = shares_closed(gap_channels[0], answer["shrinkage"], measured["oracle"])
    first_channel = channel_key(answer["where"][0]) if answer["where"] else None
    verdict = answer["verdict"]
    moved_right, left_right = (
        first_channel in channels if channels else None for channels in (moved_channels, gap_channels)
    )
    departures = tuple(departures_of(truth, answer["calibration"]))
    shrinkage_lines = answer["shrinkage"]
    names_a_cause = any(probability >= NAMED_PROBABILITY for _, probability in causes)
    return Mark(
        name,
        truth,
        verdict,
        causes,
        reported,
        moved_right,
        left_right,
        closed,
        oracle_closed,
        departures,
        narrows(shrinkage_lines, "calibrated_rms", "augmented_rms") if names_a_cause else None,
        narrows(shrinkage_lines, "nominal_rms", "calibrated_rms") if answer["calibration"] else None,
    )


def narrows(shrinkage_lines: Sequence[Document], rms_before: str, rms_after: str) -> bool | None:
    """Return whether a model is as near to the held-out runs as another or nearer; None if no channel is replayed.

    Distances of all channels are added in multiples of their floors.

    rms_before, rms_after : keys of the two models' distances in a line.
    """
    replayed_lines = [
        line for line in shrinkage_lines if line["floor_rms"] and None not in (line[rms_before], line[rms_after])
    ]
    if not replayed_lines:
        return None
    squares_before, squares_after = (
        sum((line[rms_key] / line["floor_rms"]) ** 2 for line in replayed_lines) for rms_key in (rms_before, rms_after)
    )
    return bool(squares_after <= MOST_EQUAL_RATIO * squares_before)


def most_moved_channels(lines: Sequence[Document], distance: str) -> list[tuple[str, str, str]]:
    """Return the channels with the largest distance and those nearly as large; none if all are below their floor."""
    ranked = sorted(lines, key=lambda line: -float(line[distance]))
    largest = float(ranked[0][distance]) if ranked else 0.0
    return [
        channel_key(line) for line in ranked if line[distance] >= max(LEAST_MOVED_FLOORS, EQUAL_MOVE_SHARE * largest)
    ]


def channel_key(line: Document) -> tuple[str, str, str]:
    """Return the channel and set-up of a line."""
    return line["quantity"], line["role"], line["mechanical"]


def shares_closed(
    channel: tuple[str, str, str], answer_lines: Sequence[Document], oracle_lines: Sequence[Document]
) -> tuple[float | None, float | None]:
    """Return the shares of a channel's gap that an answer and the oracle close, by the oracle's gap and floor."""
    answer_line = next((line for line in answer_lines if channel_key(line) == channel), None)
    oracle_line = next((line for line in oracle_lines if channel_key(line) == channel), None)
    if (
        answer_line is None
        or oracle_line is None
        or oracle_line["calibrated_rms"] <= LEAST_GAP_FLOORS * oracle_line["floor_rms"]
    ):
        return None, None
    gap = oracle_line["calibrated_rms"] - oracle_line["floor_rms"]
    answer_share, oracle_share = [
        (oracle_line["calibrated_rms"] - line["augmented_rms"]) / gap for line in (answer_line, oracle_line)
    ]
    return answer_share, oracle_share


def departures_of(truth: Truth, calibration: Sequence[Document]) -> list[Departure]:
    """Return the departures of fitted parameters from the true ones, where the truth is one number."""
    excluded = {REPLACED_PARAMETERS[name] for name in truth.effects if name in REPLACED_PARAMETERS} | {
        DUPLICATE_PARAMETER,
        PARAMETER_WITHOUT_TRUTH,
    }
    fitted = {line["parameter"]: line["fitted"] for line in calibration}
    reference, true_reference = 1.0, 1.0
    if truth.ratios_to is not None:
        if truth.ratios_to not in fitted:
            return []
        excluded |= {truth.ratios_to}
        reference, true_reference = fitted[truth.ratios_to], truth.base[truth.ratios_to]
    return [
        Departure(name, (line["fitted"] / reference - truth.base[name] / true_reference) / (line["std"] / reference))
        for line in calibration
        if (name := line["parameter"]) not in excluded and name in truth.base and line["std"]
    ]
