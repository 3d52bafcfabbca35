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
    pairings = listed([f"{count} {PAIRED[way]}" for way, count in ways.items()])
    contains = [effect.effect for effect in simulator.effects]
    sentences = [
        f"The nominal is a simulator: its runs have the inputs of the real ones (paired: {pairings}).",
        f"It contains {listed(contains)}." if contains else "It contains no effect beyond the model's plain form.",
    ]
    if simulator.verdict == "unknown":
        sentences.append("It does something that no effect of the library explains, which counts as its floor.")
    new_effects = [name for name in beyond if name not in contains]
    resized = [f"{name} of another size" for name in beyond if name in contains]
    lacking = [effect.effect for effect in simulator.effects if effect.in_real == "absent"]
    differing = [parameter.parameter for parameter in simulator.parameters if parameter.differs]
    sentences.append(f"The real runs have {listed([*new_effects, *resized]) or 'no effect'} beyond it.")
    if lacking:
        sentences.append(f"The real runs lack {listed(lacking)} of it.")
    if differing:
        sentences.append(f"Parameters differ beyond both uncertainties: {listed(differing)}.")
    return sentences


def tables(simulator: SimulatorAnswer) -> list[tuple[tuple[str, ...], list[list[str]]]]:
    """Return headings and rows of the tables of parameters, effects and floors, without those that have no row."""
    pairs = (
        (PARAMETERS, parameter_rows(simulator)),
        (EFFECTS, effect_rows(simulator)),
        (FLOORS, floor_rows(simulator)),
    )
    return [(headings, rows) for headings, rows in pairs if rows]


def parameter_rows(simulator: SimulatorAnswer) -> list[list[str]]:
    """Cells under `PARAMETERS`."""
    return [
        [
            f"{parameter.parameter}{' (differs)' if parameter.differs else ''}",
            f"{parameter.start:.6g}",
            with_std(parameter.simulated, parameter.simulated_std),
            "" if parameter.real is None else with_std(parameter.real, parameter.real_std or 0.0),
            bare_units(parameter.units),
        ]
        for parameter in simulator.parameters
    ]


def effect_rows(simulator: SimulatorAnswer) -> list[list[str]]:
    """Cells under `EFFECTS`, a row for each parameter of an effect."""
    rows = []
    for effect in simulator.effects:
        presence = IN_REAL[effect.in_real]
        for parameter in effect.parameters:
            real = (
                "" if parameter.real is None else with_std(parameter.real, parameter.real_std or 0.0, parameter.units)
            )
            rows.append(
                [
                    f"{effect.effect} {parameter.name}",
                    with_std(parameter.simulated, parameter.simulated_std, parameter.units),
                    real,
                    presence,
                ]
            )
        rows += [] if effect.parameters else [[effect.effect, "", "", presence]]
    return rows


def floor_rows(simulator: SimulatorAnswer) -> list[list[str]]:
    """Cells under `FLOORS`."""
    return [
        [
            label(channel, simulator.floors),
            figure(channel.left_rms),
            figure(channel.floor_rms),
            bare_units(channel.units),
        ]
        for channel in simulator.floors
    ]
