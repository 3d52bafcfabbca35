"""The progress of a campaign, from its planned runs, its journal and the run files in its folder.

A run is finished if its file says that it is complete and passes all checks, whatever the journal says. The journal
adds which files should be there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from leactl.errors import InputError
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runner.campaign.journal import Journal

EVENT_SOURCE = "campaign"  # source of the events in a run file that name its campaign and run
UNFINISHED_FOLDER = "unfinished"  # subfolder for files of runs that were cut off, and for damaged files


@dataclass(frozen=True)
class RunFile:
    """A run file in the folder of a campaign, as far as it can be read."""

    path: Path
    run_id: str
    status: str = ""
    part_of: Mapping[str, str] = field(default_factory=dict)  # campaign name, key of the run, digest and more
    faults: Sequence[str] = ()

    @property
    def whole(self) -> bool:
        """Whether the run is complete and its file passed all checks."""
        return self.status == "complete" and not self.faults

    @property
    def key(self) -> str:
        """Key of the run in its campaign; empty if the file belongs to none."""
        return self.part_of.get("run", "")


@dataclass(frozen=True)
class CampaignProgress:
    """The finished, lost, unfinished and changed runs of a campaign."""

    finished: Mapping[str, RunFile]  # by key
    lost: Mapping[str, str]  # key: what is wrong with the file of a run that the journal lists as finished
    damaged: Sequence[RunFile]  # files of lost runs that are in the folder and fail their checks
    unfinished: Sequence[RunFile]  # files of runs that were cut off
    changed: Sequence[str]  # keys of finished runs whose digest is not the one that the campaign has now

    def unjournaled(self, journal: Journal) -> list[str]:
        """Return the keys of finished runs whose files the journal does not list."""
        journaled_ids = {key: run.run_id for key, run in journal.finished.items()}
        return [key for key, file in self.finished.items() if journaled_ids.get(key) != file.run_id]


def campaign_progress(
    name: str, runs: Mapping[str, str], journal: Journal, files: Sequence[RunFile]
) -> CampaignProgress:
    """Sort the run files of a folder into finished, damaged and unfinished ones.

    Parameters
    ----------
    name : of the campaign; files of other campaigns are ignored.
    runs : digests by key of the planned runs, in order.
    """
    campaign_files = [file for file in files if file.part_of.get("name") == name]
    by_id = {file.run_id: file for file in files}
    finished, lost_reasons = {}, {}
    for key, entry in journal.finished.items():
        file = by_id.get(entry.run_id)
        if file is not None and file.whole and file in campaign_files and file.key == key:
            finished[key] = file
        else:
            lost_reasons[key] = f"{entry.run_id}.h5: {_reason_lost(file, key)}"
    for file in campaign_files:  # complete, but the process died before it wrote the journal
        if file.whole and file.key not in finished:
            finished[file.key] = file
            lost_reasons.pop(file.key, None)
    changed_keys = [key for key, file in finished.items() if runs.get(key) != file.part_of.get("digest")]
    underway_id = journal.underway.run_id if journal.underway else ""
    finished_ids = {file.run_id for file in finished.values()}
    journaled_ids = {entry.run_id for entry in journal.finished.values()}
    damaged = [file for file in files if file.run_id in journaled_ids - finished_ids and not file.whole]
    unfinished = [
        file
        for file in files
        if file.run_id not in journaled_ids
        and not file.whole
        and (file in campaign_files or file.run_id == underway_id)
    ]
    return CampaignProgress(finished, lost_reasons, damaged, unfinished, changed_keys)


def _reason_lost(file: RunFile | None, key: str) -> str:
    """Return why a file does not prove that the run with this key is finished."""
    if file is None:
        return "is missing"
    if file.faults:
        return str(file.faults[0]).removeprefix(f"{file.path}: ")
    return f"status is '{file.status}'" if file.status != "complete" else f"is not the file of {key}"


def files_in(folder: Path) -> list[RunFile]:
    """Read every run file of a folder; see `read_run_file`."""
    return [read_run_file(path) for path in sorted(folder.glob("*.h5"))]


def read_run_file(path: Path) -> RunFile:
    """Read status and campaign of a run file; verify the whole file if it is complete and of a campaign."""
    try:
        with Run.open(path) as run:
            run_id = str(run.attributes.get("run_id", "")) or path.stem
            entries = [event.message.partition(" = ") for event in run.events if event.source == EVENT_SOURCE]
            status = "recording" if run.unfinished else run.status
    except InputError as fault:
        return RunFile(path, path.stem, faults=tuple(fault.faults))
    part_of = {name: value for name, _, value in entries}
    faults = verify(path) if part_of and status == "complete" else []
    return RunFile(path, run_id, status, part_of, tuple(faults))
