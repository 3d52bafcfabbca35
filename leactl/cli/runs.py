"""`leactl runs`: find, show, plot, verify, mend, annotate, export and import run files."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from leactl.cli import finite
from leactl.cli.helptext import examples, group_of_commands
from leactl.errors import InputError

if TYPE_CHECKING:
    from leactl import yamlfile

app = group_of_commands()
POLL_S = 0.2  # least time between two reads of a run that is followed, to which rows are added once a second
BUSY_SHARE = 0.1  # largest share of a core for these reads: those of a long run are slow, and a control loop goes first
UNWRITTEN_S = 10.0  # time without a write, after which a run that is being recorded may have been killed
AUTO = "auto"  # value of --map that proposes a mapping
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")
PROCESSES = typer.Option(1, "--processes", min=1, help="How many runs to read at a time; the answer is the same.")
SCHEDULER = typer.Option(
    "", "--scheduler", metavar="ADDRESS", help="Spread the work over the workers of this Dask scheduler."
)
INDEX = typer.Option(None, "--index", metavar="FILE", help="The index; by default .leactl-index.sqlite in the folder.")


def print_remark(line: str) -> None:
    """Print a remark for the user on stderr."""
    typer.echo(f"leactl: {line}", err=True)


@app.command(
    "list",
    epilog=examples(
        "runs list",
        "runs list runs --where hold_s=6 --sort created",
        "runs list runs --where \"experiment == 'friction' and 'paper' in tags\"",
    ),
)
def list_runs(
    directory: Path = typer.Argument(Path("runs")),
    protocol: str = typer.Option("", help="Only runs of this protocol."),
    actuator: str = typer.Option("", help="Only runs of this actuator."),
    condition: str = typer.Option("", help="Only runs under this condition."),
    status: str = typer.Option("", help="Only complete, stopped, tripped, failed, recording or recovered runs."),
    since: str = typer.Option("", metavar="DATE", help="Only runs from this day (UTC) or moment on."),
    until: str = typer.Option("", metavar="DATE", help="Only runs up to this day, which counts, or moment."),
    where: list[str] = typer.Option(
        [],
        metavar="EXPRESSION",
        help="Only where this holds, such as \"condition == 'loaded' and hold_s >= 6\", or hold_s=6 for short.",
    ),
    sort: str = typer.Option("file", metavar="KEY", help="file, created, duration, status, protocol or a parameter."),
    reverse: bool = typer.Option(False, "--reverse", help="Print the list in reverse order."),
    index: Path | None = INDEX,
    as_json: bool = AS_JSON,
) -> None:
    """List the runs of a directory, oldest first, with the parameters that differ among those of a protocol."""
    from leactl.report.run_list import run_list
    from leactl.runfile.catalog.run_index import list_runs as read_summaries
    from leactl.runfile.catalog.selection import ordered, selection_of

    summaries = read_summaries(directory, index, print_remark)
    selection = selection_of(
        summaries,
        protocol=protocol,
        actuator=actuator,
        condition=condition,
        status=status,
        since=since,
        until=until,
        where=where,
    )
    shown_runs = [run for run in ordered(summaries, sort) if selection.empty or selection.fits(run)]
    shown_runs = shown_runs[::-1] if reverse else shown_runs
    unreadable_count = 0 if selection.empty else sum(bool(run.fault) for run in summaries)
    if as_json:
        typer.echo(json.dumps({"runs": [run.as_json() for run in shown_runs]}, allow_nan=False))
    else:
        typer.echo(run_list(shown_runs, summaries, {*selection.where, sort}), nl=False)
    if unreadable_count:
        print_remark(f"{unreadable_count} of {len(summaries)} files cannot be read and are left out")
    if summaries and not shown_runs:
        print_remark(f"none of {len(summaries)} runs in {directory} is what was asked for")


@app.command("index", epilog=examples("runs index runs", "runs index archive --index archive.sqlite --processes 2"))
def index_runs(
    directory: Path = typer.Argument(Path("runs")),
    index: Path | None = INDEX,
    processes: int = PROCESSES,
    as_json: bool = AS_JSON,
) -> None:
    """Make the index of a directory or bring it up to date: only files that are new or changed are opened."""
    from leactl.processes import Workers
    from leactl.report.progress_line import ProgressLine
    from leactl.report.run_list import run_list
    from leactl.runfile.catalog.run_index import update

    with ProgressLine() as step, Workers(processes) as workers:
        path, catalogue = update(directory, index, print_remark, workers, step)
    faulty_runs = [run for run in catalogue.runs if run.fault]
    if as_json:
        index_json = {"index": str(path), "files": len(catalogue.rows), "read": catalogue.read, "gone": catalogue.gone}
        faulty_json = [{"file": run.file, "fault": run.fault} for run in faulty_runs]
        typer.echo(json.dumps(index_json | {"unreadable": faulty_json}))
        return
    counts = f"{catalogue.read} read, {catalogue.gone} gone, {len(faulty_runs)} unreadable"
    typer.echo(f"{path}: {len(catalogue.rows)} files, {counts}")
    typer.echo(run_list(faulty_runs, faulty_runs, ()), nl=False)


@app.command(
    "tag",
    epilog=examples("runs tag RUN.h5 paper", "runs tag runs paper --remove"),
)
def tag_runs(
    runs: list[Path] = typer.Argument(..., metavar="RUN...", help="Run files, or folders of them."),
    tag: str = typer.Argument(..., metavar="TAG", help="Word such as paper."),
    remove: bool = typer.Option(False, "--remove", help="Take the tag from the runs."),
    as_json: bool = AS_JSON,
) -> None:
    """Tag runs with a word to find them by; it stands in tags.json beside them, and the run files stay as they are."""
    from leactl.runfile.catalog.summaries import run_files
    from leactl.runfile.catalog.tags import change_tags

    tagged_runs = change_tags(run_files(runs), tag, remove)
    if as_json:
        typer.echo(json.dumps({"runs": [{"run": str(run.path), "tags": list(run.tags)} for run in tagged_runs]}))
        return
    for run in tagged_runs:
        typer.echo(f"{run.path}: {', '.join(run.tags) or 'no tags'}")


@app.command(
    epilog=examples("runs trend torque_constant runs", "runs trend coulomb_friction --actuator LEA-1 --baseline 12")
)
def trend(
    result: str = typer.Argument(help="Name of a result, such as coulomb_friction."),
    runs: list[Path] = typer.Argument(None, metavar="[RUN]...", help="Run files or folders; by default runs."),
    actuator: str = typer.Option("", help="Only runs of this actuator."),
    condition: str = typer.Option("", help="Only runs under this condition."),
    baseline: int | None = typer.Option(
        None, "--baseline", min=8, metavar="N", help="Let limits rest on the first N values; by default on all."
    ),
    settings: list[str] = typer.Option(
        [], "--set", metavar="NAME=NUMBER", help="Set a numeric option of the analysis, such as torque_constant=0.49."
    ),
    processes: int = PROCESSES,
    scheduler: str = SCHEDULER,
    as_json: bool = AS_JSON,
) -> None:
    """Follow a result from run to run, with control limits: has this actuator changed?"""
    from leactl.analysis.analyze import numeric_options
    from leactl.analysis.trend import trend as trend_of
    from leactl.report.progress_line import ProgressLine
    from leactl.report.terminal import encoding_of_stdout
    from leactl.report.trend import trend_text
    from leactl.runfile.catalog.summaries import run_files
    from leactl.scheduler import workers_of

    options = numeric_options(settings)
    with ProgressLine() as step, workers_of(processes, scheduler) as workers:
        paths = run_files(runs or [Path("runs")])
        result_trend = trend_of(paths, result, actuator, condition, baseline, step, workers, **options)
    typer.echo(
        json.dumps(result_trend.as_json(), allow_nan=False)
        if as_json
        else trend_text(result_trend, encoding_of_stdout())
    )


@app.command(epilog=examples("runs show RUN.h5"))
def show(run: Path, as_json: bool = AS_JSON) -> None:
    """Show what a run holds: attributes, streams with units, steps, events and notes."""
    from leactl.report.terminal import list_line
    from leactl.runfile.read.bisections import searches
    from leactl.runfile.read.reader import Run

    with Run.open(run) as open_run:
        attributes = {name: str(value) for name, value in open_run.attributes.items()} | {
            "mechanical": open_run.mechanical
        }
        streams = {
            name: {
                "rows": open_run.rows[name],
                **({"attached": open_run.attached(name)} if open_run.attached(name) else {}),
                "channels": [
                    {"name": spec.name, "quantity": spec.quantity, "role": spec.role, "units": spec.unit}
                    for spec in channels
                ],
            }
            for name, channels in open_run.streams.items()
        }
        steps, events, notes = open_run.steps, open_run.events, open_run.notes
        parameters, instruments = open_run.parameters, open_run.instruments
    if as_json:
        answer = {
            "attributes": attributes,
            "parameters": parameters,
            "instruments": instruments,
            "streams": streams,
            "steps": len(steps),
            "searches": [vars(search) for search in searches(steps)],
            "events": [vars(event) for event in events],
            "notes": [vars(note) for note in notes],
        }
        typer.echo(json.dumps(answer))
        return
    for name, value in attributes.items():
        typer.echo(f"{name:<16} {value}".rstrip())
    for name, value in parameters.items():
        typer.echo(list_line(f"parameter {name} = ", str(value)))
    for name, facts in instruments.items():
        typer.echo(list_line(f"instrument {name}: ", ", ".join(f"{key} {fact}" for key, fact in facts.items())))
    for name, stream in streams.items():
        typer.echo(f"stream {name}: {stream['rows']} rows{attachment_note(stream)}")
        for channel in open_run.streams[name]:
            typer.echo(f"  {channel.name:<12} {channel.role:<6} {channel.quantity:<26} {channel.unit}")
    for search in searches(steps):
        typer.echo(list_line("", str(search)))
    typer.echo(f"{len(steps)} steps, {len(events)} events")
    for event in events:
        typer.echo(list_line(f"  {event.time:10.3f} s  {event.level:<8} ", f"{event.source}: {event.message}"))
    for note in notes:
        typer.echo(list_line(f"note {note.time} ", f"{note.author}: {note.text}"))


@app.command(
    epilog=examples(
        "runs verify runs", "runs verify RUN.h5 --json", means={InputError: "a run is not so or cannot be read"}
    )
)
def verify(
    runs: list[Path] = typer.Argument(..., metavar="RUN...", help="Run files, or folders of them."),
    processes: int = PROCESSES,
    scheduler: str = SCHEDULER,
    as_json: bool = AS_JSON,
) -> None:
    """Check that runs are whole and as they were closed: values, names and attributes."""
    from leactl.runfile.catalog.summaries import run_files
    from leactl.runfile.verify.integrity import examine
    from leactl.scheduler import workers_of

    paths = run_files(runs)
    examinations_json, findings, unsound_count = [], [], 0
    with workers_of(processes, scheduler) as workers:
        for job in workers.in_order(examine, [(path,) for path in paths]):
            examination = job.value()
            findings += examination.findings
            unsound_count += bool(examination.findings)
            if as_json:
                examinations_json.append(examination.as_json())
            elif not examination.findings:
                typer.echo(f"{examination.path}: {examination.summary}")
    if as_json:
        is_list = len(runs) > 1 or runs[0].is_dir()
        typer.echo(json.dumps({"runs": examinations_json} if is_list else examinations_json[0]))
    if findings and len(paths) > 1:
        findings.append(f"{unsound_count} of {len(paths)} runs are not sound")
    if findings:
        raise InputError(findings)


@app.command(epilog=examples("runs recover RUN.h5"))
def recover(run: Path, as_json: bool = AS_JSON) -> None:
    """Write a clean copy of a run whose recording was cut off; the original stays."""
    from leactl.runfile.verify.integrity import recover as clean_copy

    copy = clean_copy(run)
    typer.echo(json.dumps({"run": str(copy), "status": "recovered"}) if as_json else str(copy))


@app.command(epilog=examples("runs convert runs/*.h5"))
def convert(runs: list[Path] = typer.Argument(..., metavar="RUN..."), as_json: bool = AS_JSON) -> None:
    """Rewrite runs of a newer HDF5 format so that HDF5 1.10, MATLAB and older h5py read them; values stay."""
    from leactl.runfile.verify.conversion import convert as rewrite

    for run in runs:
        rewrite(run)
    typer.echo(json.dumps({"runs": [str(run) for run in runs]}) if as_json else "\n".join(map(str, runs)))


@app.command(epilog=examples('runs annotate RUN.h5 "bearing greased" --author ana'))
def annotate(
    run: Path, text: str, author: str = typer.Option("", help="Author of the note."), as_json: bool = AS_JSON
) -> None:
    """Add a note to a run; its data stay as they are, and that is checked."""
    from leactl.runfile.read.reader import Run
    from leactl.runfile.verify.integrity import annotate as add_note

    add_note(run, text, author)
    if as_json:
        with Run.open(run) as open_run:
            typer.echo(json.dumps({"run": str(run), "note": vars(open_run.notes[-1])}))


@app.command(epilog=examples("runs attach RUN.h5 camera.csv --device camera --check"))
def attach(
    run: Path,
    files: list[Path] = typer.Argument(..., metavar="FILE...", help="One record: an export, or its parts in order."),
    device: str = typer.Option(..., help="The device of the bench file that the record is of."),
    bench: Path | None = typer.Option(None, help="YAML file whose devices say so; the run's own by default."),
    check: bool = typer.Option(False, "--check", help="Read and align, tell what was found, change nothing."),
    replace: bool = typer.Option(False, "--replace", help="Take the place of an attached record of this device."),
    as_json: bool = AS_JSON,
) -> None:
    """Attach a record of another program to a run, on the run's clock; what the run holds stays as it is."""
    from leactl import yamlfile
    from leactl.bench.records import RecordDevice, bench_of_run

    record_device = RecordDevice(yamlfile.load(bench) if bench else bench_of_run(run), device)
    attachment = record_device.join(record_device.read(files), run)
    if not check:
        record_device.attach(attachment, run, replace)
    if as_json:
        typer.echo(json.dumps(attachment.as_json() | {"run": str(run), "attached": not check}))
    else:
        typer.echo("\n".join(attachment.summary_lines()))


