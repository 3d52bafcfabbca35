"""The entry point: runs a command, prints each error as one line on stderr and sets the exit status."""

import errno
import itertools
import json
import os
import sys
from contextlib import suppress
from typing import Any, NoReturn

import typer

from leactl import __version__
from leactl.cli.commands import Commands
from leactl.cli.printable import show_control_characters
from leactl.errors import InputError, LeactlError, Stopped

CTRL_C_OF_TYPER = 130
READER_GONE = 141  # as a shell has it where SIGPIPE ends a command: 128 + 13
MOST_LINES = 50  # of faults: a screen, where a file has one in each of its lines
UsageError: Any = typer.BadParameter.__base__  # whose module typer has moved

app = typer.Typer(
    cls=Commands,
    name="leactl",
    help="Characterise electric actuators: protocols in, HDF5 runs and fitted parameters out.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    epilog="leactl COMMAND --help has examples and exit statuses; leactl docs has the manual.",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"leactl {__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: bool = typer.Option(False, "--version", callback=_show_version, is_eager=True, help="Print the version."),
) -> None:
    """Characterise electric actuators: protocols in, HDF5 runs and fitted parameters out."""


def main() -> None:
    """Run the command line; an error prints one line on stderr and sets the exit status."""
    _replace_closed_streams()
    try:
        _run()
    except SystemExit as end:
        recording = sys.modules.get("leactl.runfile.write.writer")
        if recording is not None and recording.KEPT_OPEN:
            _exit_process(end.code)
        raise


def _replace_closed_streams() -> None:
    """Let standard streams be the null device where they were closed before the start.

    It takes their descriptors, here and in processes that are started, such as a run's watchdog: else a file which is
    opened later would receive what is printed.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(descriptor, True)
            stream = os.fdopen(descriptor, mode, encoding="utf-8")
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)  # which keeps it open where another stream is put over its buffer


def _exit_process(code: str | int | None) -> NoReturn:
    """Flush both streams and end the process without unloading libraries: HDF5 can crash there after a failed write."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(LeactlError.exit_status if isinstance(code, str) else code or 0)


def _run() -> None:
    show_control_characters()
    try:
        status = app(prog_name=app.info.name, standalone_mode=False)
    except UsageError as error:
        _refuse_usage(error)
    except InputError as error:
        _tell_notes(error)
        _end(error.faults, error.exit_status)
    except LeactlError as error:
        _tell_notes(error)
        _end([str(error)], error.exit_status)
    except (BrokenPipeError, SystemExit) as end:  # click makes an exit of its own of a broken pipe
        if not isinstance(end, BrokenPipeError) and not isinstance(end.__context__, BrokenPipeError):
            raise
        _discard_stdout()  # a second attempt at exit would only repeat the complaint
        sys.exit(READER_GONE)
    except (KeyboardInterrupt, typer.Abort):
        _end(["stopped"], Stopped.exit_status)
    except Exception as error:
        if os.environ.get("LEACTL_TRACE"):
            raise
        _tell_notes(error)
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            _discard_stdout()
            _end([f"{error.filename or 'stdout'}: cannot be written: {error.strerror}"], InputError.exit_status)
        _end([f"internal error: {type(error).__name__}: {error}; LEACTL_TRACE=1 shows where"], LeactlError.exit_status)
    if status == CTRL_C_OF_TYPER:
        _end(["stopped"], Stopped.exit_status)
    sys.exit(status if isinstance(status, int) else 0)


def _tell_notes(error: BaseException) -> None:
    """Print what was added to an error on its way here, such as the devices that are not confirmed safe."""
    for note in getattr(error, "__notes__", ()):
        print(f"leactl: {note}", file=sys.stderr)


def _refuse_usage(error: Any) -> NoReturn:
    """Print a usage error as one line with the value found, and exit; a command without arguments prints its help."""
    text = " ".join(error.format_message().split()).rstrip(".")
    if text.startswith("Usage:"):
        error.show()
        sys.exit(InputError.exit_status)
    command = error.ctx.command_path if error.ctx is not None else "leactl"
    options = tuple(getattr(getattr(error, "param", None), "opts", ()))
    given = [after for word, after in itertools.pairwise(sys.argv) if word in options]
    given += [word.partition("=")[2] for word in sys.argv if word.startswith(tuple(f"{option}=" for option in options))]
    value = f", found {given[0]!r}" if len(given) == 1 and text.startswith("Invalid") else ""
    _end([f"{text[0].lower()}{text[1:]}{value}; {command} --help tells the usage"], InputError.exit_status)


def _discard_stdout() -> None:
    """Redirect stdout to the null device, so that flushing its buffer at exit raises no second error."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _is_json_requested() -> bool:
    """Whether the command line asks for JSON on stdout."""
    from leactl.cli import gap

    words = list(itertools.takewhile(lambda word: word != "--", sys.argv[1:]))
    return gap.JSON in words and (words[:2] != ["gap", "diagnose"] or gap.TO_STDOUT in gap.completed(words))


def _end(lines: list[str], status: int) -> NoReturn:
    if status == InputError.exit_status and _is_json_requested() and not getattr(sys.stdout, "used", False):
        with suppress(OSError):  # what stdout cannot take stands on stderr
            print(json.dumps({"faults": InputError(lines).as_json()}), flush=True)
    try:
        sys.stdout.flush()
    except OSError:
        _discard_stdout()  # nobody reads it, or its disk is full
    for line in lines[:MOST_LINES]:
        print(f"leactl: {line}", file=sys.stderr)
    if len(lines) > MOST_LINES:
        print(f"leactl: and {len(lines) - MOST_LINES} more", file=sys.stderr)
    sys.exit(status)
