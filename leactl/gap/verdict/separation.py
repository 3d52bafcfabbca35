"""Effects that the equations cannot tell apart, and which of them held-out runs rule out when simulated again."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from leactl.gap.diagnosis import MOST_REPLAY_MISS
from leactl.gap.search.effect_sets import TIE_SHARE, FurtherEffect
from leactl.gap.search.regression import Candidate
from leactl.gap.verdict.judge import Judged
from leactl.gap.verdict.shrinkage import SquaresRatio

RULED_OUT_RATIO = 1.1  # ratio of squared gaps that rules out the farther effect; the worst wrong preference had 1.05
Compare = Callable[[Sequence[Candidate], Sequence[Candidate]], SquaresRatio]
"""Squared gap of held-out runs with the second set of effects over that with the first."""


class RuledOut(NamedTuple):
    """An effect that held-out runs rule out in favour of another effect of its class."""

    effect: str
    by: str  # effect that fits better, of the same class
    times: float  # squared gap with the ruled-out effect, over that with the better one

    def note(self) -> str:
        """Return the note on the effect that is ruled out."""
        return (
            f"{self.effect} is ruled out beside {self.by}: simulated again with it, the squared gap of held-out runs is"
            f" {self.times:.3g} times as large"
        )


def nearest_of_classes(
    hypothesis: Sequence[Candidate], judgements: Sequence[Judged], compare: Compare
) -> tuple[list[Candidate], list[RuledOut]]:
    """Return the set with the effect of each class that fits held-out runs best in replays, and the effects ruled out.

    Equations judge each instant separately and leave out rows that they cannot resolve; a replay has to follow the
    whole course. Neither of two effects is ruled out where the difference is unclear, where even the better replay
    misses a channel by more than `MOST_REPLAY_MISS` floors, since another error there may favour either effect, or
    where both are one law in every row.
    """
    nearest_set, ruled_out = list(hypothesis), list[RuledOut]()
    for judgement in judgements:
        member = judgement.finding
        for rival, _ in judgement.rivals:
            if rival.effect not in judgement.peers or rival.effect in {effect for effect, _ in nearest_set}:
                continue
            if is_one_law(member, rival):
                continue
            with_rival = [rival.candidate if candidate == member.candidate else candidate for candidate in nearest_set]
            squared_ratio = compare(nearest_set, with_rival)
            if squared_ratio.worst_miss > MOST_REPLAY_MISS:
                continue
            if squared_ratio.low > 1.0 and squared_ratio.value > RULED_OUT_RATIO:
                ruled_out.append(RuledOut(rival.effect, member.effect, squared_ratio.value))
            elif squared_ratio.high < 1.0 and squared_ratio.value < 1.0 / RULED_OUT_RATIO:
                ruled_out.append(RuledOut(member.effect, rival.effect, 1.0 / squared_ratio.value))
                nearest_set, member = with_rival, rival
    return nearest_set, ruled_out


def is_one_law(first: FurtherEffect, second: FurtherEffect) -> bool:
    """Return whether two effects explain the same in every row of the equations, to within rounding.

    Their replays differ only where a shaft stands or begins to move, as a friction by direction and an offset of the
    current do. What the simulation makes of friction there would decide, and not the effect.
    """
    # an unusual effect has lost `TIE_SHARE` of its gain
    return abs(first.gain - second.gain) <= 2.0 * TIE_SHARE * max(first.gain, second.gain)


def without_ruled_out(judgement: Judged, ruled_out: Sequence[RuledOut]) -> Judged:
    """Return the judgement of a member without the effects ruled out in its class: rivals with probability 0."""
    effects_of_class = {judgement.finding.effect, *judgement.peers}
    ruled_out_names = {effect.effect for effect in ruled_out if effect.by in effects_of_class}
    rivals = tuple(
        (rival, 0.0 if rival.effect in ruled_out_names else probability) for rival, probability in judgement.rivals
    )
    return replace(
        judgement, rivals=rivals, peers=tuple(name for name in judgement.peers if name not in ruled_out_names)
    )