@app.command(epilog=examples("runs export RUN.h5 --format csv --out csv"))
def export(
    run: Path,
    to: str = typer.Option("csv", "--format", help="csv, mat or parquet."),
    out: Path = typer.Option(Path(), help="Directory for the files."),
    as_json: bool = AS_JSON,
) -> None:
    """Write a run's streams as CSV, MAT or Parquet; nothing is overwritten."""
    from leactl.runfile.export import export as write_files

    files = [str(path) for path in write_files(run, to, out)]
    typer.echo(json.dumps({"files": files}) if as_json else "\n".join(files))


@app.command(
    "import",
    epilog=examples(
        "runs import log.csv --map map.yaml --check",
        "runs import log.csv --map map.yaml --out imported",
        "runs import log.mcap --map auto --map-out map.yaml",
        means={InputError: "input that cannot be used or a proposed mapping with open questions"},
    ),
)
def import_foreign(
    sources: list[str] = typer.Argument(..., metavar="SOURCE...", help="Logs of a format that is known, or patterns."),
    mapping: Path = typer.Option(
        ..., "--map", help="YAML file that says which column is which channel; auto proposes one and asks."
    ),
    map_out: Path | None = typer.Option(
        None, "--map-out", metavar="FILE", help="With --map auto: write the mapping here as well."
    ),
    joint: list[str] = typer.Option(
        [], "--joint", metavar="NAME", help="Joint that {joint} in the mapping stands for, a run each; or all."
    ),
    out: Path = typer.Option(Path("runs"), "--out", help="Directory for the run files."),
    check: bool = typer.Option(False, "--check", help="Read everything, tell what would be written, write nothing."),
    as_json: bool = AS_JSON,
) -> None:
    """Import recordings of other rigs as run files; all sources are checked first, and nothing is overwritten."""
    from leactl import yamlfile
    from leactl.runfile.importing.importer import read_by_mapping, targets_of, write_runs
    from leactl.runfile.importing.preview import preview, preview_lines

    if map_out is not None and str(mapping) != AUTO:
        raise InputError(f"--map-out {map_out}: goes with --map {AUTO}")
    document = propose_mapping(sources, map_out, as_json) if str(mapping) == AUTO else yamlfile.load(mapping)
    runs = read_by_mapping(sources, document, joint)
    files = targets_of(runs, out) if check else write_runs(runs, out)
    previews = [preview(run, file) for run, file in zip(runs, files, strict=True)] if check else []
    notes = list(dict.fromkeys(note for run in runs for note in run.notes))
    if as_json:
        body = {"files": [str(file) for file in files], "written": not check, "notes": notes}
        typer.echo(json.dumps(body | ({"runs": previews} if check else {}), allow_nan=False))
        return
    for note in notes:
        typer.echo(f"note: {note}", err=True)
    lines = [line for run_preview in previews for line in preview_lines(run_preview)] if check else map(str, files)
    typer.echo("\n".join(lines))


