"""`leactl schema`: the keys of the YAML files."""

import json
from enum import StrEnum

import typer


class Kind(StrEnum):
    """What a file describes."""

    PROTOCOL = "protocol"
    BENCH = "bench"
    MOTOR = "motor"
    CAMPAIGN = "campaign"
    MAPPING = "mapping"


def schema(
    kind: Kind = typer.Argument(help="Which kind of file."),
    table: bool = typer.Option(False, "--table", help="Print tables in Markdown instead, of protocol or bench."),
) -> None:
    """Print the JSON Schema of a kind of file, for editors and CI."""
    from leactl.errors import InputError
    from leactl.report.schema import TABLES, schema_of, tables_of

    if not table:
        typer.echo(json.dumps(schema_of(kind), indent=2))
    elif kind in TABLES:
        typer.echo(tables_of(kind), nl=False)
    else:
        raise InputError(f"--table: {kind} has none; one of {', '.join(TABLES)} was expected")
