"""The commands and command groups of `leactl`; the module of a command is imported only when the command is called.

To build the parameters of all commands would take as long as to import typer.
"""

from importlib import import_module
from typing import Any, Final

from typer.core import TyperCommand
from typer.main import get_command

from leactl.cli.helptext import WholeSentences
from leactl.errors import Stopped

COMMANDS: Final = {  # name of the command, which is that of its module, and the first sentence of its help
    "analyze": "Fit the parameters that runs were made for, with 95 % intervals, by actuator and condition.",
    "report": "Make a datasheet from runs: results with intervals and sources beside the paper's, and the figures.",
    "run": "Run a protocol on a bench: every setpoint supervised, every sample in one run file.",
    "schema": "Print the JSON Schema of a kind of file, for editors and CI.",
    "stats": "Compare results over conditions: ANOVA with the actuator as a random factor, Tukey HSD, effect sizes.",
    "demo": (
        "Characterise an emulated actuator: torque constant and friction in three preloads, beside the paper's figures."
    ),
    "docs": "List the pages of the manual and their folder, or print one page.",
    "doctor": "Check Python, packages, plug-ins, buses, browser and disk.",
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


class Commands(WholeSentences):
    """The root group, which imports each command or command group on use."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands.update({name: TyperCommand(name=name, help=text) for name, text in COMMANDS.items()})
        self._listing = False  # whether the help of the root group is written, for which no command is imported

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command or group of this name; None if there is none."""
        if cmd_name not in COMMANDS or self._listing:
            return super().get_command(ctx, cmd_name)
        command: Any = get_command(import_module(f"leactl.cli.{cmd_name}").app)
        command.name = cmd_name
        command.help = command.help or COMMANDS[cmd_name]
        return command

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
        self._listing = True
        super().format_commands(ctx, formatter)
        self._listing = False
