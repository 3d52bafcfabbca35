"""`leactl demo`: run two protocols on the emulated bench, and print the results beside the figures of the paper."""

import json
import sys
import time
from pathlib import Path

import typer

from leactl.cli.helptext import ON_A_BENCH, examples, single_command

app = single_command()

PROTOCOLS = ("torque-constant", "friction")
HEADLINES = ("torque_constant", "viscous_damping", "coulomb_friction")


@app.command(epilog=examples("demo", "demo --out demo --seed 7", ends=ON_A_BENCH))
def demo(
    out: Path = typer.Option(Path("leactl-demo"), help="Directory of the run files."),
    seed: int = typer.Option(1, min=0, help="Seed of the emulated bench."),
    as_json: bool = typer.Option(False, "--json", help="Print JSON on stdout."),
) -> None:
    """Characterise an emulated actuator: torque constant and friction in three preloads, beside the paper's figures."""
    from leactl.analysis.analyze import analyze_runs
    from leactl.cli.run import finish, perform
    from leactl.report.terminal import print_summary
    from leactl.runner.request import prepare

    start_s = time.monotonic()
    results, files = [], []
    for protocol in PROTOCOLS:
        paths = []
        for condition in ("unloaded", "design", "loaded"):
            print(f"{protocol}, {condition} ...", file=sys.stderr, flush=True)
            request = prepare(protocol, "emulated", [f"seed={seed}"], "demo", condition, "", out, realtime=False)
            outcome = perform(request)
            finish(outcome, [], None)
            paths.append(outcome.path)
        results.append(analyze_runs(paths))
        files += paths
    if as_json:
        answer = {"results": [result.as_json() for result in results], "files": [str(path) for path in files]}
        typer.echo(json.dumps(answer, allow_nan=False))
        return
    print_summary(results, HEADLINES)
    typer.echo("\n".join(["", *(f"wrote {path}" for path in files)]))
    typer.echo(f"\n{time.monotonic() - start_s:.0f} s in all; look closer: leactl analyze {files[1]}")
