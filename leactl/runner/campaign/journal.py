"""The journal of a campaign: which folder is whose, what was begun and what is finished, replaced whole or not at all.

The run files are what counts; the journal tells which of them there should be. Without it they are found again by what
they say of themselves.
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

NAME = "campaign.json"
MOST_BYTES = 1 << 24
Seconds = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Finished(Block):
    """A run that came to its end."""

    run_id: str
    bench_s: Seconds = 0.0  # by the bench's clock; 0 where its process died before it could tell
    wall_s: Seconds = 0.0
    unmet: tuple[str, ...] = ()  # acceptance limits of its protocol


class RunBegun(Block):
    """The run that was begun last, by the name that its file has."""

    key: str
    run_id: str


class Journal(Block):
    """What the folder of a campaign holds; runs by the keys of their cells."""

    format: Literal["leactl-campaign"] = "leactl-campaign"
    format_version: Literal[1] = 1
    campaign: str
    variant: str
    seed: int
    runs: dict[str, str]  # every run in its order, and the digest of what it is to be
    finished: dict[str, Finished] = {}
    underway: RunBegun | None = None

    def begun(self, key: str, run_id: str) -> "Journal":
        """The journal as a run begins."""
        return self.model_copy(update={"underway": RunBegun(key=key, run_id=run_id)})

    def ended(self, key: str, finished: Finished) -> "Journal":
        """The journal as a run has come to its end."""
        return self.model_copy(update={"finished": self.finished | {key: finished}, "underway": None})

    def resumed(self, runs: dict[str, str], unjournaled: Mapping[str, Finished], finished: Container[str]) -> "Journal":
        """The journal as a campaign goes on.

        Parameters
        ----------
        runs : every run in its order, as they are now.
        unjournaled : finished runs that it does not know yet, or knows by a file that is lost.
        finished : keys of all that have their files; any other is to be made again.
        """
        kept = {key: one for key, one in {**self.finished, **unjournaled}.items() if key in finished}
        return self.model_copy(update={"runs": runs, "finished": kept, "underway": None})


def fresh(campaign: Campaign, runs: dict[str, str]) -> Journal:
    """The journal of a campaign that has not begun; `runs` are digests by key."""
    return Journal(campaign=campaign.name, variant=campaign.variant, seed=campaign.seed, runs=runs)


def save(journal: Journal, folder: Path) -> None:
    """Write the journal, on the disk when this returns.

    Raises
    ------
    NotWritten : the disk takes nothing; the journal before stands.
    """
    body = journal.model_dump()
    with replacement(folder / NAME) as path:
        path.write_text(json.dumps({**body, "sha256": _digest(body)}, indent=1) + "\n", encoding="utf-8")


def read(folder: Path, campaign: Campaign) -> Journal | None:
    """The journal of this campaign in its folder; None where it has not begun.

    Raises
    ------
    InputError : it is damaged, or of another campaign, variant or seed.
    """
    path = folder / NAME
    try:
        if path.stat().st_size > MOST_BYTES:
            raise _damaged(path, f"more than {MOST_BYTES} bytes")
        data = json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise _damaged(path, f"no JSON: {str(error).splitlines()[0]}") from None
    if not isinstance(data, dict) or data.get("format") != "leactl-campaign":
        raise InputError(f"{path}: not the journal of a campaign; choose another --out, or move it away")
    expected = data.pop("sha256", None)
    if expected != _digest(data):
        raise _damaged(path, "its checksum does not hold")
    try:
        journal = Journal.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise _damaged(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    for what, theirs, ours in (
        ("campaign", journal.campaign, campaign.name),
        ("variant", journal.variant, campaign.variant),
        ("seed", journal.seed, campaign.seed),
    ):
        if theirs != ours:
            raise InputError(
                f"{path}: the folder is that of {what} '{theirs}', '{ours}' was asked for; choose another --out"
            )
    return journal


def _digest(body: dict[str, Any]) -> str:
    return sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def _damaged(path: Path, why: str) -> InputError:
    return InputError(
        f"{path}: damaged: {why}; move it away and start again: finished runs are found by their own files"
    )
