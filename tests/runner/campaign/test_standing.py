"""Journal and files after any sequence of ends: no finished run is made again, no cut-off file counts."""

import json
from itertools import count
from pathlib import Path

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from leactl.runner.campaign.journal import Finished, Journal
from leactl.runner.campaign.standing import RunFile, campaign_progress

NAME = "any"


class Campaign(RuleBasedStateMachine):
    """A folder of run files and a journal on a disk; every rule is one start of the command and how it ended."""

    @initialize(total=st.integers(1, 5))
    def start(self, total):
        self.runs = {f"step//{index}/1": f"digest {index}" for index in range(total)}
        self.disk = None  # the journal
        self.files = {}
        self.made = dict.fromkeys(self.runs, 0)  # runs that came to their end
        self.harmed = dict.fromkeys(self.runs, 0)  # of those, whose files were lost since
        self.ids = count()

    def look(self):
        journal = self.disk or Journal(campaign=NAME, variant="", seed=1, runs=self.runs)
        return journal, campaign_progress(NAME, self.runs, journal, list(self.files.values()))

    def save(self, journal):
        self.disk = Journal.model_validate(json.loads(json.dumps(journal.model_dump())))

    def resume(self, redo):
        journal, now = self.look()
        if now.lost and not redo:
            return None, []
        for file in [*now.unfinished, *now.damaged]:
            del self.files[file.run_id]
        unjournaled = {key: Finished(run_id=now.finished[key].run_id) for key in now.unjournaled(journal)}
        journal = journal.resumed(self.runs, unjournaled, now.finished.keys())
        self.save(journal)
        return journal, [key for key in self.runs if key not in now.finished]

    def write(self, key, run_id, status):
        part_of = {"name": NAME, "run": key, "digest": self.runs[key]}
        self.files[run_id] = RunFile(Path(f"{run_id}.h5"), run_id, status, part_of)

    @rule(
        good=st.integers(0, 4),
        end=st.sampled_from(["killed at once", "killed", "stopped", "tripped", "killed unjournaled", "between runs"]),
        redo=st.booleans(),
    )
    def go_on(self, good, end, redo):
        journal, pending = self.resume(redo)
        for place, key in enumerate(pending):
            run_id = f"run {next(self.ids)}"
            if place == good and end == "between runs":
                return
            journal = journal.begun(key, run_id)
            self.save(journal)
            if place == good and end == "killed at once":  # before the first row: the file tells nothing of itself
                self.files[run_id] = RunFile(Path(f"{run_id}.h5"), run_id, "recording")
                return
            if place == good and end != "killed unjournaled":
                self.write(key, run_id, {"killed": "recording"}.get(end, end))
                return
            self.write(key, run_id, "complete")
            self.made[key] += 1
            if place == good:
                return
            journal = journal.ended(key, Finished(run_id=run_id))
            self.save(journal)

    def _finished_files(self):
        return sorted(file.run_id for file in self.files.values() if file.whole)

    @rule(which=st.integers(0, 10), damaged=st.booleans())
    def lose_a_file(self, which, damaged):
        finished = self._finished_files()
        if not finished:
            return
        file = self.files.pop(finished[which % len(finished)])
        self.harmed[file.key] += 1
        if damaged:
            self.files[file.run_id] = RunFile(file.path, file.run_id, "complete", file.part_of, ("damaged",))

    @rule()
    def lose_the_journal(self):
        self.disk = None

    @invariant()
    def no_more_runs_than_files_were_lost(self):
        assert all(self.made[key] <= 1 + self.harmed[key] for key in self.runs)

    @invariant()
    def exactly_the_whole_files_count(self):
        _journal, now = self.look()
        assert sorted(file.run_id for file in now.finished.values()) == self._finished_files()
        assert all(file.whole and file.key == key for key, file in now.finished.items())
        assert now.changed == []

    @invariant()
    def what_is_lost_was_finished_once(self):
        _journal, now = self.look()
        assert now.lost.keys() <= {key for key in self.runs if self.harmed[key]}
        assert not now.lost.keys() & now.finished.keys()

    def teardown(self):
        if not hasattr(self, "runs"):
            return
        _journal, pending = self.resume(redo=True)
        for key in pending:
            self.write(key, f"run {next(self.ids)}", "complete")
        assert sorted(file.key for file in self.files.values() if file.whole) == sorted(self.runs)


Campaign.TestCase.settings = settings(
    max_examples=60, stateful_step_count=12, suppress_health_check=[HealthCheck.too_slow]
)
TestCampaign = Campaign.TestCase
