"""The score of a check on withheld causes as Markdown and as JSON."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from leactl.gap.blind.score import MOST_MEDIAN_DISTANCE, MOST_QUANTILE_90_DISTANCE, Calibration, Group, Score, Share

FORMAT, VERSION = "leactl-gap-score", 1
# targets of the figures that are not shares
MOST_MEAN_SET_SIZE = 1.5
MOST_CALIBRATION_ERROR, LEAST_BRIER_SKILL = 0.04, 0.8
HOW_TO_READ = """\
Each case is an emulated bench or a drawn machine. Its parameters differ from those of its nominal model, and it has no
effect, one, two, or one that the library lacks. Of each kind of run, the last is held out. All answers were written
before the key was opened; the key's SHA-256 is the one beside the runs. Intervals are Wilson's, at 95 %.

- *First cause right*: the first entry of `causes` is an effect that the case has. *Reported set*: that entry with its
  `indistinguishable_from`. *Named*: an effect with a probability of 0.5 or more; of two effects, one in the reported
  set is named as well. Two effects count as one where no record of a machine tells them apart, such as asymmetric
  friction and an offset of the current sensor in a joint without a voltage.
- *Called sound*: the verdict is `none` or `calibration`. *The held-out gap grew*: with the named effects, the squared
  distance to the held-out runs is larger than without them; it is summed over the channels in multiples of their
  floors.
- *Where*: two rankings of channels and set-ups count. *What the effects move* compares the true bench with and without
  its effects, replayed through the held-out runs. *What calibration leaves* compares the true bench with the nominal
  model after calibration alone. Differences are in multiples of the floor. The first entry of `where` is right if it
  is the first of the ranking or within a tenth of it. Cases in which no difference exceeds a floor are left out.
- *Oracle*: a fit that knows which effects act and fits their parameters and the calibration as the diagnosis does. The
  share of the gap that the diagnosis closes is compared with the oracle's, on the channel with the largest gap after
  calibration. Cases whose gap after calibration is within 1.1 floors are left out.
- *Within 2 standard errors*: every calibrated parameter of every case whose effects are all in the library, whatever
  the answer. Left out are `back_emf_constant`, because it equals the torque constant, `ambient_offset`, because no
  emulated bench has one, and the shaft's stiffness where `shaft_compliance` replaces it. The parameters of one case
  depend on each other, so that the true interval is wider. A drawn machine logs neither torque nor voltage: its runs
  tell parameters only as ratios to the torque constant, and these ratios are compared.
"""


def score_json(score: Score, command: str) -> dict[str, Any]:
    """Return the score as a JSON document."""
    return {
        "format": FORMAT,
        "format_version": VERSION,
        "command": command,
        "cases": score.cases,
        "shares": [share_json(share) for share in score.shares],
        "mean_set_size": score.set_size,
        "calibration": asdict(score.calibration),
        "calibration_of_named": asdict(score.calibration_of_named),
        "behind_oracle": None
        if score.behind_oracle is None
        else dict(zip(("median", "quantile_90"), score.behind_oracle, strict=True)),
        "parameters": [share_json(share) for share in score.parameters],
        "misses": [asdict(miss) for miss in score.misses],
        "groups": [asdict(group) | {"shares": [share_json(share) for share in group.shares]} for group in score.groups],
    }


def share_json(share: Share) -> dict[str, Any]:
    """Return the fields, the value and the 95 % interval of a share; both ends are None without an interval."""
    low, high = share.interval or (None, None)
    return {**asdict(share), "share": share.share, "low": low, "high": high}


def markdown(score: Score, command: str) -> str:
    """Return the score as a page of Markdown, with the command that made it below the heading."""
    lines = ["# The check on withheld causes", "", "```", command, "```", "", f"{score.cases} cases.", "", HOW_TO_READ]
    lines += ["| question | target | result | count | 95 % interval |", "|---|---|---|---|---|"]
    lines += [share_row(share) for share in score.shares]
    if score.set_size is not None:
        set_size_target = f"<= {MOST_MEAN_SET_SIZE:g}"
        lines.append(f"| one effect: mean size of the reported set | {set_size_target} | {score.set_size:.2f} | | |")
    if score.behind_oracle is not None:
        median, quantile_90 = score.behind_oracle
        distances_text = f"{MOST_MEDIAN_DISTANCE:g} / {MOST_QUANTILE_90_DISTANCE:g} | {median:.3f} / {quantile_90:.3f}"
        lines.append(f"| distance from the oracle: median / 90 % | {distances_text} | | |")
    for title, calibration in (("all cases", score.calibration), ("cases with a cause", score.calibration_of_named)):
        skill_text = "-" if calibration.skill is None else f"{calibration.skill:.3f}"
        figures_text = f"{MOST_CALIBRATION_ERROR:g} / {LEAST_BRIER_SKILL:g} | {calibration.error:.3f} / {skill_text}"
        lines.append(f"| probabilities, {title}: calibration error / Brier skill | {figures_text} | | |")
    lines += ["", "## Probability of the first cause", ""]
    lines += ["An answer without a cause counts with probability 0: nothing that it names acts.", ""]
    lines += reliability_table(score.calibration)
    lines += ["", "## Calibrated parameters within 2 standard errors", ""]
    lines += ["| parameter | target | result | count | 95 % interval |", "|---|---|---|---|---|"]
    lines += [share_row(share) for share in score.parameters]
    for dimension in dict.fromkeys(group.by for group in score.groups):
        lines += [
            "",
            f"## By {dimension}",
            "",
            *group_table([group for group in score.groups if group.by == dimension]),
        ]
    lines += ["", "## Every miss", "", "| case | question | acts | answer |", "|---|---|---|---|"]
    lines += [f"| {miss.case} | {miss.question} | {miss.truth} | {miss.answer} |" for miss in score.misses]
    return "\n".join(lines) + "\n"


def group_table(groups: Sequence[Group]) -> list[str]:
    """Return the lines of a Markdown table with a row for each group and a column for each question."""
    lines = [f"| {groups[0].by} | cases | {' | '.join(share.question for share in groups[0].shares)} |"]
    lines.append("|---" * (2 + len(groups[0].shares)) + "|")
    for group in groups:
        cells = [f"{share.count} of {share.total}" if share.total else "-" for share in group.shares]
        lines.append(f"| {group.name} | {group.cases} | {' | '.join(cells)} |")
    return lines


def share_row(share: Share) -> str:
    """Return a share as one row of a Markdown table; a share of no cases has no value."""
    if share.share is None or share.interval is None:
        return f"| {share.question} | {share.target} | - | 0 of 0 | |"
    low, high = share.interval
    figures_text = f"{share.share:.1%} | {share.count} of {share.total} | {low:.1%} to {high:.1%}"
    return f"| {share.question} | {share.target} | {figures_text} |"


def reliability_table(calibration: Calibration) -> list[str]:
    """Return the lines of a Markdown table that compares stated probabilities with the fraction that was right."""
    lines = ["| stated | cases | mean stated | right |", "|---|---|---|---|"]
    lines += [
        f"| {row.low:.1f} to {row.high:.1f} | {row.count} | {row.probability:.3f} | {row.right:.3f} |"
        for row in calibration.bins
    ]
    lines.append("")
    lines.append(f"{calibration.count} cases, {calibration.base_rate:.1%} of them with a first cause that acts.")
    return lines
