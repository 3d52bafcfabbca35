"""What a list shows of the protocols that ship, without expanding them."""

import json
import shutil
import subprocess
import sys

import pytest

from leactl.protocol import listing, protocolfile, shipped


@pytest.fixture
def copied(tmp_path, monkeypatch):
    folder = shutil.copytree(shipped.folder(), tmp_path / "protocols")
    monkeypatch.setattr(shipped, "folder", lambda: folder)
    return folder


def test_the_durations_beside_the_protocols_are_those_of_their_expansion():
    kept = json.loads((shipped.folder() / listing.DURATIONS).read_text("utf-8"))
    assert kept.items() <= listing.durations().items(), "python -m leactl.protocol.listing prints them anew"


def test_a_list_shows_what_the_plans_have():
    plans = [protocolfile.load(name) for name in shipped.names()]
    assert [tuple(listed) for listed in listing.listed_protocols()] == [
        (plan.name, plan.title, plan.setup, plan.duration_s) for plan in plans
    ]


def test_a_list_imports_neither_numpy_nor_pydantic():
    code = (
        "import sys; from leactl.protocol.listing import listed_protocols; "
        "listed_protocols(); print({*LIBRARIES} & {*sys.modules})"
    )
    code = code.replace("LIBRARIES", "('numpy', 'pydantic')")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_a_protocol_that_was_changed_or_came_is_expanded(copied):
    text = (copied / "torque-constant.yaml").read_text("utf-8")
    longer = text.replace("title: ", "title: Longer, ", 1).replace("hold_s: 1", "hold_s: 2", 1)
    assert longer != text
    (copied / "torque-constant.yaml").write_text(longer, "utf-8")
    (copied / "another.yaml").write_text(text.replace("name: torque-constant", "name: another"), "utf-8")
    rows = {row.name: row for row in listing.listed_protocols()}
    assert rows["torque-constant"].title.startswith("Longer, ")
    assert rows["torque-constant"].duration_s == protocolfile.load("torque-constant").duration_s
    assert rows["another"].duration_s < rows["torque-constant"].duration_s


def test_a_list_does_without_the_durations(copied):
    expected = listing.listed_protocols()
    (copied / listing.DURATIONS).unlink()
    assert listing.listed_protocols() == expected
