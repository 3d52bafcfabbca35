"""Outputs of `leactl gap effects`, `gap plan` and `gap loop`: effects, what runs can show, a closed loop."""

import textwrap
from typing import TYPE_CHECKING, Any

from leactl.gap.effect_sheet import effect_sheet
from leactl.report.gap_words import enumerated
from leactl.report.terminal import aligned, list_line
from leactl.vocabulary.effect import effect_definition, effect_names
from leactl.vocabulary.setup_fault import setup_faults

if TYPE_CHECKING:
    from leactl.exchange.loop import ClosedLoop, PlayedRun
    from leactl.gap.planning.advice import Advice, AdvisedProtocol
    from leactl.gap.planning.visible_sizes import Sight

ADVICE_FORMAT, ADVICE_VERSION = "leactl-gap-plan", 1
LOOP_HEADINGS = ["held out, rms of the angle [rad]", "as it was", "patched", "with callbacks", "closed"]


def all_effects_text() -> str:
    """Return a line for each effect with its meaning, then a line for each fault of a set-up."""
    effects = {name: effect_definition(name).meaning for name in effect_names()}
    faults = {name: fault.meaning for name, fault in setup_faults().items()}
    width = max(map(len, (*effects, *faults)))
    effect_lines, fault_lines = (
        [list_line(f"{name:<{width}}  ", meaning) for name, meaning in meanings.items()]
        for meanings in (effects, faults)
    )
    return "\n".join([*effect_lines, "", "faults of the set-up, looked for first", *fault_lines])


def effect_text(name: str) -> str:
    """Return meaning, equation and parameters of one effect, the channels that show it, and effects confused with it.

    Raises
    ------
    InputError : no effect has this name.
    """
    sheet = effect_sheet(name)
    keys = ("equation", "acts_over", "shown_on", "shows_in", "confused_with", "shown_by")
    texts = sheet | {key: " or ".join(sheet[key]) for key in ("acts_over", "shown_on") if key in sheet}
    rows = [(key.replace("_", " "), texts[key]) for key in keys if key in texts]
    for parameter in sheet.get("parameters", ()):
        default = f", by default {parameter['default']:g}" if parameter.get("default") is not None else ""
        units = "" if parameter["units"] == "1" else f" {parameter['units']}"
        limits = f"[{parameter['low']:g} to {parameter['high']:g}{units}{default}]"
        rows.append((parameter["name"], f"{parameter['meaning']} {limits}"))
    width = max(len(title) for title, _ in rows)
    lines = [list_line(f"  {title:<{width}}  ", text) for title, text in rows]
    return "\n".join([list_line(f"{name}: ", sheet["meaning"]), *lines])


def advice_json(advice: "Advice") -> dict[str, Any]:
    """Return the effects that runs or protocols can show, as the JSON document of `gap plan`."""
    effects = [
        {
            "effect": sight.effect,
            "found_from": sight.smallest,
            "worth_knowing": sight.faint,
            "units": sight.units,
            "shown": sight.seen,
            "indistinguishable_from": list(sight.alike),
        }
        for sight in advice.sights
    ]
    experiments = [
        {
            "protocol": experiment.protocol,
            "duration_s": experiment.duration_s,
            "shows": list(experiment.shows),
            "separates": [list(pair) for pair in experiment.separates],
            "gain_per_s": experiment.gain,
        }
        for experiment in advice.experiments
    ]
    return {
        "format": ADVICE_FORMAT,
        "format_version": ADVICE_VERSION,
        "effects": effects,
        "experiments": experiments,
        "not_shown": list(advice.dark),
        "notes": list(advice.notes),
    }


def advice_lines(advice: "Advice") -> list[str]:
    """Return the lines of `gap plan`: effects, further experiments, effects that nothing shows, notes."""
    width = max(len(sight.effect) for sight in advice.sights)
    lines = [f"{'effect':<{width}}  found from  worth knowing"]
    lines += [sight_line(sight, width) for sight in advice.sights]
    if advice.experiments:
        lines += ["", "one experiment more, most answers per second first"]
        for experiment in advice.experiments:
            lines += experiment_lines(experiment)
    if advice.dark:
        lines += ["", "not shown at that size by any one of these"]
        lines += [f"  {name:<{width}}  {effect_definition(name).shown_by}" for name in advice.dark]
    lines += [f"note: {note}" for note in advice.notes]
    return lines


def sight_line(sight: "Sight", width: int) -> str:
    """Return the line of one effect: the size from which runs show it, the size worth knowing, and similar effects."""
    smallest_text = "invisible" if sight.smallest is None else f"{sight.smallest:.2g}"
    visibility = "" if sight.seen else "  not shown"
    similar_text = f"  looks like {', '.join(sight.alike)}" if sight.alike else ""
    units = "" if sight.units == "1" else f" {sight.units}"
    worth_text = "-" if sight.faint is None else f"{sight.faint:.2g}{units}"
    return f"{sight.effect:<{width}}  {smallest_text:>10}  {worth_text:<20}{visibility}{similar_text}".rstrip()


def experiment_lines(experiment: "AdvisedProtocol") -> list[str]:
    """Return the command that runs a protocol, and below it the effects that it shows and tells apart."""
    lines = [f"  leactl run {experiment.protocol}  ({experiment.duration_s:.0f} s)"]
    if experiment.shows:
        lines += wrapped_list(f"shows {', '.join(experiment.shows)}")
    if experiment.separates:
        lines += wrapped_list(
            f"tells apart {', '.join(f'{first} / {second}' for first, second in experiment.separates)}"
        )
    return lines


def wrapped_list(text: str) -> list[str]:
    """Return a text as indented lines of at most 80 columns."""
    return textwrap.wrap(text, 80, initial_indent="    ", subsequent_indent="      ")


def closed_loop_lines(loop: "ClosedLoop") -> list[str]:
    """Return the lines of `gap loop`: the effects named, each held-out run before and after, files, notes."""
    named_line = f"Named: {enumerated(list(loop.named))}." if loop.named else "No effect was named."
    rows = [played_cells(run) for run in (*loop.runs, loop.total)]
    left_out_lines = [
        f"{destination.entry.effect}: left out, {destination.reason}"
        for destination in loop.patched.effects
        if destination.reason
    ]
    notes = [list_line("note: ", note) for note in loop.notes]
    file_lines = [f"wrote {path}" for path in loop.written]
    return [
        named_line,
        "",
        aligned(LOOP_HEADINGS, rows),
        "",
        *left_out_lines,
        *file_lines,
        *([""] if notes else []),
        *notes,
    ]


def played_cells(run: "PlayedRun") -> list[str]:
    """Return one run's cells under `LOOP_HEADINGS`."""
    closed_text = "" if run.before <= 0.0 else f"{100.0 * (1.0 - run.after / run.before):.0f} %"
    return [run.run, f"{run.before:.4g}", f"{run.file:.4g}", f"{run.after:.4g}", closed_text]
