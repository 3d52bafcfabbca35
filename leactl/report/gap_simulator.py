"""A simulator that stands for the model, in words and rows: what it contains, what floor it has, what real runs share.

The terminal and the page show the same.
"""

from collections import Counter
from collections.abc import Sequence

from leactl.gap.diagnosis import Presence, SimulatorAnswer
from leactl.report.gap_words import bare_units, figure, label, listed, with_std

PARAMETERS = ("parameter", "start", "simulator ± std", "real ± std", "")
EFFECTS = ("simulator contains", "simulator ± std", "real ± std", "real runs")
FLOORS = ("simulator leaves (RMS)", "left", "floor", "")
IN_REAL: dict[Presence, str] = {
    "alike": "alike",
    "differs": "differ",
    "absent": "lack it",
    "not asked": "not asked",
}
PAIRED = {
    "name": "by name",
    "experiment": "by experiment and condition",
    "inputs": "by their inputs",
    "order": "by order",
}


def summary(simulator: SimulatorAnswer, beyond: Sequence[str]) -> list[str]:
    """What the simulator contains and what the real runs have beyond it, a sentence each.

    beyond : effects that were named for the real runs.
    """
    ways = Counter(pair.paired_by for pair in simulator.runs)
    told = listed([f"{count} {PAIRED[way]}" for way, count in ways.items()])
    contains = [effect.effect for effect in simulator.effects]
    said = [
        f"The nominal is a simulator: its runs have the inputs of the real ones (paired: {told}).",
        f"It contains {listed(contains)}." if contains else "It contains no effect beyond the model's plain form.",
    ]
    if simulator.verdict == "unknown":
        said.append("It does something that no effect of the library explains, which counts as its floor.")
    fresh = [name for name in beyond if name not in contains]
    more = [f"{name} of another size" for name in beyond if name in contains]
    less = [effect.effect for effect in simulator.effects if effect.in_real == "absent"]
    differ = [item.parameter for item in simulator.parameters if item.differs]
    said.append(f"The real runs have {listed([*fresh, *more]) or 'no effect'} beyond it.")
    if less:
        said.append(f"The real runs lack {listed(less)} of it.")
    if differ:
        said.append(f"Parameters differ beyond both uncertainties: {listed(differ)}.")
    return said


def parameter_rows(simulator: SimulatorAnswer) -> list[list[str]]:
    """Cells under `PARAMETERS`."""
    return [
        [
            f"{item.parameter}{' (differs)' if item.differs else ''}",
            f"{item.start:.6g}",
            with_std(item.simulated, item.simulated_std),
            "" if item.real is None else with_std(item.real, item.real_std or 0.0),
            bare_units(item.units),
        ]
        for item in simulator.parameters
    ]


def effect_rows(simulator: SimulatorAnswer) -> list[list[str]]:
    """Cells under `EFFECTS`, a row for each parameter of an effect."""
    rows = []
    for effect in simulator.effects:
        how = IN_REAL[effect.in_real]
        for item in effect.parameters:
            real = "" if item.real is None else with_std(item.real, item.real_std or 0.0, item.units)
            rows.append(
                [f"{effect.effect} {item.name}", with_std(item.simulated, item.simulated_std, item.units), real, how]
            )
        rows += [] if effect.parameters else [[effect.effect, "", "", how]]
    return rows


def floor_rows(simulator: SimulatorAnswer) -> list[list[str]]:
    """Cells under `FLOORS`."""
    return [
        [label(item, simulator.floors), figure(item.left_rms), figure(item.floor_rms), bare_units(item.units)]
        for item in simulator.floors
    ]
