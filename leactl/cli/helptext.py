"""What the help of every command and group has in common: examples, exit statuses, and sentences that are whole."""

from collections.abc import Mapping
from typing import Any, Final

import typer
from typer.core import TyperGroup

from leactl.errors import AcceptanceFailed, DeviceError, InputError, LeactlError, SafetyTrip, Stopped

MEANINGS: Final[dict[type[LeactlError], str]] = {
    LeactlError: "internal error",
    InputError: "input that cannot be used",
    SafetyTrip: "safety trip",
    Stopped: "stopped by a person",
    DeviceError: "a device or its bus failed",
    AcceptanceFailed: "an acceptance limit is not met",
}
ALWAYS: Final[tuple[type[LeactlError], ...]] = (LeactlError, InputError, Stopped)  # Ctrl-C ends every command
ON_A_BENCH: Final[tuple[type[LeactlError], ...]] = (SafetyTrip, DeviceError)
UNCUT: Final = 10_000  # characters of a command's sentence in the list of a group


class WholeSentences(TyperGroup):
    """A group whose list has the first sentence of every command's help, wrapped and not cut."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands."""
        commands: list[tuple[str, Any]] = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        rows = [(name, command.get_short_help_str(UNCUT)) for name, command in commands]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def group_of_commands(kind: type[WholeSentences] = WholeSentences) -> typer.Typer:
    """A group; without a word it prints its help."""
    return typer.Typer(cls=kind, no_args_is_help=True, rich_markup_mode=None)


def examples(
    *lines: str, ends: tuple[type[LeactlError], ...] = (), means: Mapping[type[LeactlError], str] | None = None
) -> str:
    """The end of a command's help.

    Parameters
    ----------
    lines : commands as a person types them, without `leactl`.
    ends : how it may end beside what every command may.
    means : what a status says of this command, in place of what it says of most.
    """
    meanings = {**MEANINGS, **(means or {})}
    statuses = {error.exit_status: meanings[error] for error in (*ALWAYS, *ends)}
    status_texts = ", ".join(f"{status} {meaning}" for status, meaning in sorted({0: "done", **statuses}.items()))
    shown = "".join(f"\n  leactl {line}" for line in lines)
    return f"\b\nExample{'s' if len(lines) > 1 else ''}:{shown}\n\nExit status: {status_texts}."
