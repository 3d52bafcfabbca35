"""A campaign is gone on with: what is finished stays, what is not is made, and what does not fit is refused."""

import json
from importlib import resources

import h5py
import pytest

from leactl.errors import DeviceError, InputError, Stopped
from leactl.protocol.protocolfile import load
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runner.campaign import folder as campaign_folder
from tests.runner.campaign.conftest import SMALL, SPIN

EVERY = ["slow//unloaded/1", "fast//unloaded/1", "slow//design/1", "fast//design/1"]


def status(path):
    with Run.open(path) as run:
        return run.status


def test_every_run_is_made_once_in_its_order_and_tells_what_it_is_part_of(bench):
    ended = bench.conduct()
    assert ended.error is None
    assert bench.begun == EVERY
    lasts = load(str(bench.folder.parent / "spin.yaml")).duration_s
    assert [(value.bench_s, value.wall_s > 0.0) for value in ended.journal.finished.values()] == [(lasts, True)] * 4
    for path, key in zip(sorted(bench.files, key=lambda one: one.stat().st_mtime_ns), EVERY, strict=True):
        assert verify(path) == []
        with Run.open(path) as run:
            told = dict(event.message.split(" = ") for event in run.events if event.source == "campaign")
            assert (told["name"], told["run"]) == ("small", key)
            assert f"{told['step']}//{run.attributes['condition']}/{told['repeat']}" == key


def test_repeats_on_an_emulated_bench_are_not_the_same_run_again(bench):
    head, _, _ = SMALL.partition("conditions")
    bench.conduct(head + "steps:\n  - {name: spin, protocol: spin.yaml, repeats: 3}\n")
    readings = set()
    for path in bench.files:
        with Run.open(path) as run:
            readings.add(run.channel("q_axis_current").values.tobytes())
    assert len(readings) == 3


def test_a_stopped_run_is_made_again_and_lies_apart_from_the_finished_ones(bench):
    first = bench.conduct(stop_at=3)
    assert isinstance(first.error, Stopped)
    assert len(first.journal.finished) == 2
    assert bench.conduct().error is None
    assert bench.begun == [*EVERY[:3], *EVERY[2:]]
    assert [status(path) for path in bench.files] == ["complete"] * 4
    assert [status(path) for path in (bench.folder / "unfinished").glob("*.h5")] == ["stopped"]
    again = bench.conduct()
    assert (len(again.journal.finished), len(bench.begun)) == (4, 5)


def test_a_run_that_ended_before_the_journal_knew_is_not_made_again(bench):
    bench.conduct(stop_at=3)
    before = (bench.folder / "campaign.json").read_text()
    bench.conduct(stop_at=5)
    (bench.folder / "campaign.json").write_text(before)  # as a power loss after the run's close leaves it
    bench.conduct()
    assert bench.begun == [*EVERY[:3], *EVERY[2:4], *EVERY[3:]]


def test_finished_runs_whose_files_are_gone_are_named_and_made_again_when_asked(bench):
    bench.conduct(stop_at=4)
    deleted, damaged, cut = (bench.file_of(key) for key in EVERY[:3])
    deleted.unlink()
    with h5py.File(damaged, "r+") as file:
        file["streams/loop/time"][0] -= 1e-3  # a value that nobody recorded
    cut.write_bytes(cut.read_bytes()[:-5000])
    with pytest.raises(InputError) as refused:
        bench.conduct()
    lines = str(refused.value).splitlines()
    assert [line.partition(" ")[0] for line in lines] == EVERY[:3]
    for line, path, why in zip(
        lines, (deleted, damaged, cut), ("is missing", "checksum mismatch", "truncated"), strict=True
    ):
        assert path.name in line
        assert why in line
        assert "--redo-lost" in line
    assert len(bench.begun) == 4
    assert bench.conduct(redo_lost=True).error is None
    assert bench.begun[4:] == EVERY
    assert [status(path) for path in bench.files] == ["complete"] * 4
    assert all(verify(file) == [] for file in bench.files)


def test_a_damaged_journal_is_refused_and_the_runs_are_found_without_it(bench):
    bench.conduct(stop_at=3)
    journal = bench.folder / "campaign.json"
    journal.write_text(journal.read_text()[:-100])
    with pytest.raises(InputError, match="damaged: no JSON") as refused:
        bench.conduct()
    assert len(str(refused.value).splitlines()) == 1
    journal.unlink()
    assert bench.conduct().error is None
    assert bench.begun == [*EVERY[:3], *EVERY[2:]]


@pytest.mark.parametrize(
    ("change", "words"),
    [({"text": SMALL.replace("name: small", "name: other")}, "of campaign 'small'"), ({"seed": 7}, "of seed '1', '7'")],
)
def test_a_folder_of_another_campaign_is_refused(bench, change, words):
    bench.conduct(stop_at=2)
    with pytest.raises(InputError, match=words):
        bench.conduct(**change)


def test_a_change_of_what_is_finished_is_refused(bench):
    bench.conduct(stop_at=3)
    (bench.folder.parent / "spin.yaml").write_text(SPIN.replace("hold_s: 0.3", "hold_s: 0.4"))
    for accept in (False, True):
        with pytest.raises(InputError, match=r"slow//unloaded/1, fast//unloaded/1 are finished, and"):
            bench.conduct(accept_changes=accept)
    (bench.folder / "campaign.json").unlink()
    with pytest.raises(InputError, match="are finished, and"):
        bench.conduct()


