"""A small campaign in a directory of its own, conducted in this process on the emulated bench."""

import json
from contextlib import nullcontext

import pytest

from leactl.runner.campaign.campaignfile import load
from leactl.runner.campaign.conduct import CampaignOptions, conduct
from leactl.runner.campaign.entries import EntryOptions, entries_of
from leactl.runner.operators import confirm_at_once
from leactl.runner.session import execute

SPIN = """
name: spin
setup: free
analysis: friction
rate_Hz: 50
parameters: {current_A: 0.7, hold_s: 0.3}
steps:
  - mode: {test: current}
  - hold: {role: test, current_A: $current_A, duration_s: $hold_s}
  - mode: {test: "off"}
"""

SMALL = """
name: small
bench: emulated
conditions: [unloaded, design]
steps:
  - {name: slow, protocol: spin.yaml, set: {current_A: 0.5}}
  - {name: fast, protocol: spin.yaml}
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    (tmp_path / "spin.yaml").write_text(SPIN)
    (tmp_path / "small.yaml").write_text(SMALL)
    return tmp_path


class Bench:
    """Conducts a campaign here, and remembers which runs were begun."""

    def __init__(self, here):
        self.folder, self.begun, self.told = here / "out", [], []

    def conduct(self, text=None, *, stop_at=None, seed=None, **options):
        """Conduct small.yaml, with another text where one is given; stop in the run of this place."""
        file = self.folder.parent / "small.yaml"
        if text is not None:
            file.write_text(text)
        campaign = load(str(file), seed=seed)
        entries = entries_of(campaign, EntryOptions(self.folder))

        def perform(request, _heading):
            self.begun.append(request.part_of["run"])
            last = stop_at is not None and len(self.begun) == stop_at
            return execute(
                request, confirm_at_once, lambda _progress: nullcontext(), [lambda: "enough" if last else ""]
            )

        return conduct(
            campaign, entries, self.folder, CampaignOptions(perform, self.told.append, attended=False, **options)
        )

    def file_of(self, key):
        """The file of a finished run, by the journal."""
        finished = json.loads((self.folder / "campaign.json").read_text())["finished"]
        return self.folder / f"{finished[key]['run_id']}.h5"

    @property
    def files(self):
        return sorted(self.folder.glob("*.h5"))


@pytest.fixture
def bench(here):
    return Bench(here)
