"""`leactl runs list`: a sweep's run is found by what it was run with, and the rows fit the terminal."""

import json
import os
import pty
import subprocess
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.quantities import ChannelSpec
from leactl.runfile.catalog.selection import ordered, selection_of
from leactl.runfile.catalog.summaries import run_files
from leactl.runfile.summary import Summary
from leactl.runfile.write.run_info import RunInfo
from leactl.runfile.write.writer import RunWriter

from .terminal import COMMAND, leactl

CHANNELS = [ChannelSpec("iq", "q_axis_current", "test", "drive")]


def record(folder, number, protocol, parameters, created, status="complete", actuator="lea-1", condition="design"):
    info = RunInfo(
        run_id=f"{created[:10].replace('-', '')}T100000Z-{protocol}-{number:04d}",
        protocol=protocol,
        bench="emulated",
        actuator=actuator,
        condition=condition,
        operator="",
        simulated=True,
        mechanical="free",
        software="leactl 0.1.0",
        created=created,
        parameters=parameters,
    )
    writer = RunWriter(folder, info, {"loop": CHANNELS})
    writer.append("loop", np.array([0.0, 90.0 * number]), np.ones((2, 1)))
    writer.close(status)
    return writer.path


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """Friction at five holds, one of them stopped, and another protocol; a copy, and a file that is none."""
    folder = tmp_path_factory.mktemp("runs")
    for number, hold in enumerate((6, 10, 8, 7.5, 9), start=1):
        status = "stopped" if hold == 9 else "complete"
        condition = "loaded" if number > 3 else "design"
        parameters = {"hold_s": hold, "levels_A": [1.0, 2.0], "label": "7", "only": [number]}
        record(
            folder,
            number,
            "friction",
            parameters,
            f"2026-11-{10 + number}T10:00:00.000+00:00",
            status,
            "lea-1",
            condition,
        )
    record(folder, 6, "coast-down", {"hold_s": 6, "direction": "both"}, "2026-11-20T10:00:00Z", actuator="lea-2")
    (folder / "copy.h5").write_bytes(next(folder.glob("*0001.h5")).read_bytes())
    (folder / "none.h5").write_text("no run at all")
    return folder


def names(sweep, *words):
    done = leactl("runs", "list", sweep, "--json", *words)
    assert done.returncode == 0, done.stderr
    return [run["file"].removesuffix(".h5").rpartition("-")[2] for run in json.loads(done.stdout)["runs"]]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--where", "hold_s=6", "--protocol", "friction"], ["0001", "copy"]),
        (["--where", "hold_s=7.5"], ["0004"]),
        (["--where", "levels_A=[1, 2]", "--status", "stopped"], ["0005"]),
        (["--where", "label=7", "--where", "hold_s=10.0"], ["0002"]),
        (["--where", "only=[3]"], ["0003"]),
        (["--protocol", "coast-down"], ["0006"]),
        (["--actuator", "lea-2"], ["0006"]),
        (["--condition", "loaded"], ["0004", "0005"]),
        (["--where", "actuator=lea-2"], ["0006"]),
        (["--where", "status=stopped"], ["0005"]),
        (["--where", "protocol=coast-down", "--where", "bench=emulated", "--where", "duration=540"], ["0006"]),
        (["--where", "file=copy.h5"], ["copy"]),
        (["--where", "hold_s >= 7.5 and experiment == 'friction' and condition == 'loaded'"], ["0004", "0005"]),
        (["--where", "hold_s > 7", "--where", "status != 'stopped'", "--where", "hold_s < 10"], ["0003", "0004"]),
        (["--where", "created == '2026-11-14' or like(file, 'copy*')"], ["0004", "copy"]),
        (["--where", "direction is not None and rows == 2 and duration > 60"], ["0006"]),
        (["--since", "2026-11-14", "--until", "2026-11-15"], ["0004", "0005"]),
        (["--since", "2026-11-14T10:00", "--until", "2026-11-15T11:00+01:00"], ["0004"]),
        (["--sort", "hold_s", "--condition", "design"], ["0001", "0006", "copy", "0003", "0002"]),
        (["--sort", "duration", "--reverse", "--protocol", "friction", "--condition", "loaded"], ["0005", "0004"]),
    ],
)  # fmt: skip
def test_runs_are_found_by_what_they_are(sweep, words, expected):
    assert names(sweep, *words) == expected


