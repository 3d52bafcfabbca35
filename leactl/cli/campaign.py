"""`leactl campaign`: many runs in sequence, resumable after an interruption."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from leactl.cli import print_answer
from leactl.cli.completion import complete_campaign
from leactl.cli.helptext import ON_A_BENCH, WholeSentences, examples, group_of_commands
from leactl.cli.run import perform
from leactl.errors import AcceptanceFailed, Stopped

if TYPE_CHECKING:
    from leactl.runner.campaign.campaignfile import Campaign
    from leactl.runner.campaign.entries import CampaignEntry


class RunByDefault(WholeSentences):
    """A command group that reads `leactl campaign CAMPAIGN` as `leactl campaign run CAMPAIGN`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the command `run` before a first word that is no command, and parse."""
        has_command = args and args[0] in (*self.commands, *ctx.help_option_names)
        return super().parse_args(ctx, args if has_command or not args else ["run", *args])

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Complete the names of commands, and the first argument of `run`."""
        argument = next(param for param in self.commands["run"].params if param.param_type_name == "argument")
        return [*super().shell_complete(ctx, incomplete), *argument.shell_complete(ctx, incomplete)]


app = group_of_commands(RunByDefault)
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")
CAMPAIGN = typer.Argument(
    metavar="CAMPAIGN", help="Name of a shipped campaign, or a path to a .yaml.", autocompletion=complete_campaign
)
VARIANT = typer.Option("", help="Take the campaign's variant of this name.")
SEED = typer.Option(None, min=0, max=2**63 - 1, help="Seed instead of the campaign's.")
OUT = typer.Option(None, help="Folder of the campaign; runs/NAME or runs/NAME-VARIANT where left out.")


@app.command("list", epilog=examples("campaign list"))
def list_campaigns(as_json: bool = AS_JSON) -> None:
    """List the campaigns that ship with leactl."""
    from leactl.report.terminal import list_line
    from leactl.runner.campaign.campaignfile import load, names

    campaigns = [load(name) for name in names()]
    if as_json:
        rows = [{"name": campaign.name, "title": campaign.title, "runs": len(campaign.cells)} for campaign in campaigns]
        typer.echo(json.dumps({"campaigns": rows}))
        return
    width = max(len(campaign.name) for campaign in campaigns)
    for campaign in campaigns:
        typer.echo(list_line(f"{campaign.name:<{width}}  {len(campaign.cells):3d} runs  ", campaign.title))


@app.command(epilog=examples("campaign show paper"))
def show(name: str = CAMPAIGN, as_json: bool = AS_JSON) -> None:
    """Show a campaign's file as it is written, to copy and change."""
    from leactl.runner.campaign.campaignfile import load

    campaign = load(name)
    answer = {"name": campaign.name, "title": campaign.title, "runs": len(campaign.cells), "text": campaign.text}
    typer.echo(json.dumps(answer) if as_json else campaign.text, nl=as_json)


@app.command(epilog=examples("campaign status paper --out runs/paper"))
def status(
    name: str = CAMPAIGN,
    variant: str = VARIANT,
    seed: int | None = SEED,
    out: Path | None = OUT,
    as_json: bool = AS_JSON,
) -> None:
    """Show which runs of a campaign are finished, which are left, and what is wrong with its folder."""
    from leactl.report.campaign import campaign_state_text
    from leactl.runner.campaign.folder import busy, journal_and_progress

    campaign, folder, entries = _read_campaign(name, variant, seed, out)
    journal, progress = journal_and_progress(campaign, entries, folder)
    body = {
        "campaign": campaign.name,
        "variant": campaign.variant,
        "folder": str(folder),
        "under_way": busy(folder),
        "finished": len(progress.finished.keys() & {entry.cell.key for entry in entries}),
        "runs": [
            _run_json(entry)
            | {
                "finished": entry.cell.key in progress.finished,
                "file": str(run_file.path) if (run_file := progress.finished.get(entry.cell.key)) else None,
                "unmet": list(finished_run.unmet) if (finished_run := journal.finished.get(entry.cell.key)) else [],
            }
            for entry in entries
        ],
        "lost": dict(progress.lost),
        "changed": list(progress.changed),
        "unfinished": [str(run_file.path) for run_file in progress.unfinished],
    }
    typer.echo(json.dumps(body) if as_json else campaign_state_text(body))