def test_a_change_of_a_signal_s_file_or_of_a_motor_file_is_one_of_the_runs(bench):
    folder = bench.folder.parent
    (folder / "motor.yaml").write_text((resources.files("leactl.model") / "motors" / "lea.yaml").read_text())
    shown = (resources.files("leactl.bench") / "files" / "emulated.yaml").read_text()
    (folder / "mine.yaml").write_text(
        shown.replace("motors: {test: lea, load: lea}", "motors: {test: motor.yaml, load: lea}")
    )
    (folder / "swing.csv").write_text("time_s,setpoint_A\n0,0\n0.5,0.7\n1.0,0\n")
    signal = "signal: {role: test, kind: csv, path: swing.csv, column: setpoint_A}"
    spin = SPIN.replace("hold: {role: test, current_A: $current_A, duration_s: $hold_s}", signal)
    (folder / "spin.yaml").write_text(spin.replace("parameters: {current_A: 0.7, hold_s: 0.3}\n", ""))
    campaign = "name: small\nbench: mine.yaml\nsteps: [{name: spin, protocol: spin.yaml, repeats: 2}]\n"
    bench.conduct(campaign, stop_at=2)
    for name, old, new in (("swing.csv", "0.5,0.7", "0.5,0.9"), ("motor.yaml", "0.0024", "0.0025")):
        before = (folder / name).read_text()
        assert old in before
        (folder / name).write_text(before.replace(old, new))
        with pytest.raises(InputError, match=r"(is|are) finished, and"):
            bench.conduct(campaign)
        (folder / name).write_text(before)
    assert bench.conduct(campaign).error is None


def test_a_change_of_what_is_left_is_gone_on_with_when_asked(bench):
    bench.conduct(stop_at=3)
    longer = SMALL.replace("0.5", "0.5, hold_s: 0.3") + "  - {name: last, protocol: spin.yaml, conditions: [design]}\n"
    with pytest.raises(InputError, match=r"1 added of 5 runs, none of them finished; --accept-changes"):
        bench.conduct(longer)
    assert len(bench.conduct(accept_changes=True).journal.finished) == 5
    assert len(bench.begun) == 3 + 3
    assert set(json.loads((bench.folder / "campaign.json").read_text())["runs"]) > set(EVERY)


def test_nothing_is_begun_where_a_later_run_is_at_fault(bench):
    with pytest.raises(InputError) as refused:
        bench.conduct(
            SMALL.replace("design]", "icy]")
            + "  - {name: none, protocol: no-such}\n"
            + "  - {name: strong, protocol: spin.yaml, set: {current_A: 300, x: 1}}\n"
        )
    lines = str(refused.value).splitlines()
    assert any("small.yaml:8:5  steps[2]: protocol 'no-such' is not known" in line for line in lines)
    assert any("small.yaml:9:66  steps[3].set.x: no such parameter" in line for line in lines)
    with pytest.raises(InputError) as refused:
        bench.conduct(SMALL.replace("design]", "icy]").replace("current_A: 0.5", "current_A: 50"))
    lines = str(refused.value).splitlines()
    assert any("  steps[0]: " in line and "50 A" in line for line in lines)
    icy = "small.yaml:4:24  conditions[1]: condition 'icy' is not one of the emulated bench's"
    assert any(icy in line for line in lines)
    assert bench.begun == []


def test_an_analysis_that_is_not_known_is_refused_before_the_first_run(bench):
    (bench.folder.parent / "coast.yaml").write_text(SPIN.replace("analysis: friction", "analysis: coastdown"))
    with pytest.raises(InputError, match=r"  steps\[2\]: .*coast\.yaml:4:11  analysis: 'coastdown' is not known"):
        bench.conduct(SMALL + "  - {name: coast, protocol: coast.yaml}\n")
    assert bench.begun == []


def test_a_protocol_too_hot_from_ambient_is_refused_before_the_first_run(bench):
    hot = SPIN.replace("setup: free", "setup: locked")
    (bench.folder.parent / "hot.yaml").write_text(hot)
    step = "  - {name: hot, protocol: hot.yaml, conditions: [design], set: {current_A: 28, hold_s: 6}}\n"
    with pytest.raises(InputError, match=r"small\.yaml:8:5  steps\[2\]: .*may take the test winding to its limit"):
        bench.conduct(SMALL + step)
    assert bench.begun == []


def test_an_acceptance_limit_that_is_not_met_does_not_end_a_campaign_and_is_not_forgotten(bench):
    limit = "acceptance:\n  - {result: coulomb_friction, low: 5, unit: N*m}\n"
    (bench.folder.parent / "spin.yaml").write_text(SPIN + limit)
    assert len(bench.conduct(SMALL.replace("unloaded, ", "")).unmet) == 2
    assert len(bench.conduct().unmet) == 2
    (bench.folder / "campaign.json").unlink()
    again = bench.conduct()
    assert (len(bench.begun), len(again.unmet)) == (2, 2)
    assert "fast//design/1: acceptance: coulomb_friction is not known, 5 to inf was required" in "\n".join(again.unmet)


def test_a_folder_is_held_by_one_process(bench):
    with campaign_folder.held(bench.folder):
        assert campaign_folder.busy(bench.folder)
        with pytest.raises(DeviceError, match="is conducted already, process"):
            bench.conduct()
    assert not campaign_folder.busy(bench.folder)


def test_runs_of_others_in_the_folder_are_left_alone(bench):
    bench.conduct(stop_at=2)
    other = bench.folder.parent / "elsewhere"
    other.mkdir()
    path = bench.file_of(EVERY[0])
    path.rename(other / path.name)
    (bench.folder / "notes.h5").write_text("no run")
    with pytest.raises(InputError, match="is missing"):
        bench.conduct()
    (other / path.name).rename(path)
    assert bench.conduct().error is None
    assert (bench.folder / "notes.h5").read_text() == "no run"
