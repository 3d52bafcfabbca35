"""`leactl gap`: where, why and by how much a simulator and a bench disagree."""

import json
from pathlib import Path

import typer

app = typer.Typer(help="Diagnose the gap between model and bench.", no_args_is_help=True, rich_markup_mode=None)
blind = typer.Typer(help="Check the diagnosis on causes nobody told it.", no_args_is_help=True, rich_markup_mode=None)
app.add_typer(blind, name="blind")
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")


@blind.command("make")
def make_blind(
    cases: int = typer.Option(..., "--cases", help="How many cases to draw."),
    out: Path = typer.Option(..., "--out", help="New folder for runs, nominal models and the key's hash."),
    key: Path | None = typer.Option(None, "--key", help="New folder for the key; by default OUT with -key at its end."),
    seed: int | None = typer.Option(None, "--seed", min=0, help="Draw the same cases again; by default fresh entropy."),
    kinds: list[str] = typer.Option([], "--kinds", help="Only these of none, single, pair, unknown; may be repeated."),
    as_json: bool = AS_JSON,
) -> None:
    """Draw benches with unknown departures from their nominal model, and write their runs, the key apart from them."""
    from leactl.emulation.blind.draws import KINDS
    from leactl.emulation.blind.make import make

    key_dir = key or out.with_name(f"{out.name}-key")
    digest = make(cases, out, key_dir, seed=seed, kinds=kinds or KINDS)
    if as_json:
        typer.echo(json.dumps({"cases": cases, "out": str(out), "key": str(key_dir), "key_sha256": digest}))
        return
    typer.echo(f"{cases} cases in {out}; their key in {key_dir}, SHA-256 {digest}")
