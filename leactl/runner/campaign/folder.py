"""The folder of a campaign: held by one process at a time, and put in order before anything is added to it."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from leactl.errors import InputError
from leactl.runfile.publish import move_without_overwriting
from leactl.runner import locks
from leactl.runner.campaign.campaignfile import Campaign
from leactl.runner.campaign.entries import CampaignEntry
from leactl.runner.campaign.journal import NAME, Journal, fresh, read
from leactl.runner.campaign.standing import UNFINISHED, CampaignProgress, RunFile, files_in, standing

LOCK = ".campaign.lock"
MOST_NAMED = 3


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Make a campaign's folder where there is none, and hold it until the block is left.

    Raises
    ------
    InputError : it cannot be made or written to.
    DeviceError : another process conducts a campaign in it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror or error}; choose another --out") from None
    with locks.locked(folder / LOCK, f"{folder}: the campaign is conducted already"):
        for remnant in folder.glob(f".{NAME}.*.tmp"):  # of a kill while the journal was replaced
            remnant.unlink()
        yield


def busy(folder: Path) -> bool:
    """Whether a process conducts a campaign in the folder."""
    try:
        import fcntl

        descriptor = os.open(folder / LOCK, os.O_RDONLY)
    except (OSError, ImportError):  # nobody can hold it on a system without locks
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def journal_and_progress(
    campaign: Campaign, entries: Sequence[CampaignEntry], folder: Path
) -> tuple[Journal, CampaignProgress]:
    """Return the folder's journal, or a new unsaved one, and the progress that the run files in the folder prove.

    Raises
    ------
    InputError : a journal that is damaged, or not of this campaign.
    """
    runs = {entry.cell.key: entry.digest for entry in entries}
    journal = read(folder, campaign) or fresh(campaign, runs)
    return journal, standing(campaign.name, runs, journal, files_in(folder))


def resumable(
    campaign: Campaign, entries: Sequence[CampaignEntry], folder: Path, accept_changes: bool, redo_lost: bool
) -> tuple[Journal, CampaignProgress]:
    """Return journal and progress of a campaign that may go on; see `refuse_changed` and `refuse_lost`.

    Raises
    ------
    InputError : a journal that is damaged or not of this campaign, changed runs, or finished runs whose files are lost.
    """
    journal, progress = journal_and_progress(campaign, entries, folder)
    refuse_changed(campaign, journal, progress, {entry.cell.key: entry.digest for entry in entries}, accept_changes)
    if not redo_lost:
        refuse_lost(progress)
    return journal, progress


def refuse_changed(
    campaign: Campaign, journal: Journal, progress: CampaignProgress, runs: Mapping[str, str], accept: bool
) -> None:
    """Refuse to go on with another campaign than the one that was begun.

    Parameters
    ----------
    runs : digests by key, as the campaign is now.
    accept : go on where only runs are changed that are not finished yet.

    Raises
    ------
    InputError : with what was changed.
    """
    if progress.changed:
        raise InputError(
            f"campaign '{campaign.name}': {_named(progress.changed)} finished, and campaign, protocol or bench now say"
            " otherwise; change them back, or choose another --out"
        )
    begun = journal.runs
    changes = {
        "added": runs.keys() - begun.keys(),
        "taken out": begun.keys() - runs.keys(),
        "changed": {key for key in runs.keys() & begun.keys() if runs[key] != begun[key]},
    }
    counts = [f"{len(keys)} {how}" for how, keys in changes.items() if keys]
    if counts and not accept:
        raise InputError(
            f"campaign '{campaign.name}' was changed after its start: {', '.join(counts)} of {len(runs)} runs, none of"
            " them finished; --accept-changes goes on with it as it is now"
        )


def refuse_lost(progress: CampaignProgress) -> None:
    """Refuse to go on where finished runs have lost their files.

    Raises
    ------
    InputError : one line for each.
    """
    if progress.lost:
        raise InputError(
            [
                f"{key} was finished, and {fate}; put its file back, or --redo-lost makes the run again"
                for key, fate in progress.lost.items()
            ]
        )


def put_aside(files: Sequence[RunFile], folder: Path) -> list[Path]:
    """Move runs that were cut off to a folder of their own: what stays is what the analyses are to take."""
    moved = []
    for file in files:
        target = folder / UNFINISHED / file.path.name
        target.parent.mkdir(exist_ok=True)
        move_without_overwriting(file.path, target)
        moved.append(target)
    return moved


def _named(keys: Sequence[str]) -> str:
    more = f" and {len(keys) - MOST_NAMED} more" if len(keys) > MOST_NAMED else ""
    return f"{', '.join(keys[:MOST_NAMED])}{more} {'is' if len(keys) == 1 else 'are'}"