def propose_mapping(sources: list[str], map_out: Path | None, as_json: bool) -> "yamlfile.Document":
    """Propose a mapping for the first source, and ask the user its open questions if there is a terminal.

    Raises
    ------
    InputError : questions stay open because there is no terminal; the proposal is in `map_out`, or on stdout.
    """
    from leactl import yamlfile
    from leactl.cli.mapping_questions import ask_open_questions, is_attended
    from leactl.runfile.importing.importer import expand_patterns
    from leactl.runfile.importing.proposal.proposal import propose
    from leactl.runfile.importing.proposal.survey import survey
    from leactl.runfile.publish import new_file, refuse_existing

    if map_out is not None:
        refuse_existing(map_out)
    source_survey = survey(expand_patterns(sources)[0])
    proposal = ask_open_questions(source_survey) if is_attended() else propose(source_survey, {})
    if map_out is not None:
        with new_file(map_out) as file:
            file.write_text(proposal.text, encoding="utf-8")
    if proposal.questions:
        if map_out is None and not as_json:
            typer.echo(proposal.text, nl=False)
        name = map_out or "the proposal"
        raise InputError([f"{name}: open: {question.text}" for question in proposal.questions])
    return yamlfile.parse(proposal.text, str(map_out or AUTO))


def attachment_note(stream: dict[str, Any]) -> str:
    """Return a text on the source files and the time uncertainty of an attached stream; empty for a recorded stream."""
    if "attached" not in stream:
        return ""
    provenance = stream["attached"]
    accuracy_text = f"stamps good to {provenance['alignment_uncertainty_s']:.2g} s (95 %)"
    return f", attached from {provenance['record_files']}, {accuracy_text} by {provenance['alignment_method']}"


