"""`leactl gap`: where, why and by how much a simulator and a bench disagree."""

import json
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand

from leactl.cli import finite
from leactl.cli.completion import complete_effect, complete_protocol
from leactl.cli.helptext import examples, group_of_commands

app = group_of_commands()
blind = group_of_commands()
app.add_typer(blind, name="blind", help="Check the diagnosis on withheld causes.")
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")
SEED_LIMIT = 10**6  # random seeds are below it, so that they are short to type
JSON, TO_STDOUT, RUN_FILE = "--json", "-", ".h5"
SIMULATED = "--simulated"


class RealAndSimulatedRuns(TyperCommand):
    """A command whose `--json` may have a file or none, and whose `--simulated` takes several runs."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert `-` after a `--json` without a file and `--simulated` before each of its runs, and parse.

        The option `--model` is not required with simulated runs, and the help does not mark it as required.
        """
        for parameter in self.params:
            if parameter.name == "model":
                parameter.required = not {SIMULATED, *ctx.help_option_names} & set(args)
        return super().parse_args(ctx, with_stdout_named(with_option_repeated(args)))


def with_option_repeated(args: list[str]) -> list[str]:
    """Return the words of a command line with `--simulated` inserted before each of its runs.

    Its runs are all words up to the next option, as a shell expands `*`.
    """
    words: list[str] = []
    is_in_list = False  # whether the word belongs to a --simulated
    for index, word in enumerate(args):
        is_first_run = index > 0 and args[index - 1] == SIMULATED
        is_in_list = word == SIMULATED or (is_in_list and not (word.startswith("-") and not is_first_run))
        words += [SIMULATED, word] if is_in_list and word != SIMULATED and not is_first_run else [word]
    return words


def with_stdout_named(args: list[str]) -> list[str]:
    """Return the words of a command line with `-` inserted after a `--json` without a file."""
    words: list[str] = []
    for index, word in enumerate(args):
        words.append(word)
        next_word = args[index + 1] if index + 1 < len(args) else RUN_FILE
        is_option = next_word.startswith("-") and next_word != TO_STDOUT
        if word == JSON and (is_option or next_word.endswith(RUN_FILE)):
            words.append(TO_STDOUT)
    return words


@app.command(
    "diagnose",
    cls=RealAndSimulatedRuns,
    epilog=examples(
        "gap diagnose *-a.h5 --held-out *-b.h5 --model nominal.yaml",
        "gap diagnose runs/*.h5 --model nominal.yaml --html gap.html",
        "gap diagnose real/*.h5 --simulated sim/*.h5 --model nominal.yaml",
    ),
)
def diagnose_runs(
    runs: list[Path] = typer.Argument(metavar="RUN...", help="Run files to learn from."),
    model: Path | None = typer.Option(
        None, "--model", help="Nominal model, a .yaml; needed unless simulated runs carry one."
    ),
    held_out: list[Path] = typer.Option([], "--held-out", help="A run to judge on; may be repeated."),
    simulated: list[Path] = typer.Option(
        [], SIMULATED, metavar="RUN...", help="Runs of a simulator on the same inputs, which then is the nominal."
    ),
    json_out: Path | None = typer.Option(
        None, JSON, metavar="[OUT.json]", help="Print JSON on stdout, or write it to OUT.json."
    ),
    html: Path | None = typer.Option(None, "--html", help="Write a page to look at."),
    write_model: Path | None = typer.Option(None, "--write-model", help="Write the calibrated, augmented model."),
) -> None:
    """Say where the model and the runs disagree, which unmodelled effect causes it, and how far the gap shrinks."""
    from leactl.gap.simulated.request import requested_diagnosis
    from leactl.report.gap_files import STDOUT, Outputs
    from leactl.report.gap_text import print_diagnosis
    from leactl.report.progress_line import ProgressLine

    outputs = Outputs(json_out, html, write_model)
    outputs.check([*runs, *held_out, *simulated, *([] if model is None else [model])])
    with ProgressLine() as step:
        diagnosis = requested_diagnosis(runs, held_out, model, simulated, step)
        step("writing")
        outputs.write(diagnosis)
    if json_out != STDOUT:
        print_diagnosis(diagnosis)


