"""The entry point: run a command, print each error as one line on stderr and set the exit status."""

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

TYPER_CTRL_C_STATUS = 130  # which typer returns after Ctrl-C
BROKEN_PIPE_STATUS = 141  # 128 + 13, as of a command that SIGPIPE ends in a shell
MOST_FAULT_LINES = 50  # that are printed: a file may have a fault in each of its lines
UsageError: Any = typer.BadParameter.__base__  # not imported: its module differs between versions of typer

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


def _show_version(is_requested: bool) -> None:
    """Print the version and exit if the option is given."""
    if is_requested:
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
    except SystemExit as exit_request:
        writer_module = sys.modules.get("leactl.runfile.write.writer")
        if writer_module is not None and writer_module.KEPT_OPEN:
            _exit_process(exit_request.code)
        raise


def _replace_closed_streams() -> None:
    """Open the null device for each standard stream that was closed when the program started.

    Otherwise a file that is opened later would get the descriptor of the stream and receive what is printed, also in
    processes that are started, such as the watchdog of a run.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(descriptor, True)
            stream = os.fdopen(descriptor, mode, encoding="utf-8")
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)  # keeps it open when a stream over its buffer replaces it


def _exit_process(code: str | int | None) -> NoReturn:
    """Flush both streams, and end the process at once: HDF5 can crash when it is unloaded after a failed write."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(LeactlError.exit_status if isinstance(code, str) else code or 0)


def _run() -> None:
    """Run the command, and exit with its status; an error is printed before."""
    show_control_characters()
    try:
        status = app(prog_name=app.info.name, standalone_mode=False)
    except UsageError as error:
        _refuse_usage(error)
    except InputError as error:
        _print_notes(error)
        _exit_with_faults(error.faults, error.exit_status)
    except LeactlError as error:
        _print_notes(error)
        _exit_with_faults([str(error)], error.exit_status)
    except (BrokenPipeError, SystemExit) as exit_cause:  # click turns a broken pipe into SystemExit
        if not isinstance(exit_cause, BrokenPipeError) and not isinstance(exit_cause.__context__, BrokenPipeError):
            raise
        _discard_stdout()  # else flushing it at exit would raise the error again
        sys.exit(BROKEN_PIPE_STATUS)
    except (KeyboardInterrupt, typer.Abort):
        _exit_with_faults(["stopped"], Stopped.exit_status)
    except Exception as error:
        if os.environ.get("LEACTL_TRACE"):
            raise
        _print_notes(error)
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            _discard_stdout()
            _exit_with_faults(
                [f"{error.filename or 'stdout'}: cannot be written: {error.strerror}"], InputError.exit_status
            )
        _exit_with_faults(
            [f"internal error: {type(error).__name__}: {error}; LEACTL_TRACE=1 shows where"], LeactlError.exit_status
        )
    if status == TYPER_CTRL_C_STATUS:
        _exit_with_faults(["stopped"], Stopped.exit_status)
    sys.exit(status if isinstance(status, int) else 0)


def _print_notes(error: BaseException) -> None:
    """Print the notes of an error on stderr, such as the devices that are not confirmed safe."""
    for note in getattr(error, "__notes__", ()):
        print(f"leactl: {note}", file=sys.stderr)


def _refuse_usage(error: Any) -> NoReturn:
    """Print a usage error as one line with the value, or the help of a command without arguments, and exit."""
    text = " ".join(error.format_message().split()).rstrip(".")
    if text.startswith("Usage:"):
        error.show()
        sys.exit(InputError.exit_status)
    command = error.ctx.command_path if error.ctx is not None else "leactl"
    options = tuple(getattr(getattr(error, "param", None), "opts", ()))
    option_values = [following for word, following in itertools.pairwise(sys.argv) if word in options]
    prefixes = tuple(f"{option}=" for option in options)
    option_values += [word.partition("=")[2] for word in sys.argv if word.startswith(prefixes)]
    found_text = f", found {option_values[0]!r}" if len(option_values) == 1 and text.startswith("Invalid") else ""
    _exit_with_faults(
        [f"{text[0].lower()}{text[1:]}{found_text}; {command} --help tells the usage"], InputError.exit_status
    )


def _discard_stdout() -> None:
    """Redirect stdout to the null device, so that flushing its buffer at exit raises no second error."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _is_json_requested() -> bool:
    """Return whether the command line asks for JSON on stdout."""
    from leactl.cli import gap

    words = list(itertools.takewhile(lambda word: word != "--", sys.argv[1:]))
    return gap.JSON in words and (words[:2] != ["gap", "diagnose"] or gap.TO_STDOUT in gap.with_stdout_named(words))


def _exit_with_faults(lines: list[str], status: int) -> NoReturn:
    """Print the faults on stderr, also as JSON on stdout if the user asked for JSON, and exit with the status."""
    if status == InputError.exit_status and _is_json_requested() and not getattr(sys.stdout, "used", False):
        with suppress(OSError):  # the faults are printed on stderr too
            print(json.dumps({"faults": InputError(lines).as_json()}), flush=True)
    try:
        sys.stdout.flush()
    except OSError:
        _discard_stdout()  # it has no reader, or its disk is full
    for line in lines[:MOST_FAULT_LINES]:
        print(f"leactl: {line}", file=sys.stderr)
    if len(lines) > MOST_FAULT_LINES:
        print(f"leactl: and {len(lines) - MOST_FAULT_LINES} more", file=sys.stderr)
    sys.exit(status)
