"""Parts of the help that all commands and groups share: examples, exit statuses and untruncated first sentences."""

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
UNCUT_LENGTH: Final = 10_000  # characters; longer than the help sentence of any command, so that none is cut


class WholeSentences(TyperGroup):
    """A command group whose list shows the whole first sentence of each command's help, wrapped."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands."""
        commands: list[tuple[str, Any]] = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        rows = [(name, command.get_short_help_str(UNCUT_LENGTH)) for name, command in commands]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def group_of_commands(kind: type[WholeSentences] = WholeSentences) -> typer.Typer:
    """Create a command group that prints its help when called without a command."""
    return typer.Typer(cls=kind, no_args_is_help=True, rich_markup_mode=None, add_completion=False)


def single_command() -> typer.Typer:
    """Create the `app` of a module that has one command and no group."""
    return typer.Typer(rich_markup_mode=None, add_completion=False)


def examples(
    *commands: str, ends: tuple[type[LeactlError], ...] = (), means: Mapping[type[LeactlError], str] | None = None
) -> str:
    """Return the end of the help of a command: examples and exit statuses.

    Parameters
    ----------
    commands : example commands, without `leactl`.
    ends : errors that the command may end with, in addition to those of every command (ALWAYS).
    means : meanings of the exit statuses of these errors for this command, in place of MEANINGS.
    """
    meanings = {**MEANINGS, **(means or {})}
    meaning_of_status = {error.exit_status: meanings[error] for error in (*ALWAYS, *ends)}
    status_texts = ", ".join(
        f"{status} {meaning}" for status, meaning in sorted({0: "done", **meaning_of_status}.items())
    )
    example_lines = "".join(f"\n  leactl {line}" for line in commands)
    return f"\b\nExample{'s' if len(commands) > 1 else ''}:{example_lines}\n\nExit status: {status_texts}."