@app.command(epilog=examples("runs plot RUN.h5 torque test_iq", "runs plot RUN.h5 torque --html plot.html"))
def plot(
    run: Path,
    channels: list[str] = typer.Argument(
        None, metavar="[CHANNEL]...", help="Name, stream/name, quantity or quantity:role; every channel by default."
    ),
    step: str = typer.Option("", metavar="NAME", help="Only from the first step of this name to its last."),
    start: float | None = typer.Option(
        None, "--from", metavar="SECONDS", help="Only from this time on.", callback=finite
    ),
    stop: float | None = typer.Option(None, "--to", metavar="SECONDS", help="Only up to this time.", callback=finite),
    html: Path | None = typer.Option(None, "--html", metavar="FILE", help="Write a page that zooms instead."),
    as_json: bool = AS_JSON,
) -> None:
    """Plot channels over time, steps shaded: in the terminal, or as a page with --html."""
    import shutil

    from leactl.report import outputs
    from leactl.report.run_page import MOST_BINS, page
    from leactl.report.run_plot import panels_text
    from leactl.runfile.publish import replacement
    from leactl.runfile.read.reader import Run
    from leactl.runfile.read.traces import channel_names, channel_trace, part_of_run

    if html:
        outputs.check_files([html], [run])
    columns, rows = shutil.get_terminal_size((80, 24))
    with Run.open(run) as open_run:
        time_span = part_of_run(open_run, step, start, stop)
        bins = MOST_BINS if html or as_json else 2 * columns
        traces = [channel_trace(open_run, name, *time_span, bins) for name in channel_names(open_run, channels or [])]
        if html:
            with replacement(html) as path:
                path.write_text(page(open_run, traces, *time_span), encoding="utf-8")
        steps = open_run.steps
    if as_json:
        body = {"run": str(run), "start_s": time_span[0], "stop_s": time_span[1], "page": str(html) if html else None}
        typer.echo(json.dumps(body | {"channels": [trace.as_json() for trace in traces]}, allow_nan=False))
    elif html:
        typer.echo(str(html))
    else:
        typer.echo(panels_text(traces, steps, time_span, columns, rows), nl=False)


