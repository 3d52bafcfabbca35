"""Make the runs of a campaign that are not finished yet, one after the other, each as `leactl run` makes a run.

Between two runs a person mounts what the next one needs and the windings cool. If a run is stopped or fails, the
campaign ends there, and the next start makes that run again.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from leactl.errors import LeactlError, Stopped
from leactl.protocol.plan import Plan
from leactl.runfile.write.run_info import new_run_id
from leactl.runner import locks
from leactl.runner.acceptance import judge_run_file
from leactl.runner.campaign import folder as campaign_folder
from leactl.runner.campaign.campaignfile import Campaign
from leactl.runner.campaign.entries import CampaignEntry, previews
from leactl.runner.campaign.journal import Finished, Journal, save
from leactl.runner.dry_run import Preview
from leactl.runner.operators import at_the_terminal
from leactl.runner.outcome import Outcome
from leactl.runner.request import Request
from leactl.runner.stop_requests import between_runs
from leactl.runner.thermal_admission import Windings

POLL_INTERVAL_S = 0.05  # of the keyboard and of signals, between two runs

Perform = Callable[[Request, str], Outcome]
"""Executes a request; the text is the beginning of the title of its live view."""


@dataclass(frozen=True)
class CampaignOptions:
    """How a campaign is conducted."""

    perform: Perform
    tell: Callable[[str], None]
    attended: bool  # whether somebody can answer at the terminal
    mounted: bool = False  # whether everything that the first run needs is mounted already
    cold: bool = False  # a person says that nothing has heated the actuators
    redo_lost: bool = False
    accept_changes: bool = False


@dataclass(frozen=True)
class CampaignOutcome:
    """The journal at the end of one start of a campaign, and the error that stopped it early, if any."""

    journal: Journal
    total: int  # number of runs of the whole campaign
    error: BaseException | None

    @property
    def unmet(self) -> list[str]:
        """Every acceptance limit that a finished run did not meet, preceded by the key of the run."""
        return [f"{key}: {text}" for key, finished in self.journal.finished.items() for text in finished.unmet]


def conduct(
    campaign: Campaign, entries: Sequence[CampaignEntry], folder: Path, options: CampaignOptions
) -> CampaignOutcome:
    """Perform the unfinished runs; `error` of the result is the exception that stopped the campaign, if any did.

    Raises
    ------
    InputError, SafetyTrip, DeviceError : as `leactl run`, before the first run; or the campaign cannot go on in this
        folder.
    Stopped : a person stopped the campaign before its first run.
    """
    with campaign_folder.held(folder), ExitStack() as bench_locks, between_runs() as check:
        runs = {entry.cell.key: entry.digest for entry in entries}
        journal, progress = campaign_folder.resumable(
            campaign, entries, folder, options.accept_changes, options.redo_lost
        )
        pending = [entry for entry in entries if entry.cell.key not in progress.finished]
        real_benches = {
            entry.request.bench.name: entry.request.bench for entry in pending if not entry.request.in_process
        }
        for name, bench in sorted(real_benches.items()):
            lock = f"campaign-{locks.name_of(bench)}"
            bench_locks.enter_context(locks.alone(lock, f"bench '{name}' has a campaign already"))
        expected = previews(pending, check)
        for new_path in campaign_folder.put_aside([*progress.unfinished, *progress.damaged], folder):
            options.tell(f"put aside: {new_path}")
        plans = {entry.cell.key: entry.request.plan for entry in entries}
        unjournaled = {
            key: Finished(run_id=progress.finished[key].run_id, unmet=_unmet(plans[key], progress.finished[key].path))
            for key in progress.unjournaled(journal)
        }
        journal = journal.resumed(runs, unjournaled, progress.finished.keys())
        save(journal, folder)
        conductor = _Conductor(len(entries), pending, expected, folder, options, journal)
        try:
            conductor.make_all(check)
        except LeactlError as error:
            return CampaignOutcome(conductor.journal, len(entries), error)
        return CampaignOutcome(conductor.journal, len(entries), None)


class _Conductor:
    """Makes the pending runs one after the other, and writes the journal to the disk before and after each."""

    def __init__(
        self,
        total: int,
        pending: Sequence[CampaignEntry],
        expected: Mapping[tuple[str, str], Preview],
        folder: Path,
        options: CampaignOptions,
        journal: Journal,
    ) -> None:
        self.journal = journal
        self._total, self._pending, self._folder, self._options = total, pending, folder, options
        self._durations_s = [expected[entry.cell.step, entry.cell.condition].duration_s for entry in pending]
        self._mounting: tuple[str, ...] = ()

    def make_all(self, check: Callable[[], None]) -> None:
        """Make every pending run.

        Raises
        ------
        LeactlError : the error that ended a run early, or that occurred between two runs.
        """
        if self._options.cold:
            for entry in self._pending:
                self._windings(entry, cold=True).keep_as_found()
        for index, entry in enumerate(self._pending):
            check()
            self._mount(entry, check)
            self._cool(entry, check)
            self._make(entry, self._heading(index), self._durations_s[index])

    def _make(self, entry: CampaignEntry, heading: str, bench_s: float) -> None:
        """Make one run, and write to the journal that it began and that it finished.

        Parameters
        ----------
        bench_s : expected duration by the bench's clock [s].

        Raises
        ------
        LeactlError : the error that ended the run.
        """
        self._options.tell(f"{heading}: {entry.cell}")
        request = replace(entry.request, run_id=new_run_id(entry.request.plan.name, datetime.now(UTC)))
        self._save(self.journal.begun(entry.cell.key, request.run_id))
        began = time.monotonic()
        outcome = self._options.perform(request, f"{heading} ")
        for note in outcome.notes:
            self._options.tell(note)
        if outcome.error is not None:
            raise outcome.error
        wall_s, unmet = time.monotonic() - began, _unmet(request.plan, outcome.path)
        for text in unmet:
            self._options.tell(text)
        finished = Finished(run_id=request.run_id, bench_s=bench_s, wall_s=wall_s, unmet=unmet)
        self._save(self.journal.ended(entry.cell.key, finished))

    def _save(self, journal: Journal) -> None:
        """Write a journal to the disk, and continue with it."""
        save(journal, self._folder)
        self.journal = journal

    def _heading(self, index: int) -> str:
        """Return number and remaining time of a run, such as `[3/41, 0:05:20 left]`."""
        remaining_s = sum(self._durations_s[index:]) * self._pace()
        remaining = f", {clock(remaining_s)} left" if math.isfinite(remaining_s) else ""
        return f"[{self._total - len(self._pending) + index + 1}/{self._total}{remaining}]"

    def _pace(self) -> float:
        """Return the wall seconds per second of the bench's clock over the finished runs; NaN while none is known."""
        request = self._pending[0].request
        if request.keeps_wall_time:
            return 1.0
        finished = self.journal.finished.values()
        bench_s = sum(run.bench_s for run in finished)
        return sum(run.wall_s for run in finished) / bench_s if bench_s > 0 else math.nan

    def _mount(self, entry: CampaignEntry, check: Callable[[], None]) -> None:
        """Ask the operator to mount what a run needs, unless it is mounted or the bench is emulated.

        Raises
        ------
        Stopped : the operator stops the campaign, or nobody is at the terminal to answer.
        """
        if entry.request.bench.emulated is not None:
            return
        mounting, text = entry.mounting, f"Mount {entry.mounting_prompt}"
        is_first = not self._mounting
        if mounting != self._mounting and not (is_first and self._options.mounted):
            if not self._options.attended:
                raise Stopped(f"{text}; stdin is no terminal to confirm it at: see to it, then start again with --yes")
            answered = at_the_terminal(text)
            while not answered():
                check()
                time.sleep(POLL_INTERVAL_S)
        self._mounting = mounting
        if entry.protocol_has_prompts and not self._options.attended:
            raise Stopped(f"protocol '{entry.request.plan.name}' asks the operator, and stdin is no terminal")

    def _cool(self, entry: CampaignEntry, check: Callable[[], None]) -> None:
        """Wait until the windings allow a run; where no wait is enough, the run itself is refused."""
        if entry.request.in_process:
            return
        while rest_s := self._windings(entry).rest_before(entry.request.plan):
            self._options.tell(f"waiting {clock(rest_s)} for the windings to cool, for {entry.cell}")
            end_time = time.monotonic() + rest_s
            while time.monotonic() < end_time:
                check()
                time.sleep(POLL_INTERVAL_S)

    def _windings(self, entry: CampaignEntry, cold: bool = False) -> Windings:
        """Return the windings of a run at their present temperatures; `cold` if a person says that they are cold."""
        request = entry.request
        return Windings(request.bench, request.devices, request.actuator, request.in_process, cold)


def clock(seconds: float) -> str:
    """Format seconds as hours, minutes and seconds: 4000 as `1:06:40`."""
    minutes, remaining = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{remaining:02d}"


def _unmet(plan: Plan, run: Path) -> tuple[str, ...]:
    """Return one line for each acceptance limit of a plan that its run did not meet."""
    return tuple(judge_run_file(plan, run)[1]) if plan.acceptance else ()