def test_text_has_file_names_and_the_parameters_that_differ(sweep):
    lines = leactl("runs", "list", sweep).stdout.splitlines()
    first = next(line for line in lines if "0001" in line)
    assert first.split() == [
        "20261111T100000Z-friction-0001.h5",
        "complete",
        "1:30",
        "lea-1",
        "design",
        "hold_s=6",
        "only=1",
    ]
    assert next(line for line in lines if line.startswith("copy.h5")).split()[3] == "friction"
    assert "direction" not in "".join(lines)  # one run alone has it
    assert next(line for line in lines if line.startswith("none.h5")).split(maxsplit=1)[1].startswith("unreadable: ")
    completed = leactl("runs", "list", sweep, "--where", "direction=both")
    assert completed.stdout.split()[-1] == "direction=both"
    assert completed.stderr == "leactl: 1 of 8 files cannot be read and are left out\n"


def test_rows_fit_a_terminal_of_80_columns(sweep):
    hands, place = pty.openpty()
    environment = os.environ | {"COLUMNS": "80", "LINES": "24"}
    subprocess.run([*COMMAND, "runs", "list", str(sweep)], stdout=place, env=environment, check=True)
    os.close(place)
    shown = b""
    try:
        while part := os.read(hands, 4096):
            shown += part
    except OSError:  # the far end is closed and everything was read
        pass
    os.close(hands)
    lines = shown.decode().splitlines()
    assert max(map(len, lines)) <= 80
    assert any("hold_s=7.5" in line for line in lines)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--where", "hold=6"], "--where hold=6: no run has a parameter 'hold'; known: direction, hold_s, label"),
        (["--where", "hold_s"], "--where hold_s: hold_s stands where one of comparisons of names with values"),
        (
            ["--where", "hold_s > 7 and conditon == 'x'"],
            "conditon == 'x': no run has 'conditon'; did you mean 'condition'",
        ),
        (["--status", "done"], "--status done: one of recording, complete, stopped"),
        (["--since", "yesterday"], "--since yesterday: a date as 2026-01-31 or 2026-01-31T13:00 was expected"),
        (["--until", "2026-02-30"], "--until 2026-02-30: a date as"),
        (["--sort", "size"], "--sort size: one of file, created"),
    ],
)
def test_what_no_run_could_fit_is_refused_in_one_line(sweep, words, message):
    done = leactl("runs", "list", sweep, *words)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert message in done.stderr


def test_nothing_that_fits_is_said(sweep):
    done = leactl("runs", "list", sweep, "--actuator", "lea-9")
    assert (done.returncode, done.stdout) == (0, "")
    assert done.stderr.splitlines()[-1] == f"leactl: none of 8 runs in {sweep} is what was asked for"


def test_files_of_a_folder_are_named_without_being_opened(sweep, monkeypatch):
    monkeypatch.setattr("leactl.runfile.catalog.summaries.open_run_file", None)
    assert len(run_files([sweep])) == 8


moments = st.datetimes(datetime(2000, 1, 1), datetime(2100, 1, 1), timezones=st.just(UTC))


@given(created=moments, day=st.dates(datetime(2000, 1, 2).date(), datetime(2099, 1, 1).date()))
def test_days_are_whole_and_of_utc(created, day):
    run = Summary(None, "", 0, created=created.isoformat())
    assert selection_of([run], since=str(day)).fits(run) == (created.date() >= day)
    assert selection_of([run], until=str(day)).fits(run) == (created.date() <= day)


values = (
    st.none() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=3) | st.lists(st.integers(), max_size=3)
)


@given(st.lists(values, min_size=1))
def test_any_parameter_gives_an_order_with_its_lack_last(given_values):
    runs = [
        Summary(None, "", place, parameters={"p": v} if v is not None else {}) for place, v in enumerate(given_values)
    ]
    if all(v is None for v in given_values):
        return
    order = ordered(runs, "p")
    assert sorted(run.size for run in order) == list(range(len(runs)))
    lacking = [not run.parameters for run in order]
    assert lacking == sorted(lacking)
    numbers = [v for run in order if isinstance(v := run.parameters.get("p"), int | float)]
    assert numbers == sorted(numbers)
