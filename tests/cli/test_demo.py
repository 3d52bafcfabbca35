"""`leactl demo`, from an empty directory."""

from pathlib import Path

import pytest

from leactl.runfile.verify.integrity import verify
from tests.cli.sessions import BLOCK, LIVE, commands, masked, typed
from tests.cli.terminal import interpreted

TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorial" / "first-protocol.md"


@pytest.mark.long
def test_the_demo_ends_with_the_paper_beside_what_it_found(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = interpreted("demo", COLUMNS="80", PYTHONIOENCODING="utf-8", LEACTL_STATE=str(tmp_path / "state"))
    assert done.returncode == 0, done.stderr

    session = dict(line for block in BLOCK.findall(TUTORIAL.read_text(encoding="utf-8")) for line in commands(block))
    assert masked(LIVE.sub("", done.stderr + done.stdout)) == masked(session["leactl demo"])
    report = "leactl report leactl-demo --html lea.html"
    assert masked(typed(report, tmp_path)) == masked(session[report])

    lines = done.stdout.splitlines()
    tables = {}
    for line in lines[: next(k for k, line in enumerate(lines) if line.startswith("wrote "))]:
        if line.endswith("]"):
            rows = tables.setdefault(line, {})
        elif line and not line.startswith(" "):
            cells = [float(cell) for cell in line.split() if cell.replace(".", "").lstrip("-").isdecimal()]
            rows[line.split()[0]] = cells
    truth = {
        "torque_constant [N*m/A]": {"unloaded": 0.49, "design": 0.49, "loaded": 0.49},
        "viscous_damping [N*m*s/rad]": {"unloaded": 0.0182, "design": 0.0238, "loaded": 0.0255},
        "coulomb_friction [N*m]": {"unloaded": 0.2419, "design": 0.2080, "loaded": 0.3037},
    }
    assert {name: list(rows) for name, rows in tables.items()} == {name: list(rows) for name, rows in truth.items()}
    for name, conditions in truth.items():
        for condition, paper in conditions.items():
            value, _std, low, high, figure, three_std = tables[name][condition]
            assert low < value < high
            assert figure == paper
            assert abs(value - paper) < three_std
    assert max(map(len, lines)) <= 100

    files = [line.removeprefix("wrote ") for line in lines if line.startswith("wrote ")]
    assert sorted(files) == sorted(str(path.relative_to(tmp_path)) for path in tmp_path.glob("leactl-demo/*"))
    assert len(files) == 6
    assert all(verify(tmp_path / name) == [] for name in files)
    assert lines[-1].endswith(f"leactl analyze {files[1]}")