@app.command(epilog=examples("gap simulate nominal.yaml RUN.h5 --out simulated.h5"))
def simulate(
    model: Path = typer.Argument(help="Model file, with or without effects."),
    run: Path = typer.Argument(help="Run whose inputs are replayed."),
    out: Path | None = typer.Option(None, "--out", help="New run file; by default one beside RUN."),
    as_json: bool = AS_JSON,
) -> None:
    """Simulate a run again: its own inputs through a model, written as a run file with the same channels and clock."""
    from leactl.gap.replay.replay_run_file import simulate as write

    simulated = write(model, run, out)
    typer.echo(json.dumps(simulated.as_json()) if as_json else str(simulated.path))
    for note in () if as_json else simulated.notes:
        typer.echo(f"note: {note}", err=True)


@app.command(epilog=examples("gap compare simulated.h5 RUN.h5 --json"))
def compare(first: Path, second: Path, as_json: bool = AS_JSON) -> None:
    """Print how far SECOND is from FIRST, channel by channel: rms, mean, correlation and lag."""
    from leactl.gap.distance import as_json as comparison_json
    from leactl.gap.distance import compare_runs

    comparisons = compare_runs(first, second)
    if as_json:
        typer.echo(json.dumps(comparison_json(comparisons)))
        return
    for channel in comparisons:
        channel_name = " ".join(filter(None, (channel.role, channel.quantity, channel.location)))
        similarity = (
            "stands still"
            if channel.correlation is None
            else f"r {channel.correlation:.4f}, lag {channel.lag_s:+.4g} s"
        )
        typer.echo(
            f"{channel_name:<34} rms {channel.rms:<10.4g} mean {channel.mean:<+11.4g} {channel.units:<6} {similarity}"
        )


