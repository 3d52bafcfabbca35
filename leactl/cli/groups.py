"""The command groups; a group's module is imported only when one of its commands is called.

Building the parameters of all fifty commands would take as long as importing typer.
"""

from importlib import import_module
from typing import Any, Final

from typer.core import TyperGroup
from typer.main import get_group

from leactl.cli.helptext import WholeSentences
from leactl.errors import Stopped

GROUPS: Final = {  # by the name of the module that has the group as `app`
    "bench": "Bench files, and what is done at a bench beside a protocol.",
    "campaign": "Run campaigns: `leactl campaign CAMPAIGN` begins one or goes on with it.",
    "driver": "List, explain and check driver plug-ins.",
    "gap": "Diagnose the gap between model and bench.",
    "model": "Models of other simulators, in and out.",
    "motor": "Motor parameter sets and motor design.",
    "protocol": "List, show, check and expand protocols.",
    "runs": "List, show, verify and mend run files.",
    "safety": "Rehearse what keeps a bench safe.",
    "thermal": "Limits, state and forecast of windings.",
}


class Groups(WholeSentences):
    """The root group: its own commands, and the command groups by name, which are imported on use."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands.update({name: TyperGroup(name=name, help=text) for name, text in GROUPS.items()})
        self._only_named = False  # while the root's own help is written

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command or group of this name, None if there is none."""
        if cmd_name not in GROUPS or self._only_named:
            return super().get_command(ctx, cmd_name)
        group: Any = get_group(import_module(f"leactl.cli.{cmd_name}").app)
        group.name, group.help = cmd_name, GROUPS[cmd_name]
        return group

    def invoke(self, ctx: Any) -> Any:
        """Run a command; Ctrl-C ends it as an error with its notes, which typer would drop.

        Raises
        ------
        Stopped : Ctrl-C was pressed.
        """
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interrupt:
            stopped = Stopped("stopped")
            for note in getattr(interrupt, "__notes__", ()):
                stopped.add_note(note)
            raise stopped from None

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of all commands and groups for the root's help."""
        self._only_named = True
        super().format_commands(ctx, formatter)
        self._only_named = False
