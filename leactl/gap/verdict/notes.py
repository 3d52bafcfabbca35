"""Notes on what a diagnosis could not answer: questions whose channels or set-ups the runs lack."""

import math
from collections.abc import Sequence

from leactl.effects import library
from leactl.gap.search.effect_regression import PRIORS, Evidence, Null
from leactl.gap.signals.record import Record
from leactl.model.nominal import Model
from leactl.vocabulary.effect import effect_definition

CHANNEL_QUESTIONS = {
    "torque": ("the torque sensor", "a torque channel in a locked or coupled run"),
    "q_axis_voltage": ("resistance, back-EMF and the inverter", "the q-axis voltage"),
    "angle": ("friction, inertia and everything periodic in angle", "the angle of a moving run"),
    "bus_voltage": ("the bus", "the bus voltage"),
    "q_axis_current_reference": ("delay and rate of the drive", "the current reference"),
    "winding_temperature": ("everything thermal", "winding and housing temperatures"),
}
"""By quantity: what is not answered without its channel, and the channel that answers it."""


def questions(model: Model, records: Sequence[Record], evidence: Evidence, judged_by_runs: bool) -> tuple[str, ...]:
    """Return notes on what these runs cannot show.

    judged_by_runs : whether free runs judge the effects of a servo, which are then not invisible.
    """
    notes = []
    for quantity, (question, needed_channel) in CHANNEL_QUESTIONS.items():
        role = "bench" if quantity == "bus_voltage" else "test"
        if not any(has_channel(record, quantity, role) for record in records):
            notes.append(f"not answered: {question}; it needs {needed_channel}")
    if model.feedforward is not None:
        notes.append("torques are told in volts: a feedforward says nothing of the torque that a volt makes")
    elif model.torque_constant is not None and evidence.tells_nothing_of("torque_constant"):
        notes.append(
            "torques, inertias and powers go by the model's torque_constant, which these runs cannot tell: its error"
            f" ({100.0 * PRIORS['torque_constant']:.0f} % is usual) is in all of them alike, beside their own"
        )
    if model.drive is None and any(has_channel(record, "angle_reference", "test") for record in records):
        notes.append("not answered: limits and dead band of the servo; they need its `drive:` in the model")
    hidden_effects = [
        name
        for name in invisible_effects(model, evidence)
        if not (judged_by_runs and effect_definition(name).shown_on == ("servo",))
    ]
    if hidden_effects:
        notes.append(f"invisible in these runs: {', '.join(hidden_effects)}")
    return tuple(notes)


def null_notes(evidence: Evidence, null: Null) -> tuple[str, ...]:
    """Return notes on parameters that the runs do not determine, and on equations without a simulated sound run."""
    notes = []
    if null.unidentifiable:
        changes_text = ", ".join(
            f"{name} ({100.0 * math.hypot(*null.parameter_changes[name]):.0f} %)" for name in null.unidentifiable
        )
        notes.append(
            f"these runs cannot tell {changes_text}: fits to simulated sound runs move it so far; the model's is kept"
        )
    equations_and_kinds = {(rows.equation, rows.kind) for rows in evidence.stack.rows if not rows.rough}
    unjudged = sorted({equation for equation, _ in equations_and_kinds - null.unrest.keys()})
    if unjudged:
        notes.append(
            f"no sound run could be simulated for {', '.join(unjudged)}: what is left over there is not judged"
        )
    return tuple(notes)


def reading_notes(records: Sequence[Record]) -> tuple[str, ...]:
    """Return the notes made while runs were read; a note on several runs occurs once, with the number of the others."""
    runs_by_text: dict[str, list[str]] = {}
    for record in records:
        for note in record.notes:
            run, _, text = note.partition(": ")
            runs_with_note = runs_by_text.setdefault(text, [])
            if run not in runs_with_note:  # a run may occur twice, in parts
                runs_with_note.append(run)
    return tuple(
        f"{names[0]}{f' and {len(names) - 1} more' if len(names) > 1 else ''}: {text}"
        for text, names in runs_by_text.items()
    )


def condition_notes(fitted: Sequence[Record], held_out: Sequence[Record]) -> tuple[str, ...]:
    """Return notes on kinds of runs whose held-out runs have a condition or set-up that no fitted run has."""
    notes = []
    for attribute in ("condition", "mechanical"):
        for kind in sorted({record.kind for record in fitted} & {record.kind for record in held_out}):
            fitted_values = {getattr(record, attribute) for record in fitted if record.kind == kind}
            held_out_values = {getattr(record, attribute) for record in held_out if record.kind == kind}
            if held_out_values - fitted_values:
                texts = (
                    ", ".join(sorted(value or "not named" for value in values))
                    for values in (fitted_values, held_out_values)
                )
                notes.append(f"{kind}: {attribute} of fitted runs: {next(texts)}; of held-out runs: {next(texts)}")
    return tuple(notes)


def has_channel(record: Record, quantity: str, role: str) -> bool:
    """Return whether a run has a channel on its fast or its slow clock."""
    return any(clock is not None and clock.get(quantity, role) is not None for clock in (record.fast, record.slow))


def invisible_effects(model: Model, evidence: Evidence) -> list[str]:
    """Return the effects that no equation of these runs has a column for."""
    visible = {name[1] for name in evidence.stack.names if name[0] == "effect"}
    return [name for name, effect in library().items() if effect.applies(model) and name not in visible]
