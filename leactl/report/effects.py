"""What the gap's effects are, to read: all of them in a row each, or one with its equation and parameters."""

from leactl.gap.explained import explained
from leactl.report.listing import row
from leactl.vocabulary.effect import effect_definition, effect_names


def all_effects() -> str:
    """Every effect in a row."""
    width = max(map(len, effect_names()))
    return "\n".join(row(f"{name:<{width}}  ", effect_definition(name).meaning) for name in effect_names())


def one_effect(name: str) -> str:
    """Everything that is known of one effect.

    Raises
    ------
    InputError : no such effect; the known ones are named.
    """
    about = explained(name)
    keys = ("equation", "shows_in", "confused_with", "shown_by")
    rows = [(key.replace("_", " "), about[key]) for key in keys]
    for item in about["parameters"]:
        rest = f", by default {item['default']:g}" if item.get("default") is not None else ""
        units = "" if item["units"] == "1" else f" {item['units']}"
        rows.append((item["name"], f"{item['meaning']} [{item['low']:g} to {item['high']:g}{units}{rest}]"))
    width = max(len(title) for title, _ in rows)
    return "\n".join(
        [row(f"{name}: ", about["meaning"]), *(row(f"  {title:<{width}}  ", text) for title, text in rows)]
    )
