"""Comparisons of conditions as text that fits 80 columns."""

from collections.abc import Sequence

from leactl.analysis.anova.comparison import Comparison, in_words
from leactl.analysis.estimate import listed
from leactl.report.terminal import aligned, number, wrapped

WIDTH = 80


def comparisons_text(experiment: str, found: Sequence[Comparison], refused: Sequence[str]) -> str:
    """One part a result: the sentence first, then means, pairs, assumptions and notes."""
    parts = [f"{experiment}: {len(found)} results over conditions"]
    parts += [_one(each) for each in found]
    parts += [wrapped("not compared:", [line], WIDTH) for line in by_reason(refused)]
    return "\n\n".join(parts)


def _one(found: Comparison) -> str:
    groups = [
        (f"  {one.condition}", f"{one.count}", number(one.mean, one.std), number(one.std, one.std))
        for one in found.groups
    ]
    pairs = [
        (
            f"  {pair.second} - {pair.first}",
            number(pair.difference, pair.std),
            f"{number(pair.low, pair.std)} .. {number(pair.high, pair.std)}",
            f"{pair.p:.2g}",
        )
        for pair in found.pairs
    ]
    lines = [
        f"{found.name} [{found.units}]",
        wrapped(" ", [found.sentence], WIDTH),
        aligned(("  condition", "values", "mean", "std"), groups),
        aligned(("  Tukey", "difference", "95 % interval, all at once", "p"), pairs),
    ]
    if found.anova.actuator is not None and found.anova.actuator_std is not None:
        lines.append(f"  actuators: {in_words(found.anova.actuator)}, std between them {found.anova.actuator_std:.2g}")
    told = [f"{one.name} {'not checked' if one.p is None else f'p = {one.p:.2g}'}" for one in found.checks]
    lines.append(wrapped("  assumptions:", told, WIDTH))
    return "\n".join([*lines, *(wrapped("  note:", [note], WIDTH) for note in found.notes)])


def by_reason(refused: Sequence[str]) -> list[str]:
    """Lines `result: reason` with the results that share a reason in one."""
    reasons: dict[str, list[str]] = {}
    for line in refused:
        name, _, reason = line.partition(": ")
        reasons.setdefault(reason, []).append(name)
    return [f"{listed(names)}: {reason}" for reason, names in reasons.items()]
