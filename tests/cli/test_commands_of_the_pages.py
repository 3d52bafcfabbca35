"""Every command that a page shows parses; what takes seconds is run, and the rest names the test that runs its like."""

import math
import re
import shlex
import shutil
from pathlib import Path

import pytest
import typer

from tests.cli.terminal import leactl
from tests.cli.test_help import by_words

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
LINE = re.compile(r"^(?: {4,}|\$ )(?:\.venv/bin/)?leactl (.*)$|&& \.venv/bin/leactl (.*)$", re.MULTILINE)
# what takes minutes, wants a person or recordings of other machines: the test that runs its like, and the words of it
ELSEWHERE = {
    "--install-completion": ("tests/cli/test_help.py", "--show-completion"),
    "demo": ("tests/cli/test_demo.py", 'interpreted("demo"'),
    "gap demo": ("tests/cli/test_gap_demo.py", '"gap", "demo"'),
    "gap blind make": ("tests/emulation/test_blind.py", '"blind", "make"'),
    "gap blind score": ("tests/gap/test_blind_score.py", '"blind", "score"'),
    "gap diagnose": ("tests/gap/test_gap_commands.py", '"gap", "diagnose"'),
    "gap simulate": ("tests/gap/test_gap_commands.py", '"gap", "simulate"'),
    "gap plan": ("tests/gap/test_planning.py", '"gap", "plan"'),
    "gap loop": ("tests/exchange/test_loop.py", '"gap", "loop"'),
    "model import": ("tests/exchange/test_model_commands.py", '"model", "import"'),
    "model export": ("tests/exchange/test_model_commands.py", '"model", "export"'),
    "driver check room_meter": ("tests/cli/test_driver_new.py", '"driver", "check"'),
    "run ": ("tests/cli/test_run.py", 'leactl("run"'),
    "safety challenge": ("tests/cli/test_challenge.py", '"challenge"'),
    "safety drill": ("tests/cli/test_drill.py", '"drill"'),
    "campaign": ("tests/cli/test_campaign.py", '"campaign"'),
    "thermal fit": ("tests/gap/test_thermal_fit.py", '"thermal", "fit"'),
    "thermal commission": ("tests/cli/test_thermal.py", '"commission"'),
    "bench stop": ("tests/cli/test_bench_stop.py", '"stop"'),
    "bench pause": ("tests/cli/test_bench_stop.py", '"pause"'),
    "bench resume": ("tests/cli/test_bench_stop.py", '"resume"'),
    "bench remark": ("tests/cli/test_bench_stop.py", '"remark"'),
    "bench scan": ("tests/cli/test_bench_scan.py", '"bench", "scan"'),
    "driver replay": ("tests/runner/test_wire_traces.py", '"driver", "replay"'),
    "bench read mine.yaml --follow": ("tests/cli/test_bench_follow.py", '"--follow"'),
    "bench recording": ("tests/driver/test_elmo_serial_wire.py", '"bench", "recording"'),
    "runs trend torque_constant": ("tests/analysis/test_trend.py", '"runs", "trend"'),
    "runs verify runs --scheduler": ("tests/test_scheduler.py", '"--scheduler", address'),
    "runs import": ("tests/runfile/test_import_faults.py", '"runs", "import"'),
    "runs attach": ("tests/runfile/test_attach.py", '"attach"'),
    "analyze runs/*efficiency": ("tests/analysis/test_efficiency.py", "efficiency"),
    "analyze runs/*-current-step": ("tests/analysis/test_control_loops.py", "current-step"),
    "analyze runs/*-winding-rise": ("tests/analysis/test_winding_rise.py", "winding_rise"),
    "analyze heated.h5": ("tests/analysis/test_thermal.py", "thermal"),
}
HERE = ("campaign list", "campaign show", "campaign status")  # of those, what takes no time
OF_SECONDS = ("analyze ", "bench check ", "bench read ", "report ", "runs verify ", "stats ", "thermal ")
IN_PLACE_OF = {  # what the pages call what a reader has
    "runs/RUN.h5": "RUN.h5",
    "RUN": "RUN.h5",
    "run.h5": "RUN.h5",
    "testbed.yaml": "mine.yaml",
    "runs/paper/*-friction-*.h5": "runs/friction-*.h5",
    "runs/*-NAME-*.h5": "runs/friction-*.h5",
    "rehearsal.yaml": "mine.yaml",
}


def lines_of_pages():
    for page in PAGES:
        if page.stem in ("first-protocol", "json-answers"):
            continue  # tests/cli/test_sessions.py and test_json_answers.py run theirs
        for match in LINE.finditer(page.read_text(encoding="utf-8")):
            line = re.split(r"\s+#\s|\s[<>|]+\s", match[1] or match[2])[0].strip()
            yield line, f"{page.name}: {line}"


