"""leactl from Python: the page's snippets and the notebooks run as they stand, and what the page lists is there."""

import inspect
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import nbclient
import nbformat
import pytest

import leactl
from leactl.runfile.read.reader import Run
from tests.cli.terminal import leactl as command

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "how-to" / "python.md").read_text(encoding="utf-8")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder with the model that the page and the notebooks speak of, and a state of its own."""
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    (tmp_path / "nominal.yaml").write_text(command("bench", "model", "emulated").stdout)
    return tmp_path


def test_the_snippets_run_one_after_the_other_as_they_stand(folder):
    snippets = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(snippets) == 5
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(snippets)], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("complete runs/")
    assert lines[1].startswith("complete coupled {")
    [told] = [re.findall(r"\d\.\d{4}", line) for line in lines if " N*m/A, 95 % " in line]
    low, high = float(told[1]), float(told[2])
    assert 0.48 < low < float(told[0]) < high < 0.5
    assert any(re.match(r"(none|calibration) \[\]", line) for line in lines)
    assert (folder / "gap.html").is_file()


def test_every_member_that_the_page_lists_is_there():
    table = PAGE.split("|---|---|")[-1]
    members = {
        name for cell in re.findall(r"^\| (.*?) \|", table, re.MULTILINE) for name in re.findall(r"`(\w+)", cell)
    }
    assert len(members - {"run"}) >= 12
    assert members - {"run"} <= dict(inspect.getmembers(Run)).keys() | {"steps"}


def test_every_function_that_the_page_lists_is_offered():
    listed = set(re.findall(r"^\| `leactl\.(\w+)\(", PAGE, re.MULTILINE))
    assert listed == {"open_run", "run_protocol", "analyze", "diagnose", "simulate"}
    assert all(callable(getattr(leactl, name)) for name in listed)


@pytest.mark.parametrize("name", [path.stem for path in sorted((DOCS / "notebooks").glob("*.ipynb"))])
def test_a_notebook_runs_from_its_first_cell_to_its_last(folder, name):
    notebook = nbformat.read(DOCS / "notebooks" / f"{name}.ipynb", as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells), "a notebook is kept without outputs"
    nbclient.NotebookClient(
        notebook, timeout=240, kernel_name="python3", resources={"metadata": {"path": folder}}
    ).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", ()) if "data" in output]
    frames = [output.data["text/html"] for output in shown if "text/html" in output.data]
    assert frames
    assert all(frame.startswith('<iframe srcdoc="') for frame in frames)
    if name == "diagnosis":
        assert "cogging" in frames[0]


def test_importing_leactl_loads_nothing_that_is_not_used():
    loaded = (
        "import sys, leactl, json; print(json.dumps([m for m in sys.modules if m.startswith(('numpy', 'leactl'))]))"
    )
    done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == ["leactl"]


def test_what_is_offered_is_what_the_stub_and_the_interface_have():
    stub = (Path(leactl.__file__).with_suffix(".pyi")).read_text(encoding="utf-8")
    assert tuple(re.findall(r"import (\w+) as \1", stub)) == leactl.INTERFACE
    assert set(leactl.INTERFACE) <= set(dir(leactl))
    assert all(getattr(leactl, name).__module__.startswith("leactl.") for name in leactl.INTERFACE)


def test_what_is_not_offered_is_refused_with_what_is():
    with pytest.raises(AttributeError, match=r"no attribute 'analyse'; it has Analysis, Channel, Diagnosis"):
        leactl.analyse  # noqa: B018 (the access is what is tried)
