"""A command line that cannot be read: one line with the value and the way to the usage."""

import inspect
import os
import re
import shlex
import subprocess
import sys

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from leactl.cli.main import app

from .terminal import COMMAND, leactl


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("motor scale --radius abc", "invalid value for '--radius': .*, found 'abc'; leactl motor scale --help"),
        ("motor scale --radius=abc", "invalid value for '--radius': .*, found 'abc'; leactl motor scale --help"),
        ("motor scale", "missing option '--radius'; leactl motor scale --help"),
        (
            "thermal limits --ambient nan",
            "invalid value for '--ambient': .*, found 'nan'; leactl thermal limits --help",
        ),
        ("analyze", "missing argument .*; leactl analyze --help"),
        ("motor skale", "no such command 'skale'.*; leactl motor --help"),
        ("stats x.h5 --jason", "no such option: --jason.*; leactl stats --help"),
    ],
)
def test_usage_errors_are_one_line(words, message):
    done = leactl(*words.split())
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert re.fullmatch(f"leactl: {message} tells the usage\n", done.stderr), done.stderr


def test_a_command_without_a_word_gets_its_help():
    done = leactl("motor")
    assert done.returncode in (0, 2)  # click below 8.2 and from there
    assert "Commands:" in done.stdout + done.stderr


def floats(group, path=()):
    """Yield every option of the commands that takes a float, with the path of its command."""
    for name in group.commands:
        command = group.get_command(None, name)
        if hasattr(command, "commands"):
            yield from floats(command, (*path, name))
            continue
        for parameter_name, parameter in inspect.signature(command.callback).parameters.items():
            if "float" in str(parameter.annotation):
                option = next(iter(parameter.default.param_decls or ()), "--" + parameter_name.replace("_", "-"))
                yield (*path, name), option


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_no_option_takes_a_number_that_is_not_finite(value):
    options = list(floats(get_command(app)))
    assert len(options) > 20
    for path, option in options:
        done = CliRunner().invoke(app, [*path, f"{option}={value}"])
        assert done.exit_code == 2, (path, option, done.output)
        assert f"'{option}'" in done.output, (path, option, done.output)


@pytest.mark.parametrize("words", ["-h", "runs -h", "runs verify -h"])
def test_h_is_help(words):
    done = leactl(*words.split())
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == leactl(*words.replace("-h", "--help").split()).stdout


def test_python_m_is_the_command():
    done = subprocess.run([sys.executable, "-m", "leactl", "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, leactl("--version").stdout)


def test_an_error_has_its_status_and_line_where_stdout_is_closed_from_the_start(tmp_path):
    words = [*COMMAND[:1], "-m", "leactl", "runs", "show", str(tmp_path / "none.h5")]
    done = subprocess.run(
        ["sh", "-c", '"$@" >&-', "sh", *words], stderr=subprocess.PIPE, text=True, check=False, cwd=tmp_path
    )
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr


def test_an_empty_command_for_the_end_is_refused(tmp_path):
    done = leactl("run", "current-step", "--out", tmp_path / "runs", "--at-end", "")
    assert done.returncode == 2
    assert done.stderr.startswith("leactl: --at-end: the command is empty")
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("closed", ["stdout", "stderr", "both"])
@pytest.mark.parametrize("words", [["runs", "list", "."], ["runs", "list", "none"], ["--version"]])
def test_a_stream_that_was_closed_before_the_start_is_no_fault(tmp_path, words, closed):
    """As `>&-` and `2>&-` of a shell leave it."""
    redirection = {"stdout": ">&-", "stderr": "2>&-", "both": ">&- 2>&-"}[closed]
    script = f"exec {shlex.join([*COMMAND, *words])} {redirection}"
    done = subprocess.run(["sh", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    expected = subprocess.run([*COMMAND, *words], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == expected.returncode
    assert done.stdout in ("", expected.stdout)
    assert done.stderr in ("", expected.stderr)


@pytest.mark.parametrize("stdout", ["closed", "full"])
def test_a_run_whose_answer_nobody_reads_tells_all_the_same_how_it_ended(tmp_path, stdout):
    bench = leactl("bench", "show", "emulated").stdout.replace("name: emulated", "name: mine", 1)
    bench += "  faults: [{fault: scaled_sensor, at_s: 2, device: drive_test, quantity: q_axis_current, gain: 1000}]\n"
    (tmp_path / "mine.yaml").write_text(bench)
    read, write = os.pipe()
    os.close(read)
    full = os.open("/dev/full", os.O_WRONLY)
    words = ["run", "current-step", "--bench", "mine.yaml", "--at-end", "sh -c 'echo at the end: $0 >&2'"]
    done = subprocess.run(
        [*COMMAND, *words],
        cwd=tmp_path,
        env={**os.environ, "LEACTL_STATE": str(tmp_path)},
        stdout=write if stdout == "closed" else full,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    os.close(write)
    os.close(full)
    lines = [line for line in done.stderr.splitlines() if not line.startswith("leactl: warning")]
    assert done.returncode == 3, "the trip's status, not the reader's"
    assert lines[0] == "at the end: tripped"
    assert "passed the limit" in lines[-1], lines


@pytest.mark.parametrize("words", ["protocol plan friction", "protocol show friction", "motor show lea", "bench list"])
def test_a_reader_that_went_away_is_one_status(words):
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([*COMMAND, *words.split()], stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, "")


def test_a_process_that_is_started_gets_the_null_device_where_a_stream_was_closed(tmp_path):
    child = "import os; os.write(2, b'words'); print(os.readlink('/proc/self/fd/2'))"
    program = f"import subprocess, sys; from leactl.cli import main; main._replace_closed_streams(); {child_of(child)}"
    done = subprocess.run(
        f"{shlex.quote(sys.executable)} -c {shlex.quote(program)} 2>&-",
        shell=True,
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.stdout == "/dev/null\n"


def child_of(program):
    """Call that runs a program in a process of its own."""
    return f"subprocess.run([sys.executable, '-c', {program!r}], check=True)"
