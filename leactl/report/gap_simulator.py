"""Sentences and tables on a simulator that takes the place of the model: its parameters, effects and floors.

The terminal and the page share them.
"""

from collections import Counter
from collections.abc import Sequence

from leactl.gap.diagnosis import Presence, SimulatorAnswer
from leactl.report.gap_words import bare_units, channel_label, enumerated, three_digits, with_std

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


def simulator_sentences(simulator: SimulatorAnswer, real_effects: Sequence[str]) -> list[str]:
    """Return sentences on the effects of the simulator, and on how those of the real runs differ.

    Parameters
    ----------
    real_effects : effects that were named for the real runs.
    """
    pairing_counts = Counter(pair.paired_by for pair in simulator.runs)
    pairings = enumerated([f"{count} {PAIRED[criterion]}" for criterion, count in pairing_counts.items()])
    simulator_effects = [effect.effect for effect in simulator.effects]
    sentences = [
        f"The nominal is a simulator: its runs have the inputs of the real ones (paired: {pairings}).",
        f"It contains {enumerated(simulator_effects)}."
        if simulator_effects
        else "It contains no effect beyond the model's plain form.",
    ]
    if simulator.verdict == "unknown":
        sentences.append("It does something that no effect of the library explains, which counts as its floor.")
    new_effects = [name for name in real_effects if name not in simulator_effects]
    resized_effects = [f"{name} of another size" for name in real_effects if name in simulator_effects]
    absent_effects = [effect.effect for effect in simulator.effects if effect.in_real == "absent"]
    differing_parameters = [parameter.parameter for parameter in simulator.parameters if parameter.differs]
    sentences.append(f"The real runs have {enumerated([*new_effects, *resized_effects]) or 'no effect'} beyond it.")
    if absent_effects:
        sentences.append(f"The real runs lack {enumerated(absent_effects)} of it.")
    if differing_parameters:
        sentences.append(f"Parameters differ beyond both uncertainties: {enumerated(differing_parameters)}.")
    return sentences


def simulator_tables(simulator: SimulatorAnswer) -> list[tuple[tuple[str, ...], list[list[str]]]]:
    """Return headings and rows of the tables of parameters, effects and floors; a table without rows is left out."""
    tables = (
        (PARAMETERS, parameter_rows(simulator)),
        (EFFECTS, effect_rows(simulator)),
        (FLOORS, floor_rows(simulator)),
    )
    return [(headings, rows) for headings, rows in tables if rows]


def parameter_rows(simulator: SimulatorAnswer) -> list[list[str]]:
    """Return the cells under `PARAMETERS`, a row for each parameter."""
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
    """Return the cells under `EFFECTS`, a row for each parameter of an effect."""
    rows = []
    for effect in simulator.effects:
        presence = IN_REAL[effect.in_real]
        for parameter in effect.parameters:
            real_text = (
                "" if parameter.real is None else with_std(parameter.real, parameter.real_std or 0.0, parameter.units)
            )
            rows.append(
                [
                    f"{effect.effect} {parameter.name}",
                    with_std(parameter.simulated, parameter.simulated_std, parameter.units),
                    real_text,
                    presence,
                ]
            )
        rows += [] if effect.parameters else [[effect.effect, "", "", presence]]
    return rows


def floor_rows(simulator: SimulatorAnswer) -> list[list[str]]:
    """Return the cells under `FLOORS`, a row for each channel."""
    return [
        [
            channel_label(channel, simulator.floors),
            three_digits(channel.left_rms),
            three_digits(channel.floor_rms),
            bare_units(channel.units),
        ]
        for channel in simulator.floors
    ]
