"""`leactl doctor` as a shell sees it."""

import json
import os

import pytest

from tests.cli.terminal import leactl


@pytest.fixture
def lacking(tmp_path, monkeypatch):
    """A leactl whose metadata asks for a package that is not there."""
    monkeypatch.chdir(tmp_path)  # metadata in the working directory comes first
    folder = tmp_path / "leactl-0.1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: leactl\nVersion: 0.1.0\nRequires-Dist: no-such-package>=1\n"
    )
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])}


def test_a_machine_with_all_that_is_needed_is_status_0():
    done = leactl("doctor")
    assert done.returncode == 0, done.stdout
    assert "ok      package python-can: " in done.stdout
    assert "ok      driver elmo_can: leactl 0.1.0" in done.stdout
    assert "MISSING" not in done.stdout


def test_what_is_absent_comes_with_the_command_that_mends_it():
    lines = leactl("doctor").stdout.splitlines()
    absent = [number for number, line in enumerate(lines) if line.startswith("absent ")]
    assert all(lines[number + 1].startswith("        mend: ") for number in absent)


def test_a_browser_that_prints_is_looked_for(tmp_path):
    (tmp_path / "chromium").write_text("#!/bin/sh\n")
    without = leactl("doctor", PATH=str(tmp_path))
    assert "absent  Chromium: none in PATH; `leactl report --pdf` needs one\n        mend: sudo" in without.stdout
    (tmp_path / "chromium").chmod(0o755)
    there = leactl("doctor", PATH=str(tmp_path))
    assert f"ok      Chromium: {tmp_path / 'chromium'}\n" in there.stdout
    assert (without.returncode, there.returncode) == (0, 0)


def test_json_is_pure_and_holds_every_finding():
    done = leactl("doctor", "--json")
    answer = json.loads(done.stdout)
    assert answer["fine"] is True
    findings = {finding["subject"]: finding for finding in answer["findings"]}
    assert {"python", "package numpy", "driver ads1115", "disk"} <= findings.keys()
    assert all(set(finding) == {"subject", "fine", "needed", "found", "mend"} for finding in answer["findings"])
    assert all(finding["mend"] for finding in answer["findings"] if not finding["fine"])


def test_a_package_that_is_needed_and_missing_is_status_2(lacking):
    done = leactl("doctor", **lacking)
    assert done.returncode == 2
    expected = "MISSING package no-such-package: not installed\n        mend: pip install no-such-package\n"
    assert expected in done.stdout
    answered = leactl("doctor", "--json", **lacking)
    assert answered.returncode == 2
    assert json.loads(answered.stdout)["fine"] is False
