"""What the gap's effects are, to read: all of them in a row each, or one with its equation and parameters."""

from leactl.gap.explained import explained
from leactl.report.listing import row
from leactl.vocabulary.effect import effect_definition, effect_names
from leactl.vocabulary.setup_fault import setup_faults


def all_effects() -> str:
    """Every effect in a row, then every fault of a set-up."""
    meanings = {name: effect_definition(name).meaning for name in effect_names()}
    faults = {name: fault.meaning for name, fault in setup_faults().items()}
    width = max(map(len, (*meanings, *faults)))
    rows = [[row(f"{name:<{width}}  ", text) for name, text in group.items()] for group in (meanings, faults)]
    return "\n".join([*rows[0], "", "faults of the set-up, looked for first", *rows[1]])


def one_effect(name: str) -> str:
    """Everything that is known of one effect.

    Raises
    ------
    InputError : no such effect; the known ones are named.
    """
    about = explained(name)
    keys = ("equation", "acts_over", "shown_on", "shows_in", "confused_with", "shown_by")
    texts = about | {key: " or ".join(about[key]) for key in ("acts_over", "shown_on") if key in about}
    rows = [(key.replace("_", " "), texts[key]) for key in keys if key in texts]
    for item in about.get("parameters", ()):
        rest = f", by default {item['default']:g}" if item.get("default") is not None else ""
        units = "" if item["units"] == "1" else f" {item['units']}"
        rows.append((item["name"], f"{item['meaning']} [{item['low']:g} to {item['high']:g}{units}{rest}]"))
    width = max(len(title) for title, _ in rows)
    return "\n".join(
        [row(f"{name}: ", about["meaning"]), *(row(f"  {title:<{width}}  ", text) for title, text in rows)]
    )
