"""The journal of a campaign: a JSON file that lists all runs, those that are finished and the one that is underway.

Only run files prove that a run is finished; the journal says which files there should be. If the journal is lost, each
run file still names its campaign and run. A journal is replaced as a whole or stays as it was.
"""

import json
from collections.abc import Container, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from leactl.errors import InputError
from leactl.runfile.publish import replacement
from leactl.runner.campaign.campaignfile import Campaign
from leactl.yamlblock import Block

JOURNAL_FILE = "campaign.json"
MOST_JOURNAL_BYTES = 1 << 24
Seconds = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Finished(Block):
    """A run that is complete."""

    run_id: str
    bench_s: Seconds = 0.0  # duration by the bench's clock; 0 if the process died before it wrote the journal
    wall_s: Seconds = 0.0
    unmet: tuple[str, ...] = ()  # acceptance limits of its protocol


class RunBegun(Block):
    """The run that is underway, and the id that its file is named after."""

    key: str
    run_id: str


class Journal(Block):
    """The content of the journal file; runs are identified by the keys of their cells."""

    format: Literal["leactl-campaign"] = "leactl-campaign"
    format_version: Literal[1] = 1
    campaign: str
    variant: str
    seed: int
    runs: dict[str, str]  # key: digest of every run, in order
    finished: dict[str, Finished] = {}
    underway: RunBegun | None = None

    def begun(self, key: str, run_id: str) -> "Journal":
        """Return the journal with a run underway."""
        return self.model_copy(update={"underway": RunBegun(key=key, run_id=run_id)})

    def ended(self, key: str, finished: Finished) -> "Journal":
        """Return the journal with a run finished and none underway."""
        return self.model_copy(update={"finished": self.finished | {key: finished}, "underway": None})

    def resumed(self, runs: dict[str, str], unjournaled: Mapping[str, Finished], finished: Container[str]) -> "Journal":
        """Return the journal of a campaign that is started again, with no run underway.

        Parameters
        ----------
        runs : digests by key of every run in order, as the campaign file is now.
        unjournaled : finished runs that the journal lacks, or lists with a file that is lost.
        finished : keys of all runs that have their files; all others are to be made again.
        """
        finished_runs = {key: run for key, run in {**self.finished, **unjournaled}.items() if key in finished}
        return self.model_copy(update={"runs": runs, "finished": finished_runs, "underway": None})


def new_journal(campaign: Campaign, runs: dict[str, str]) -> Journal:
    """Return the journal of a campaign that has not begun; `runs` are digests by key."""
    return Journal(campaign=campaign.name, variant=campaign.variant, seed=campaign.seed, runs=runs)


def save(journal: Journal, folder: Path) -> None:
    """Write the journal to its file, and return when it is on the disk.

    Raises
    ------
    NotWritten : the disk cannot be written; the previous journal stays.
    """
    body = journal.model_dump()
    with replacement(folder / JOURNAL_FILE) as path:
        path.write_text(json.dumps({**body, "sha256": _digest(body)}, indent=1) + "\n", encoding="utf-8")


def read(folder: Path, campaign: Campaign) -> Journal | None:
    """Return the journal of this campaign from its folder, or None if the folder has no journal.

    Raises
    ------
    InputError : it is damaged, or of another campaign, variant or seed.
    """
    path = folder / JOURNAL_FILE
    try:
        if path.stat().st_size > MOST_JOURNAL_BYTES:
            raise _damaged(path, f"more than {MOST_JOURNAL_BYTES} bytes")
        data = json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise _damaged(path, f"no JSON: {str(error).splitlines()[0]}") from None
    if not isinstance(data, dict) or data.get("format") != "leactl-campaign":
        raise InputError(f"{path}: not the journal of a campaign; choose another --out, or move it away")
    checksum = data.pop("sha256", None)
    if checksum != _digest(data):
        raise _damaged(path, "its checksum does not hold")
    try:
        journal = Journal.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise _damaged(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    for name, journaled, requested in (
        ("campaign", journal.campaign, campaign.name),
        ("variant", journal.variant, campaign.variant),
        ("seed", journal.seed, campaign.seed),
    ):
        if journaled != requested:
            raise InputError(
                f"{path}: the folder is that of {name} '{journaled}', '{requested}' was asked for; choose another --out"
            )
    return journal


def _digest(body: dict[str, Any]) -> str:
    """Return the checksum of a journal without its own entry `sha256`."""
    return sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def _damaged(path: Path, reason: str) -> InputError:
    """Return the error for a journal that is damaged."""
    return InputError(
        f"{path}: damaged: {reason}; move it away and start again: finished runs are found by their own files"
    )
