"""What `--help` says of every command, and what a shell offers: examples that parse, whole sentences, true names."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.main import get_command

from leactl import errors
from leactl.cli.helptext import MEANINGS, UNCUT_LENGTH
from leactl.cli.main import BROKEN_PIPE_STATUS, app
from leactl.protocol.protocolfile import load
from leactl.runner.campaign.campaignfile import names as campaigns

ROOT = get_command(app)
LEACTL = Path(sys.executable).with_name("leactl")


def walk(group, path=()):
    """Every group and command with the words that lead to it."""
    yield path, group
    for name in getattr(group, "commands", {}):
        yield from walk(group.get_command(None, name), (*path, name))


EVERY = dict(walk(ROOT))
COMMANDS = {path: command for path, command in EVERY.items() if not hasattr(command, "commands")}


def helped(path):
    return EVERY[path].get_help(typer.Context(EVERY[path], info_name=" ".join(("leactl", *path)), terminal_width=80))


def examples(path):
    """Words of each, without what the shell redirects."""
    lines = [line for line in helped(path).splitlines() if line.startswith("    leactl ")]
    return [shlex.split(re.split(" [<>] ", line)[0])[1:] for line in lines]


def by_words(words):
    """The command that words lead to, and those left for it."""
    command, rest = ROOT, list(words)
    while hasattr(command, "commands"):
        named = rest and rest[0] in command.commands
        # `leactl campaign FILE` is `leactl campaign run FILE`
        command = command.get_command(None, rest.pop(0) if named else "run")
    return command, getattr(command, "completed", list)(rest)  # with what an option that stands alone stands for


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_every_command_has_examples_that_parse(path):
    assert examples(path)
    for words in examples(path):
        command, rest = by_words(words)
        assert command.name == COMMANDS[path].name
        given, _, _ = command.make_parser(typer.Context(command)).parse_args(rest)
        lacking = [param.name for param in command.params if param.required and not given.get(param.name)]
        assert not lacking
        arguments = [given.get(param.name) for param in command.params if param.param_type_name == "argument"]
        assert not re.search(r"\.(html|pdf)\b", repr(arguments))  # what an option that takes no value has left over


MOVES_NOTHING = {("bench", "serve"), ("bench", "read"), ("bench", "zero"), ("bench", "recording")}


def test_every_command_that_moves_a_bench_can_be_rehearsed():
    def having(matches):
        return {path for path, command in COMMANDS.items() if any(map(matches, command.params))}

    at_a_bench = having(lambda param: param.metavar == "NAME=INTERFACE:CHANNEL")
    assert having(lambda param: "--dry-run" in param.opts) == at_a_bench - MOVES_NOTHING
    assert at_a_bench >= MOVES_NOTHING


@pytest.mark.parametrize("path", EVERY, ids=" ".join)
def test_help_is_whole_in_80_columns(path):
    lines = helped(path).splitlines()
    assert max(map(len, lines)) <= 80
    assert not [line for line in lines if line.endswith("...") and "]" not in line]


@pytest.mark.parametrize("path", EVERY, ids=" ".join)
def test_statuses_are_told_once_and_at_the_end(path):
    before, _, told = " ".join(helped(path).split()).partition("Exit status: ")
    assert not re.search(r"\bstatus(es)? (\d|as)", before)
    statuses = [part.split()[0] for part in told.removesuffix(".").split(", ")] if told else []
    assert statuses == sorted(set(statuses))


def test_every_status_is_told_with_one_meaning():
    def below(kind):
        return {kind.exit_status}.union(*(below(child) for child in kind.__subclasses__()))

    assert {error.exit_status for error in MEANINGS} == below(errors.LeactlError)
    assert len({error.exit_status for error in MEANINGS}) == len(MEANINGS)
    told = re.search(r"Exit status: ([^.]*)\.", " ".join(helped(("run",)).split())).group(1)
    assert [int(part.split()[0]) for part in told.split(", ")] == [0, *sorted(below(errors.LeactlError))]


def test_the_page_of_exit_statuses_has_those_of_the_code():
    page = (Path(__file__).parents[2] / "docs" / "reference" / "exit-statuses.md").read_text()
    rows = {int(status): meaning for status, meaning in re.findall(r"^\| (\d+) \| (.*) \|$", page, re.MULTILINE)}
    meanings = {error.exit_status: meaning for error, meaning in MEANINGS.items()}
    assert rows.pop(BROKEN_PIPE_STATUS).startswith("the reader of the output went away")
    assert rows == {0: "done", **meanings}


def offered(*words):
    """What bash offers for the last of these words."""
    script = f'source <("{LEACTL}" --show-completion bash); COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1));'
    script += f' _leactl_completion "{LEACTL}"; printf "%s\\n" "${{COMPREPLY[@]}}"'
    done = subprocess.run(
        [shutil.which("bash"), "-c", script, "bash", *words], capture_output=True, text=True, check=True
    )
    return done.stdout.split()


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (("leactl", "runs", "ver"), ["verify"]),
        (("leactl", "run", "torque-c"), ["torque-constant"]),
        (("leactl", "run", "friction", "--bench", "emulated-"), ["emulated-heated"]),
        (("leactl", "gap", "effects", "cogg"), ["cogging"]),
        (("leactl", "run", "friction", "--set", ""), [f"{name}=" for name in load("friction").parameters]),
        (("leactl", "motor", "energy", "a.csv", "--motor", "u8"), ["u8-kv100"]),
        (("leactl", "gap", "plan", "--protocol", "torque-c"), ["torque-constant"]),
        (("leactl", "docs", "dead"), ["dead-man"]),
        (("leactl", "campaign", ""), ["list", "show", "status", "run", *campaigns()]),
        (("leactl", "campaign", "pap"), ["paper"]),
        (("leactl", "campaign", "paper", "--redo"), ["--redo-lost"]),
        (("leactl", "run", "./no-such", "--set", ""), []),
    ],
)
def test_bash_completes_names_and_parameters(words, names):
    assert offered(*words) == names


def test_the_list_of_commands_says_what_the_help_of_each_begins_with():
    listed = {name: command.get_short_help_str(UNCUT_LENGTH) for name, command in ROOT.commands.items()}
    assert listed == {name: ROOT.get_command(None, name).get_short_help_str(UNCUT_LENGTH) for name in listed}


def test_help_imports_no_command():
    program = "import sys; from leactl.cli.main import main\ntry: main()\nfinally: print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", program, "--help"], capture_output=True, text=True, check=True)
    assert not {f"leactl.cli.{name}" for name in ROOT.commands} & set(done.stderr.split())
