"""Comparisons of conditions as text that fits 80 columns."""

from collections.abc import Sequence

from leactl.analysis.anova.comparison import Comparison, in_words
from leactl.analysis.estimate import listed
from leactl.report.terminal import TEXT_WIDTH, aligned, number, wrapped


def comparisons_text(experiment: str, comparisons: Sequence[Comparison], refused: Sequence[str]) -> str:
    """Return a part for each compared result, and a part for each reason why results were not compared."""
    parts = [f"{experiment}: {len(comparisons)} results over conditions"]
    parts += [comparison_text(comparison) for comparison in comparisons]
    parts += [wrapped("not compared:", [line], TEXT_WIDTH) for line in merged_by_reason(refused)]
    return "\n\n".join(parts)


def comparison_text(comparison: Comparison) -> str:
    """Return one comparison: its sentence, the groups' means, Tukey's pairs, the checks of assumptions, notes."""
    groups = [
        (f"  {group.condition}", f"{group.count}", number(group.mean, group.std), number(group.std, group.std))
        for group in comparison.groups
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
        wrapped(" ", [comparison.sentence], TEXT_WIDTH),
        aligned(("  condition", "values", "mean", "std"), groups),
        aligned(("  Tukey", "difference", "95 % interval, all at once", "p"), pairs),
    ]
    if comparison.anova.actuator is not None and comparison.anova.actuator_std is not None:
        lines.append(
            f"  actuators: {in_words(comparison.anova.actuator)}, std between them {comparison.anova.actuator_std:.2g}"
        )
    checks = [
        f"{check.name} {'not checked' if check.p is None else f'p = {check.p:.2g}'}" for check in comparison.checks
    ]
    lines.append(wrapped("  assumptions:", checks, TEXT_WIDTH))
    return "\n".join([*lines, *(wrapped("  note:", [note], TEXT_WIDTH) for note in comparison.notes)])


def merged_by_reason(lines: Sequence[str]) -> list[str]:
    """Merge lines `result: reason` that share a reason into one line that lists their results."""
    names_by_reason: dict[str, list[str]] = {}
    for line in lines:
        name, _, reason = line.partition(": ")
        names_by_reason.setdefault(reason, []).append(name)
    return [f"{listed(names)}: {reason}" for reason, names in names_by_reason.items()]
