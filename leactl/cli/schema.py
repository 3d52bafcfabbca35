"""`leactl schema`: the keys of the YAML files."""

import json
from enum import StrEnum

import typer

from leactl.cli.helptext import examples, single_command

app = single_command()


class Kind(StrEnum):
    """What a file describes."""

    PROTOCOL = "protocol"
    BENCH = "bench"
    MOTOR = "motor"
    MODEL = "model"
    CAMPAIGN = "campaign"
    MAPPING = "mapping"


@app.command(epilog=examples("schema protocol > protocol.schema.json", "schema bench --table"))
def schema(
    kind: Kind = typer.Argument(help="Which kind of file."),
    table: bool = typer.Option(False, "--table", help="Print tables in Markdown instead."),
) -> None:
    """Print the JSON Schema of a kind of file, for editors and CI."""
    from leactl.report.schema import schema_of, tables_of

    if table:
        typer.echo(tables_of(kind), nl=False)
    else:
        typer.echo(json.dumps(schema_of(kind), indent=2))
