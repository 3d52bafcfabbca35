"""The journal: what is written is read, and nothing else passes for it."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.errors import InputError
from leactl.runner.campaign.campaignfile import load
from leactl.runner.campaign.journal import JOURNAL_FILE, Finished, new_journal, read, save

CAMPAIGN = load("paper")
JOURNAL = (
    new_journal(CAMPAIGN, {cell.key: f"{index:016x}" for index, cell in enumerate(CAMPAIGN.cells)})
    .ended(CAMPAIGN.cells[0].key, Finished(run_id="a", bench_s=1.5, wall_s=0.1, unmet=("b is 1, 2 was required",)))
    .begun(CAMPAIGN.cells[1].key, "c")
)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign")
    save(JOURNAL, folder)
    return folder, (folder / JOURNAL_FILE).read_bytes()


def test_what_is_written_is_read_and_nothing_else_is_left(written):
    folder, data = written
    (folder / JOURNAL_FILE).write_bytes(data)
    assert read(folder, CAMPAIGN) == JOURNAL
    assert [path.name for path in folder.iterdir()] == [JOURNAL_FILE]


def test_a_folder_without_a_journal_has_none(tmp_path):
    assert read(tmp_path, CAMPAIGN) is None


@given(place=st.floats(0, 1, exclude_max=True), what=st.one_of(st.none(), st.binary(min_size=0, max_size=3)))
@settings(max_examples=80)
def test_no_other_bytes_pass_for_it(written, place, what):
    folder, data = written
    at = int(place * len(data))
    changed = data[:at] if what is None else data[:at] + what + data[at + 1 :]
    (folder / JOURNAL_FILE).write_bytes(changed)
    try:
        result = read(folder, CAMPAIGN)
    except InputError as refused:
        assert len(str(refused).splitlines()) == 1
        assert str(folder / JOURNAL_FILE) in str(refused)
    else:
        assert result == JOURNAL  # white space, or the same byte again


@pytest.mark.parametrize("text", ["[]", "{}", '{"format": "leactl-run"}', "null", "1" * 5000, "[" * 100_000])
def test_a_foreign_file_is_refused_in_one_line(tmp_path, text):
    (tmp_path / JOURNAL_FILE).write_text(text)
    with pytest.raises(InputError) as refused:
        read(tmp_path, CAMPAIGN)
    assert len(str(refused.value).splitlines()) == 1


def test_a_version_to_come_is_refused(written):
    folder, data = written
    body = json.loads(data)
    body["format_version"] = 2
    (folder / JOURNAL_FILE).write_text(json.dumps(body))
    with pytest.raises(InputError, match="damaged"):
        read(folder, CAMPAIGN)