@app.command(
    epilog=examples("runs tail RUN.h5", "runs tail RUN.h5 torque test_iq --follow --every 1", "runs tail RUN.h5 --json")
)
def tail(
    run: Path,
    channels: list[str] = typer.Argument(
        None,
        metavar="[CHANNEL]...",
        help="Channels as in `runs plot`; by default those of the stream with most channels.",
    ),
    rows: int = typer.Option(10, "--rows", min=0, help="Rows of each stream that are printed first."),
    follow: bool = typer.Option(False, "--follow", help="Go on with what is added, until the run ends or Ctrl-C."),
    every: float = typer.Option(
        0.0, "--every", min=0.0, metavar="SECONDS", help="At most one row of a stream in this time.", callback=finite
    ),
    as_json: bool = typer.Option(False, "--json", help="Print a line of JSON for each row on stdout."),
) -> None:
    """Print the last rows of a run, also of one that is being recorded; --follow prints them as they come."""
    import shutil
    import sys
    import time

    from leactl.report.run_tail import RowFormatter
    from leactl.report.terminal import duration
    from leactl.runfile.read.tail import RunTail, thinned

    run_tail = RunTail(run, channels or [], rows)
    formatter = RowFormatter(shutil.get_terminal_size().columns if sys.stdout.isatty() else None)
    shown_until: dict[str, float] = {}
    narrow_streams: set[str] = set()  # those of which it was said that channels have no room
    has_warned = False
    if run_tail.other_streams and not (channels or as_json):
        print_remark(
            f"other streams: {', '.join(run_tail.other_streams)}; name channels to see theirs (runs show has them)"
        )
    while True:
        start_s = time.monotonic()
        new_rows = run_tail.read()
        read_duration_s = time.monotonic() - start_s
        for rows_of_stream in new_rows:
            shown_rows = thinned(rows_of_stream, every, shown_until)
            lines = map(json.dumps, shown_rows.as_json()) if as_json else formatter.lines(shown_rows)
            for line in lines:
                typer.echo(line)
            sys.stdout.flush()
        for stream, omitted_channels in formatter.omitted_channels.items():
            if omitted_channels and stream not in narrow_streams:
                narrow_streams.add(stream)
                print_remark(
                    f"no room for {', '.join(omitted_channels)}: name the channels to see, or widen the terminal"
                )
        unwritten_s = run_tail.unwritten_s() if run_tail.is_recording else 0.0
        if unwritten_s > UNWRITTEN_S and not has_warned:
            silence_text = f"not written for {duration(unwritten_s)}"
            print_remark(f"{run}: {silence_text}; if its run was killed, no row will come: leactl runs recover {run}")
        has_warned = unwritten_s > UNWRITTEN_S
        if not (follow and run_tail.is_recording):
            break
        time.sleep(max(POLL_S, read_duration_s / BUSY_SHARE))
    if follow:
        print_remark(f"{run}: {run_tail.status_text}")
