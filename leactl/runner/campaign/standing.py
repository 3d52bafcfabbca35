"""How far a campaign is: the runs that are to be made, its journal and the run files of its folder, put together.

A run is finished where its file says that it is complete and holds what was recorded; whatever the journal says, no
other file counts. What the journal says beyond that is which files should be there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from leactl.errors import InputError
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runner.campaign.journal import Journal

SOURCE = "campaign"  # of the events by which a run tells what it is part of
UNFINISHED = "unfinished"  # folder of runs that were cut off, beside the finished ones


@dataclass(frozen=True)
class RunFile:
    """A run file in the folder of a campaign, as far as it can be read."""

    path: Path
    run_id: str
    status: str = ""
    part_of: Mapping[str, str] = field(default_factory=dict)
    faults: Sequence[str] = ()

    @property
    def whole(self) -> bool:
        """Whether the run came to its end and its file holds what was recorded."""
        return self.status == "complete" and not self.faults

    @property
    def key(self) -> str:
        """The run of the campaign that it is; empty where it says nothing."""
        return self.part_of.get("run", "")


@dataclass(frozen=True)
class CampaignProgress:
    """How far a campaign is."""

    finished: Mapping[str, RunFile]  # by key
    lost: Mapping[str, str]  # key: what has become of the file of a run that was finished
    damaged: Sequence[RunFile]  # what is left of those
    unfinished: Sequence[RunFile]  # of runs that were cut off
    changed: Sequence[str]  # keys of finished runs that were made of something else than the campaign now asks for

    def unjournaled(self, journal: Journal) -> list[str]:
        """Keys of finished runs whose files the journal does not know."""
        known = {key: one.run_id for key, one in journal.finished.items()}
        return [key for key, file in self.finished.items() if known.get(key) != file.run_id]


def standing(name: str, runs: Mapping[str, str], journal: Journal, files: Sequence[RunFile]) -> CampaignProgress:
    """Judge the files of a folder by the journal and by what is to be made.

    Parameters
    ----------
    name : of the campaign; files of another are left alone.
    runs : digests by key, in order.
    """
    ours = [file for file in files if file.part_of.get("name") == name]
    by_id = {file.run_id: file for file in files}
    finished, lost = {}, {}
    for key, entry in journal.finished.items():
        file = by_id.get(entry.run_id)
        if file is not None and file.whole and file in ours and file.key == key:
            finished[key] = file
        else:
            lost[key] = f"{entry.run_id}.h5: {_fate(file, key)}"
    for file in ours:  # closed in order by a process that died before it could tell the journal
        if file.whole and file.key not in finished:
            finished[file.key] = file
            lost.pop(file.key, None)
    changed = [key for key, file in finished.items() if runs.get(key) != file.part_of.get("digest")]
    begun = journal.underway.run_id if journal.underway else ""
    counted = {file.run_id for file in finished.values()}
    promised = {entry.run_id for entry in journal.finished.values()}
    damaged = [file for file in files if file.run_id in promised - counted and not file.whole]
    unfinished = [
        file
        for file in files
        if file.run_id not in promised and not file.whole and (file in ours or file.run_id == begun)
    ]
    return CampaignProgress(finished, lost, damaged, unfinished, changed)


def _fate(file: RunFile | None, key: str) -> str:
    if file is None:
        return "is missing"
    if file.faults:
        return str(file.faults[0]).removeprefix(f"{file.path}: ")
    return f"status is '{file.status}'" if file.status != "complete" else f"is not the file of {key}"


def files_in(folder: Path) -> list[RunFile]:
    """Every run file of a folder; those that claim to be complete are checked throughout."""
    return [look(path) for path in sorted(folder.glob("*.h5"))]


def look(path: Path) -> RunFile:
    """Read what a run file is part of."""
    try:
        with Run.open(path) as run:
            run_id = str(run.attributes.get("run_id", "")) or path.stem
            told = [event.message.partition(" = ") for event in run.events if event.source == SOURCE]
            status = "recording" if run.unfinished else run.status
    except InputError as fault:
        return RunFile(path, path.stem, faults=tuple(fault.faults))
    part_of = {name: value for name, _, value in told}
    faults = verify(path) if part_of and status == "complete" else []
    return RunFile(path, run_id, status, part_of, tuple(faults))
