"""Hours of bench time on the emulated bench: no process of the run grows in memory or in open files."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HOURS = float(os.environ.get("SOAK_HOURS", "8"))
RATE_HZ = float(os.environ.get("SOAK_RATE_HZ", "250"))
HOLD_S = 600.0
GROWTH = 2.0  # MB, of all processes together, from the second quarter to the last
PROTOCOL = f"""
name: soak
setup: free
rate_Hz: {RATE_HZ:g}
record_Hz: 10
steps:
  - mode: {{test: current}}
  - repeat:
      times: {round(3600 * HOURS / (2 * HOLD_S))}
      steps:
        - hold: {{role: test, current_A: 1.0, duration_s: {HOLD_S:g}}}
        - hold: {{role: test, current_A: -1.0, duration_s: {HOLD_S:g}}}
"""


def family(root):
    """A process and all that it has started, with theirs."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue  # it has ended in the meantime
    results = [root]
    for process in results:
        results += [child for child, parent in parents.items() if parent == process]
    return results


def held_by(processes):
    """Resident memory [MB] and number of open files of these processes together."""
    pages = sum(int(Path(f"/proc/{process}/statm").read_text().split()[1]) for process in processes)
    files = sum(len(os.listdir(f"/proc/{process}/fd")) for process in processes)
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6, files


@pytest.mark.long
def test_hours_of_a_run_take_no_more_memory_and_files_than_its_first(tmp_path):
    (tmp_path / "soak.yaml").write_text(PROTOCOL)
    command = [sys.executable, "-m", "leactl", "run", "soak.yaml", "--events", "-", "--cold"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as run:
        told = [(json.loads(line)["event"], held_by(family(run.pid))) for line in run.stdout]
    assert run.returncode == 0
    # once a second of wall time, until the last step ends; then the file is packed, which takes memory for a moment
    going_on = told[: max(index for index, (event, _) in enumerate(told) if event == "step")]
    looks = [look for event, look in going_on if event == "values"]
    memory, files = zip(*looks[1:], strict=True)  # the first may come before all is begun
    quarter = len(looks) // 4
    second, last = max(memory[quarter : 2 * quarter]), max(memory[3 * quarter :])
    print(f"\n{HOURS:g} h at {RATE_HZ:g} Hz, {len(looks)} looks: {memory[0]:.1f} MB at first, {second:.1f} MB in the")
    print(f"second quarter, {last:.1f} MB in the last; {min(files)} to {max(files)} files open")
    assert last <= second + GROWTH
    assert max(files[quarter:]) <= max(files[:quarter])
