"""Make the runs of a campaign that are not finished yet, one after the other, each by the machinery of `leactl run`.

Between two runs a person mounts what the next one needs and the windings cool; whatever ends a run before its own end
ends the campaign there, and the next start goes on with that run.
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
from leactl.runfile.write.writer import new_run_id
from leactl.runner import locks
from leactl.runner.acceptance import judge
from leactl.runner.campaign import folder as place
from leactl.runner.campaign.campaignfile import Campaign
from leactl.runner.campaign.entries import CampaignEntry, previews
from leactl.runner.campaign.journal import Finished, Journal, save
from leactl.runner.dry_run import Preview
from leactl.runner.operators import at_the_terminal
from leactl.runner.outcome import Outcome
from leactl.runner.request import Request
from leactl.runner.signals import between_runs
from leactl.runner.thermal_admission import Windings

LOOK_EVERY_S = 0.05  # at the keyboard and at signals, between two runs

Perform = Callable[[Request, str], Outcome]
"""Execute a request; the text opens what is shown of it."""


@dataclass(frozen=True)
class CampaignOptions:
    """How a campaign is conducted."""

    perform: Perform
    tell: Callable[[str], None]
    attended: bool  # somebody can answer at the terminal
    mounted: bool = False  # what the first prompt asks for is done
    cold: bool = False  # a person says that nothing has heated the actuators
    redo_lost: bool = False
    accept_changes: bool = False


@dataclass(frozen=True)
class Ended:
    """How far a campaign came, and what ended it where that was not its end."""

    journal: Journal
    total: int
    error: BaseException | None

    @property
    def unmet(self) -> list[str]:
        """Every acceptance limit that a run has not met."""
        return [f"{key}: {text}" for key, one in self.journal.finished.items() for text in one.unmet]


def conduct(campaign: Campaign, entries: Sequence[CampaignEntry], folder: Path, manner: CampaignOptions) -> Ended:
    """Perform the unfinished runs; `error` of the result is the exception that stopped the campaign, if any did.

    Raises
    ------
    InputError, SafetyTrip, DeviceError : as `leactl run`, before the first run; a folder that cannot be gone on with.
    Stopped : asked for before the first run.
    """
    with place.held(folder), ExitStack() as benches, between_runs() as check:
        runs = {entry.cell.key: entry.digest for entry in entries}
        journal, now = place.resumable(campaign, entries, folder, manner.accept_changes, manner.redo_lost)
        pending = [entry for entry in entries if entry.cell.key not in now.finished]
        real = {entry.request.bench.name: entry.request.bench for entry in pending if not entry.request.in_process}
        for name, bench in sorted(real.items()):
            lock = f"campaign-{locks.name_of(bench)}"
            benches.enter_context(locks.alone(lock, f"bench '{name}' has a campaign already"))
        expected = previews(pending, check)
        for moved in place.put_aside([*now.unfinished, *now.damaged], folder):
            manner.tell(f"put aside: {moved}")
        plans = {entry.cell.key: entry.request.plan for entry in entries}
        unjournaled = {
            key: Finished(run_id=now.finished[key].run_id, unmet=_unmet(plans[key], now.finished[key].path))
            for key in now.unjournaled(journal)
        }
        journal = journal.resumed(runs, unjournaled, now.finished.keys())
        save(journal, folder)
        conductor = _Conductor(len(entries), pending, expected, folder, manner, journal)
        try:
            conductor.make_all(check)
        except LeactlError as error:
            return Ended(conductor.journal, len(entries), error)
        return Ended(conductor.journal, len(entries), None)


class _Conductor:
    """The runs that are left, one after the other; the journal is on the disk before and after each."""

    def __init__(
        self,
        total: int,
        pending: Sequence[CampaignEntry],
        expected: Mapping[tuple[str, str], Preview],
        folder: Path,
        manner: CampaignOptions,
        journal: Journal,
    ) -> None:
        self.journal = journal
        self._total, self._pending, self._folder, self._manner = total, pending, folder, manner
        self._lasts = [expected[entry.cell.step, entry.cell.condition].duration_s for entry in pending]
        self._mounted: tuple[str, ...] = ()

    def make_all(self, check: Callable[[], None]) -> None:
        """Make every run that is left.

        Raises
        ------
        LeactlError : what ended a run too soon, or came between two.
        """
        if self._manner.cold:
            for entry in self._pending:
                self._windings(entry, cold=True).keep_as_found()
        for index, entry in enumerate(self._pending):
            check()
            self._mount(entry, check)
            self._cool(entry, check)
            self._make(entry, self._heading(index), self._lasts[index])

    def _make(self, entry: CampaignEntry, heading: str, bench_s: float) -> None:
        self._manner.tell(f"{heading}: {entry.cell}")
        request = replace(entry.request, run_id=new_run_id(entry.request.plan.name, datetime.now(UTC)))
        self._note(self.journal.begun(entry.cell.key, request.run_id))
        began = time.monotonic()
        outcome = self._manner.perform(request, f"{heading} ")
        for note in outcome.notes:
            self._manner.tell(note)
        if outcome.error is not None:
            raise outcome.error
        wall_s, unmet = time.monotonic() - began, _unmet(request.plan, outcome.path)
        for text in unmet:
            self._manner.tell(text)
        finished = Finished(run_id=request.run_id, bench_s=bench_s, wall_s=wall_s, unmet=unmet)
        self._note(self.journal.ended(entry.cell.key, finished))

    def _note(self, journal: Journal) -> None:
        save(journal, self._folder)
        self.journal = journal

    def _heading(self, index: int) -> str:
        """`[3/41, 0:05:20 left]`."""
        left = sum(self._lasts[index:]) * self._pace()
        told = f", {clock(left)} left" if math.isfinite(left) else ""
        return f"[{self._total - len(self._pending) + index + 1}/{self._total}{told}]"

    def _pace(self) -> float:
        """Wall seconds a bench second, by the runs that are finished; NaN before there is one."""
        first = self._pending[0].request
        if first.realtime or not first.in_process:
            return 1.0
        done = self.journal.finished.values()
        bench_s = sum(one.bench_s for one in done)
        return sum(one.wall_s for one in done) / bench_s if bench_s > 0 else math.nan

    def _mount(self, entry: CampaignEntry, check: Callable[[], None]) -> None:
        """See to it that what a run needs is mounted; nobody has to touch an emulated bench.

        Raises
        ------
        Stopped : the operator stops here, or nobody is there to answer.
        """
        if entry.request.bench.emulated is not None:
            return
        needed, text = entry.mounted, f"Mount {entry.asks}"
        first = not self._mounted
        if needed != self._mounted and not (first and self._manner.mounted):
            if not self._manner.attended:
                raise Stopped(f"{text}; stdin is no terminal to confirm it at: see to it, then start again with --yes")
            answered = at_the_terminal(text)
            while not answered():
                check()
                time.sleep(LOOK_EVERY_S)
        self._mounted = needed
        if entry.asks_within and not self._manner.attended:
            raise Stopped(f"protocol '{entry.request.plan.name}' asks the operator, and stdin is no terminal")

    def _cool(self, entry: CampaignEntry, check: Callable[[], None]) -> None:
        """Wait until the windings allow a run; where no wait is enough, the run itself is refused."""
        if entry.request.in_process:
            return
        while rest_s := self._windings(entry).rest_before(entry.request.plan):
            self._manner.tell(f"waiting {clock(rest_s)} for the windings to cool, for {entry.cell}")
            until = time.monotonic() + rest_s
            while time.monotonic() < until:
                check()
                time.sleep(LOOK_EVERY_S)

    def _windings(self, entry: CampaignEntry, cold: bool = False) -> Windings:
        request = entry.request
        return Windings(request.bench, request.devices, request.actuator, request.in_process, cold)


def clock(seconds: float) -> str:
    """`4000` as `1:06:40`."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"


def _unmet(plan: Plan, run: Path) -> tuple[str, ...]:
    return tuple(judge(plan, run)[1]) if plan.acceptance else ()
