"""Comparisons of conditions as text that fits 80 columns."""

from collections.abc import Sequence

from leactl.analysis.anova.comparison import Comparison, in_words
from leactl.analysis.estimate import listed
from leactl.report.terminal import aligned, number, wrapped

WIDTH = 80


def comparisons_text(experiment: str, comparisons: Sequence[Comparison], refused: Sequence[str]) -> str:
    """One part a result: the sentence first, then means, pairs, assumptions and notes."""
    parts = [f"{experiment}: {len(comparisons)} results over conditions"]
    parts += [comparison_text(comparison) for comparison in comparisons]
    parts += [wrapped("not compared:", [line], WIDTH) for line in by_reason(refused)]
    return "\n\n".join(parts)


def comparison_text(comparison: Comparison) -> str:
    """Return one comparison: its sentence, the groups' means, Tukey's pairs, the checks of assumptions, notes."""
    groups = [
        (f"  {one.condition}", f"{one.count}", number(one.mean, one.std), number(one.std, one.std))
        for one in comparison.groups
    ]
    pairs = [
        (
            f"  {pair.second} - {pair.first}",
            number(pair.difference, pair.std),
            f"{number(pair.low, pair.std)} .. {number(pair.high, pair.std)}",
            f"{pair.p:.2g}",
        )
        for pair in comparison.pairs
    ]
    lines = [
        f"{comparison.name} [{comparison.units}]",
        wrapped(" ", [comparison.sentence], WIDTH),
        aligned(("  condition", "values", "mean", "std"), groups),
        aligned(("  Tukey", "difference", "95 % interval, all at once", "p"), pairs),
    ]
    if comparison.anova.actuator is not None and comparison.anova.actuator_std is not None:
        lines.append(
            f"  actuators: {in_words(comparison.anova.actuator)}, std between them {comparison.anova.actuator_std:.2g}"
        )
    checks = [f"{one.name} {'not checked' if one.p is None else f'p = {one.p:.2g}'}" for one in comparison.checks]
    lines.append(wrapped("  assumptions:", checks, WIDTH))
    return "\n".join([*lines, *(wrapped("  note:", [note], WIDTH) for note in comparison.notes)])


def by_reason(lines: Sequence[str]) -> list[str]:
    """Lines `result: reason` with the results that share a reason in one."""
    reasons: dict[str, list[str]] = {}
    for line in lines:
        name, _, reason = line.partition(": ")
        reasons.setdefault(reason, []).append(name)
    return [f"{listed(names)}: {reason}" for reason, names in reasons.items()]