LINES = dict(lines_of_pages())
TIMED = [line for line in LINES if not line.startswith(tuple(ELSEWHERE)) or line.startswith(HERE)]


def test_the_pages_are_read():
    assert len(LINES) > 120
    assert len(TIMED) > 50


@pytest.mark.parametrize("line", LINES, ids=LINES.values())
def test_a_line_of_a_page_parses(line):
    if line.startswith("--"):
        return
    command, rest = by_words(shlex.split(line))
    given, _, _ = command.make_parser(typer.Context(command)).parse_args(rest)
    assert not [param.name for param in command.params if param.required and not given.get(param.name)]


@pytest.mark.parametrize("head", ELSEWHERE)
def test_what_is_not_run_here_is_run_where_it_is_said(head):
    assert any(line.startswith(head) for line in LINES)
    file, words = ELSEWHERE[head]
    assert words in (ROOT / file).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A folder with the files that the pages speak of."""
    folder = tmp_path_factory.mktemp("workshop")
    state = {"LEACTL_STATE": str(folder / "state"), "COLUMNS": "100", "PYTHONIOENCODING": "utf-8"}
    bench = leactl("bench", "show", "emulated").stdout
    (folder / "mine.yaml").write_text(bench.replace("name: emulated", "name: mine", 1))
    (folder / "nominal.yaml").write_text(leactl("bench", "model", "emulated").stdout)
    turns = [2.0 * math.pi * percent / 100 for percent in range(101)]
    rows = [f"{k},{10 * math.sin(turn)},{-1.5 * math.sin(turn / 2) ** 8}" for k, turn in enumerate(turns)]
    for name in ("walk.csv", "walking.csv"):
        (folder / name).write_text("\n".join(["cycle_percent,angle_deg,torque_Nm_per_kg", *rows]) + "\n")
    for page, kind in (("protocols.md", "staircase|hold-a-current"), ("bench-files.md", "one-drive")):
        text = (ROOT / "docs" / "reference" / page).read_text(encoding="utf-8")
        for name, block in re.findall(rf"```yaml\n(?=name: ({kind}))(.*?)```", text, re.DOTALL):
            (folder / f"{name}.yaml").write_text(block)
    friction = ["--set", "trials=2", "--set", "hold_s=3", "--set", "settle_s=1"]
    for seed, season in enumerate(("spring", "autumn"), start=1):
        for condition in ("unloaded", "design"):
            for protocol, quick in (("friction", friction), ("torque-constant", ["--set", "trials=1"])):
                words = (
                    "--bench",
                    "emulated",
                    "--condition",
                    condition,
                    *quick,
                    "--set",
                    f"seed={seed}",
                    "--out",
                    folder / season,
                )
                done = leactl("run", protocol, *words, **state)
                assert done.returncode == 0, done.stderr
        for path in sorted((folder / season).glob("*.h5")):
            path.rename(path.with_name(re.sub(r"^.*?Z-", "", path.name)))  # friction-1a2b.h5, as the pages have it
        answer = leactl("analyze", *sorted((folder / season).glob("friction*.h5")), "--json", **state).stdout
        (folder / f"answer-{seed}.json").write_text(answer)
        shutil.copytree(folder / season, folder / "runs", dirs_exist_ok=True)
        shutil.copytree(folder / season, folder / "runs" / "paper", dirs_exist_ok=True)
    shutil.copy(next((folder / "runs").glob("torque*.h5")), folder / "RUN.h5")
    return folder


def timed_lines():
    """Each line that is run here, as a parameter; of commands that take seconds, all lines but the first are long."""
    seen = set()
    for line in TIMED:
        slow = next((head for head in OF_SECONDS if line.startswith(head)), None)
        yield pytest.param(line, id=LINES[line], marks=[pytest.mark.long] if slow in seen else [])
        seen |= {slow} - {None}


@pytest.mark.parametrize("line", list(timed_lines()))
def test_a_line_of_a_page_runs(line, workshop, monkeypatch):
    monkeypatch.chdir(workshop)
    words = [IN_PLACE_OF.get(word, word) for word in shlex.split(line)]
    if words[0] == "protocol":  # which calls a protocol what bench pages call a bench
        words = ["staircase.yaml" if word == "mine.yaml" else word for word in words]
    words = [name for word in words for name in (sorted(map(str, Path().glob(word))) if "*" in word else [word])]
    (workshop / "lea.html").unlink(missing_ok=True)
    state = {"LEACTL_STATE": str(workshop / "state"), "COLUMNS": "100", "PYTHONIOENCODING": "utf-8"}
    done = leactl(*(word for word in words if word != "--pdf"), **state)
    assert done.returncode == 0, done.stdout[-500:] + done.stderr