@app.command("effects", epilog=examples("gap effects", "gap effects cogging"))
def show_effects(
    name: str | None = typer.Argument(
        None, help="One effect; without it all are listed.", autocompletion=complete_effect
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Explain what a model may lack: equation, where it shows, what it is confused with, what shows it; and faults."""
    from leactl.gap.effect_sheet import effect_sheet
    from leactl.report.gap_listings import all_effects_text, effect_text
    from leactl.vocabulary.effect import effect_names
    from leactl.vocabulary.setup_fault import setup_faults

    if as_json:
        groups = {"effects": effect_names(), "setup_faults": tuple(setup_faults())}
        explanations = {group: [effect_sheet(effect) for effect in names] for group, names in groups.items()}
        typer.echo(json.dumps(effect_sheet(name) if name else explanations))
        return
    typer.echo(effect_text(name) if name else all_effects_text())


@app.command(
    "plan",
    epilog=examples("gap plan --model nominal.yaml --protocol friction", "gap plan runs/*.h5 --model nominal.yaml"),
)
def plan_runs(
    runs: list[Path] = typer.Argument(None, metavar="[RUN]...", help="Run files that there are."),
    model: Path = typer.Option(..., "--model", help="Nominal model, a .yaml."),
    protocols: list[str] = typer.Option(
        [], "--protocol", help="A protocol that will be run; may be repeated.", autocompletion=complete_protocol
    ),
    noise: list[str] = typer.Option([], "--noise", metavar="QUANTITY=STD", help="Noise of a planned channel, SI."),
    as_json: bool = AS_JSON,
) -> None:
    """Say which effects runs and protocols can and cannot reveal, and which experiment would reveal more."""
    from leactl.gap.planning.advice import advise, read_noise
    from leactl.report.gap_listings import advice_json, advice_lines

    advice = advise(model, runs or [], protocols, read_noise(noise))
    typer.echo(json.dumps(advice_json(advice)) if as_json else "\n".join(advice_lines(advice)))


@app.command(epilog=examples("gap demo", "gap demo --effect cogging --out cogging"))
def demo(
    seed: int | None = typer.Option(None, "--seed", min=0, help="Seed of the draw; by default fresh entropy."),
    effect: str | None = typer.Option(None, "--effect", help="Plant this effect.", autocompletion=complete_effect),
    out: Path | None = typer.Option(None, "--out", help="New folder; by default leactl-gap-demo-SEED."),
    as_json: bool = AS_JSON,
) -> None:
    """Plant an effect in an emulated bench, run it, diagnose the runs, and only then open the key and compare."""
    from secrets import randbelow

    from leactl.emulation.blind.key import read_key
    from leactl.emulation.blind.make import make
    from leactl.gap.blind.demonstration import demonstrate
    from leactl.report.gap_demo import demonstration_json as demonstration_document
    from leactl.report.gap_demo import demonstration_lines, files_of, page
    from leactl.report.gap_files import publish
    from leactl.report.progress_line import ProgressLine

    if seed is None:
        seed = randbelow(SEED_LIMIT)
    files = files_of(out or Path(f"leactl-gap-demo-{seed}"))
    with ProgressLine() as step:
        step("planting an effect and running the emulated bench")
        make(1, files.bench, files.key, seed, ("single",), [effect] if effect else None, ("plain", "strong"), "bench")
        demonstration = demonstrate(files.bench, files.answer, lambda: read_key(files.key, files.bench), step)
        publish(files.page, page(demonstration, seed))
    typer.echo(
        json.dumps(demonstration_document(demonstration, seed, files))
        if as_json
        else "\n".join(demonstration_lines(demonstration, seed, files))
    )


@app.command(
    epilog=examples("gap loop robot.xml *.h5 --joint knee --out new.xml --callbacks k.py"),
)
def loop(
    robot: Path = typer.Argument(help="MJCF file."),
    runs: list[Path] = typer.Argument(metavar="RUN...", help="Run files of its position servo to learn from."),
    joint: str = typer.Option(..., "--joint", help="Joint in the file."),
    out: Path = typer.Option(..., "--out", help="New MJCF file, patched."),
    callbacks: Path = typer.Option(..., "--callbacks", help="New .py for MuJoCo with what MJCF cannot hold."),
    supply: float | None = typer.Option(
        None, "--supply", min=0.1, max=1000.0, help="Supply voltage of the servo [V].", callback=finite
    ),
    held_out: list[Path] = typer.Option([], "--held-out", help="A run to judge on; may be repeated."),
    write_model: Path | None = typer.Option(None, "--write-model", help="Write the augmented model, a new .yaml."),
    as_json: bool = AS_JSON,
) -> None:
    """Close the loop in your own MuJoCo model: play runs, diagnose, patch, play held-out runs again."""
    from leactl.exchange.loop import LoopFiles, close_loop
    from leactl.report.gap_listings import closed_loop_lines
    from leactl.report.progress_line import ProgressLine

    with ProgressLine() as step:
        closed = close_loop(LoopFiles(robot, runs, held_out, out, callbacks, write_model), joint, supply, step)
    typer.echo(json.dumps(closed.as_json()) if as_json else "\n".join(closed_loop_lines(closed)))


@blind.command(
    "make",
    epilog=examples("gap blind make --cases 20 --out cases", "gap blind make --cases 80 --machines 8 --out cases"),
)
def make_blind(
    cases: int = typer.Option(..., "--cases", help="How many cases to draw."),
    out: Path = typer.Option(..., "--out", help="New folder for runs, nominal models and the key's hash."),
    key: Path | None = typer.Option(None, "--key", help="New folder for the key; by default OUT with -key at its end."),
    seed: int | None = typer.Option(None, "--seed", min=0, help="Draw the same cases again; by default fresh entropy."),
    kinds: list[str] = typer.Option([], "--kinds", help="Only these of none, single, pair, unknown; may be repeated."),
    machines: int | None = typer.Option(
        None, "--machines", min=1, help="Draw so many machines, and cases on them; by default all are of the bench."
    ),
    simulator: str | None = typer.Option(
        None,
        "--simulator",
        help="Simulator of drawn machines: stepped, or mujoco from leactl[mujoco]; by default stepped.",
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Draw benches or machines with unknown departures from their nominal model; write their runs, the key apart."""
    from leactl.emulation.blind.case_counts import KINDS
    from leactl.emulation.blind.make import make as make_benches
    from leactl.errors import InputError
    from leactl.joints.make import make as make_machines
    from leactl.report.progress_line import ProgressLine

    if machines is None and simulator is not None:
        raise InputError(f"--simulator {simulator}: simulates drawn machines; add --machines")
    key_folder, chosen_kinds = key or out.with_name(f"{out.name}-key"), kinds or KINDS
    with ProgressLine() as step:
        if machines is None:
            digest = make_benches(cases, out, key_folder, seed=seed, kinds=chosen_kinds, progress=step)
        else:
            digest = make_machines(cases, out, key_folder, machines, simulator or "stepped", seed, chosen_kinds, step)
    if as_json:
        typer.echo(json.dumps({"cases": cases, "out": str(out), "key": str(key_folder), "key_sha256": digest}))
        return
    typer.echo(f"{cases} cases in {out}; their key in {key_folder}, SHA-256 {digest}")


@blind.command(
    "score",
    epilog=examples(
        "gap blind score --cases cases --key key --out score.md",
        "gap blind score --cases one --key one-key --cases two --key two-key",
    ),
)
def score_blind(
    cases: list[Path] = typer.Option(..., "--cases", help="Folder that `blind make` wrote; may be repeated."),
    key: list[Path] = typer.Option(..., "--key", help="Folder of their key; opened after the last diagnosis."),
    out: Path | None = typer.Option(None, "--out", help="Write the report, a .md."),
    answers: list[Path] = typer.Option([], "--answers", help="Folder of answers; by default CASES-answers."),
    processes: int = typer.Option(1, "--processes", min=1, help="How many cases are diagnosed at a time."),
    scheduler: str = typer.Option(
        "", "--scheduler", metavar="ADDRESS", help="Spread the work over the workers of this Dask scheduler."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Diagnose every case, then open the key and say how often the diagnosis was right; a stop keeps what is done."""
    from leactl.emulation.blind.key import read_key, require_whole
    from leactl.errors import InputError
    from leactl.gap.blind.check import Cases, check
    from leactl.gap.blind.score import score
    from leactl.report.blind_score import markdown
    from leactl.report.blind_score import score_json as score_document
    from leactl.report.progress_line import ProgressLine
    from leactl.runfile.publish import new_file, refuse_existing
    from leactl.scheduler import workers_of

    if out is not None:
        refuse_existing(out)
    for folder in cases:
        require_whole(folder)
    case_sets = Cases.side_by_side(cases, key, answers)
    if out in [case_set.answers for case_set in case_sets]:
        raise InputError(f"--out {out}: is the folder that the answers go to; the name of a file was expected")
    with ProgressLine() as step, workers_of(processes, scheduler) as workers:
        case_marks = check(case_sets, read_key, workers, step)
    scores = score(case_marks)
    options = " ".join(f"--cases {case_set.runs.name} --key {case_set.key.name}" for case_set in case_sets)
    command = f"leactl gap blind score {options}"
    if out is not None:
        with new_file(out) as path:
            path.write_text(markdown(scores, command), encoding="utf-8")
    typer.echo(json.dumps(score_document(scores, command)) if as_json else markdown(scores, command))