@app.command(
    epilog=examples(
        "campaign paper --variant short --out runs/paper",
        "campaign run paper --out runs/paper --dry-run",
        ends=(*ON_A_BENCH, AcceptanceFailed),
        means={Stopped: "stopped by a person or a prompt that nobody answers"},
    )
)
def run(
    name: str = CAMPAIGN,
    variant: str = VARIANT,
    seed: int | None = SEED,
    out: Path | None = OUT,
    dry_run: bool = typer.Option(False, "--dry-run", help="Check everything, print the plan, and move nothing."),
    operator: str = typer.Option("", help="Who runs the benches."),
    yes: bool = typer.Option(False, "--yes", help="What the first prompt asks for is mounted; a change asks again."),
    cold: bool = typer.Option(False, "--cold", help="Nothing has heated the actuators since they were at ambient."),
    redo_lost: bool = typer.Option(False, "--redo-lost", help="Make runs again whose files are missing or damaged."),
    accept_changes: bool = typer.Option(
        False, "--accept-changes", help="Go on where the campaign was changed in runs that are not finished."
    ),
    realtime: bool = typer.Option(False, "--realtime", help="Keep wall time on emulated benches."),
    served: bool = typer.Option(False, "--served", help="Meet emulated benches that another process serves."),
    bus: list[str] = typer.Option([], metavar="NAME=INTERFACE:CHANNEL", help="Put a bus elsewhere."),
    as_json: bool = AS_JSON,
) -> None:
    """Begin a campaign or go on with it."""
    from leactl.errors import AcceptanceFailed
    from leactl.report.campaign import demands, plan_text
    from leactl.report.outputs import check_folder
    from leactl.runner.campaign.conduct import CampaignOptions, conduct
    from leactl.runner.campaign.entries import previews
    from leactl.runner.campaign.folder import resumable
    from leactl.runner.stop_requests import signals_kept_to_the_end

    campaign, folder, entries = _read_campaign(name, variant, seed, out, operator, realtime, served, bus)
    if dry_run:
        check_folder(folder)
        _journal, progress = resumable(campaign, entries, folder, accept_changes, redo_lost)
        preview_by_cell = previews(entries)
        rows = [
            _run_json(entry)
            | demands(preview_by_cell[entry.cell.step, entry.cell.condition])
            | {"finished": entry.cell.key in progress.finished}
            for entry in entries
        ]
        body = {"campaign": campaign.name, "variant": variant, "seed": campaign.seed, "folder": str(folder)}
        typer.echo(json.dumps(body | {"runs": rows}) if as_json else plan_text(campaign.title, body | {"runs": rows}))
        return
    attended = sys.stdin is not None and sys.stdin.isatty()
    options = CampaignOptions(perform, _tell, attended, yes, cold, redo_lost, accept_changes)
    with signals_kept_to_the_end():
        ending = conduct(campaign, entries, folder, options)
    finished_count = len(ending.journal.finished)
    files = {key: str(folder / f"{finished_run.run_id}.h5") for key, finished_run in ending.journal.finished.items()}
    if as_json:
        campaign_json = {"campaign": campaign.name, "variant": variant, "folder": str(folder)}
        reason = str(ending.error).splitlines()[0] if ending.error else ""
        counts = {"finished": finished_count, "of": ending.total}
        body = campaign_json | counts | {"reason": reason, "files": files, "unmet": ending.unmet}
        stdout_error = print_answer(json.dumps(body))
    else:
        hint = "" if finished_count == ending.total else "; the same command goes on"
        stdout_error = print_answer(f"{finished_count} of {ending.total} runs are finished in {folder}{hint}")
    if ending.error is not None:
        raise ending.error
    if ending.unmet:
        raise AcceptanceFailed("; ".join(ending.unmet))
    if stdout_error is not None:
        raise stdout_error


def _read_campaign(
    name: str,
    variant: str,
    seed: int | None,
    out: Path | None,
    operator: str = "",
    realtime: bool = False,
    served: bool = False,
    buses: Sequence[str] = (),
) -> "tuple[Campaign, Path, list[CampaignEntry]]":
    """Return the campaign of a name and variant, its folder, and its runs as entries."""
    from leactl.runner.campaign.campaignfile import load
    from leactl.runner.campaign.entries import EntryOptions, entries_of

    campaign = load(name, variant, seed)
    folder = out or Path("runs") / "-".join(filter(None, (campaign.name, variant)))
    return campaign, folder, entries_of(campaign, EntryOptions(folder, operator, realtime, served, buses))


def _run_json(entry: "CampaignEntry") -> dict[str, Any]:
    """Return what a run of a campaign measures, where, and what has to be mounted, as a JSON object."""
    cell, request = entry.cell, entry.request
    return {
        "run": cell.key,
        "step": cell.step,
        "protocol": request.plan.name,
        "bench": request.bench.name,
        "setup": request.plan.setup,
        "actuator": cell.actuator,
        "condition": cell.condition,
        "repeat": cell.repeat,
        "prompt": "" if request.bench.emulated is not None else entry.mounting_prompt,
    }


def _tell(text: str) -> None:
    """Print a message on stderr."""
    print(f"leactl: {text}", file=sys.stderr, flush=True)
