"""`leactl protocol`: list, show and check protocol files."""

import json
from typing import TYPE_CHECKING

import typer

from leactl.cli.completion import complete_bench, complete_protocol, complete_setting
from leactl.cli.helptext import examples, group_of_commands

if TYPE_CHECKING:
    from leactl.protocol.plan import Plan

app = group_of_commands()
STDIN = "<stdin>"  # name of the file in faults of a protocol from stdin
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")
SHIPPED = typer.Argument(help="Name of a shipped protocol, or a path to a .yaml.", autocompletion=complete_protocol)
SET = typer.Option(
    [],
    "--set",
    metavar="NAME=VALUE",
    help="Value of a parameter; a list as [1, 2]. May be repeated.",
    autocompletion=complete_setting,
)
CONDITION = typer.Option("", "--condition", metavar="LABEL", help="Take the protocol's parameters of this condition.")
BENCH = typer.Option(
    "", "--bench", help="Check the setpoints against this bench's limits.", autocompletion=complete_bench
)


@app.command("list", epilog=examples("protocol list"))
def list_protocols(as_json: bool = AS_JSON) -> None:
    """List the protocols that ship with leactl."""
    from leactl.protocol.listing import listed_protocols
    from leactl.report.terminal import duration, list_line

    protocols = listed_protocols()
    if as_json:
        typer.echo(json.dumps({"protocols": [protocol._asdict() for protocol in protocols]}))
        return
    width = max(len(protocol.name) for protocol in protocols)
    for protocol in protocols:
        duration_text = duration(protocol.duration_s, always_hours=True)
        typer.echo(list_line(f"{protocol.name:<{width}}  {protocol.setup:<8} {duration_text:>10}  ", protocol.title))


@app.command(epilog=examples("protocol show friction > mine.yaml"))
def show(name: str = SHIPPED, as_json: bool = AS_JSON) -> None:
    """Show a protocol's file as it is written, to copy and change."""
    from leactl.protocol.protocolfile import load
    from leactl.report.plan import head

    plan = load(name)
    typer.echo(json.dumps({**head(plan), "text": plan.text}) if as_json else plan.text, nl=as_json)


@app.command(epilog=examples("protocol check mine.yaml", "protocol check - < mine.yaml"))
def check(
    protocol: str = typer.Argument(
        help="Name of a shipped protocol, a path to a .yaml, or - for stdin.", autocompletion=complete_protocol
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Check a protocol: every fault with file, line and column."""
    from leactl import yamlfile
    from leactl.protocol.parameters import unused
    from leactl.report.plan import head, peaks, searches
    from leactl.report.terminal import duration

    plan = _checked(protocol)
    notes = unused(yamlfile.parse(plan.text, protocol))
    if as_json:
        body = {**head(plan), "peaks": peaks(plan), "actions": len(plan.actions), "notes": notes}
        body |= {"searches": searches(plan)}
        typer.echo(json.dumps(body))
        return
    for note in notes:
        typer.echo(f"note: {note}", err=True)
    for line in searches(plan):
        typer.echo(line)
    duration_text = f"{'at most ' if plan.adaptive else ''}{duration(plan.duration_s, always_hours=True)}"
    typer.echo(f"{plan.name}: {len(plan.actions)} actions, {duration_text}, no faults")


@app.command(epilog=examples("protocol plan friction", "protocol plan mine.yaml --bench emulated --set hold_s=6"))
def plan(
    protocol: str = SHIPPED,
    overrides: list[str] = SET,
    condition: str = CONDITION,
    bench: str = BENCH,
    as_json: bool = AS_JSON,
) -> None:
    """Print the expanded timeline with duration and peak values; nothing moves."""
    from leactl.protocol.protocolfile import load, read_overrides
    from leactl.report.plan import head, hottest, peaks, plan_lines, searches

    expanded = load(protocol, read_overrides(overrides), condition)
    hottest_degc: dict[str, float] = {}
    crossing_text, limits, slow_rate_note = "", None, ""
    left_on_texts: list[str] = []
    one_sensor_texts: list[str] = []
    if bench:
        from leactl.bench.bench import Bench
        from leactl.bench.benchfile import host_silences, supplies_of
        from leactl.bench.wiring import MachineWiring
        from leactl.runner.checked_bench import load_checked
        from leactl.runner.plan_needs import check_plan_needs, windings_without_second_sensor
        from leactl.runner.thermal_admission import Windings, standing_text
        from leactl.runner.unattended_supply import supplies_left_on
        from leactl.safety.plan_checks import check_rate

        file, devices, _document = load_checked(bench)
        if file.emulated is not None:
            file.emulated.expect(condition)
        machine_bench = Bench(file, devices, MachineWiring())
        check_plan_needs(expanded, machine_bench)
        one_sensor_texts = windings_without_second_sensor(expanded, machine_bench)
        check_rate(expanded.rate_Hz, host_silences(devices), supplies_of(devices))
        limits = file.limits
        windings = Windings(file, devices, "", cold=True)
        forecast = windings.forecast(expanded)
        left_on_texts = [supply.summary for supply in supplies_left_on(expanded, windings, machine_bench)]
        hottest_degc = hottest(forecast)
        if forecast.turning_from_hz is not None:
            slow_rate_note = f"{standing_text(forecast.turning_from_hz)}; rate_Hz is {expanded.rate_Hz:g}"
        crossing_text = (
            "" if forecast.passing is None else f", up to step '{forecast.passing.step}', where the limit may be passed"
        )
    if as_json:
        rows = [row._asdict() for row in expanded.timeline()]
        body = {**head(expanded), "peaks": peaks(expanded, limits), "timeline": rows, "searches": searches(expanded)}
        if bench:
            body |= {
                "hottest_degC": hottest_degc,
                "hottest_up_to": "" if forecast.passing is None else forecast.passing.step,
                "left_on": left_on_texts,
                "one_sensor": one_sensor_texts,
                "rate_note": slow_rate_note,
            }
        typer.echo(json.dumps(body))
        return
    typer.echo("\n".join(plan_lines(expanded, limits)))
    for role, value in hottest_degc.items():
        typer.echo(f"winding {role} at most {value:g} degC from ambient{crossing_text}; see: leactl thermal plan")
    for line in [*left_on_texts, *one_sensor_texts]:
        typer.echo(line)
    if slow_rate_note:
        typer.echo(f"note: {slow_rate_note}", err=True)


def _checked(protocol: str) -> "Plan":
    """Load a protocol, check its acceptance limits, and return its plan.

    In a protocol from stdin, paths of CSV files are relative to the working folder.
    """
    import sys
    from pathlib import Path

    from leactl import yamlfile
    from leactl.protocol.protocolfile import NO_OVERRIDES, expand_document, load, locate
    from leactl.runner.acceptance import check_analysis

    if protocol == "-":
        document = yamlfile.decoded(sys.stdin.buffer.read(yamlfile.MAX_BYTES + 1), STDIN)
        plan = expand_document(document, Path(), NO_OVERRIDES, "")
        check_analysis(plan, STDIN)
    else:
        plan = load(protocol)
        check_analysis(plan, str(locate(protocol)))
    return plan
