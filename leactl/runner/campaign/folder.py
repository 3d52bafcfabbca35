"""Lock the folder of a campaign for one process, and check the run files in it before any is added."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from leactl.errors import InputError
from leactl.runfile.publish import move_without_overwriting
from leactl.runner import locks
from leactl.runner.campaign.campaignfile import Campaign
from leactl.runner.campaign.entries import CampaignEntry
from leactl.runner.campaign.journal import JOURNAL_FILE, Journal, new_journal, read
from leactl.runner.campaign.standing import UNFINISHED_FOLDER, CampaignProgress, RunFile, campaign_progress, files_in

LOCK_FILE = ".campaign.lock"
MOST_LISTED_KEYS = 3  # in a message


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Create the folder of a campaign if it is missing, and lock it until the block is left.

    Raises
    ------
    InputError : the folder cannot be made or written to.
    DeviceError : another process conducts a campaign in the folder.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror or error}; choose another --out") from None
    with locks.locked(folder / LOCK_FILE, f"{folder}: the campaign is conducted already"):
        for remnant in folder.glob(f".{JOURNAL_FILE}.*.tmp"):  # from a process killed while it replaced the journal
            remnant.unlink()
        yield


def busy(folder: Path) -> bool:
    """Return whether a process conducts a campaign in the folder."""
    try:
        import fcntl

        descriptor = os.open(folder / LOCK_FILE, os.O_RDONLY)
    except (OSError, ImportError):  # a system without locks, or a folder without a lock file
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
    journal = read(folder, campaign) or new_journal(campaign, runs)
    return journal, campaign_progress(campaign.name, runs, journal, files_in(folder))


def resumable(
    campaign: Campaign, entries: Sequence[CampaignEntry], folder: Path, accept_changes: bool, redo_lost: bool
) -> tuple[Journal, CampaignProgress]:
    """Return journal and progress of a campaign, if it may begin or go on; see `refuse_changed` and `refuse_lost`.

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
    """Raise InputError for a campaign whose runs were changed since it began.

    Parameters
    ----------
    runs : digests by key, as the campaign is now.
    accept : allow changes of runs that are not finished yet.

    Raises
    ------
    InputError : a finished run was changed, or an unfinished one without `accept`.
    """
    if progress.changed:
        raise InputError(
            f"campaign '{campaign.name}': {_listed(progress.changed)} finished, and campaign, protocol or bench now say"
            " otherwise; change them back, or choose another --out"
        )
    runs_at_start = journal.runs
    changes = {
        "added": runs.keys() - runs_at_start.keys(),
        "taken out": runs_at_start.keys() - runs.keys(),
        "changed": {key for key in runs.keys() & runs_at_start.keys() if runs[key] != runs_at_start[key]},
    }
    counts = [f"{len(keys)} {change}" for change, keys in changes.items() if keys]
    if counts and not accept:
        raise InputError(
            f"campaign '{campaign.name}' was changed after its start: {', '.join(counts)} of {len(runs)} runs, none of"
            " them finished; --accept-changes goes on with it as it is now"
        )


def refuse_lost(progress: CampaignProgress) -> None:
    """Raise InputError for a campaign of which the files of finished runs are lost.

    Raises
    ------
    InputError : one line for each lost file.
    """
    if progress.lost:
        raise InputError(
            [
                f"{key} was finished, and {reason}; put its file back, or --redo-lost makes the run again"
                for key, reason in progress.lost.items()
            ]
        )


def put_aside(files: Sequence[RunFile], folder: Path) -> list[Path]:
    """Move run files to the subfolder `unfinished`, where analyses do not take them; return their new paths."""
    new_paths = []
    for file in files:
        target = folder / UNFINISHED_FOLDER / file.path.name
        target.parent.mkdir(exist_ok=True)
        move_without_overwriting(file.path, target)
        new_paths.append(target)
    return new_paths


def _listed(keys: Sequence[str]) -> str:
    """Return the first keys as the subject of a sentence, with its verb."""
    more = f" and {len(keys) - MOST_LISTED_KEYS} more" if len(keys) > MOST_LISTED_KEYS else ""
    return f"{', '.join(keys[:MOST_LISTED_KEYS])}{more} {'is' if len(keys) == 1 else 'are'}"
