"""Steps of imported recordings: an export of a run, imported again by each way, gives the run's own results."""

import json

import numpy as np
import pytest

from leactl.errors import InputError
from leactl.runfile.importing.importer import import_runs
from leactl.runfile.read.reader import Run
from tests.cli.terminal import leactl

CSV = """
mechanical: free
run: {protocol: friction, actuator: a1}
streams:
  loop:
    time: {column: "time [s]"}
    channels:
      iq_ref: {column: "test_iq_ref [A]", quantity: q_axis_current_reference}
      iq: {column: "test_iq [A]", quantity: q_axis_current}
      omega: {column: "test_omega [rad/s]", quantity: velocity}
      theta: {column: "test_theta [rad]", quantity: angle}
"""
HOLDS = "steps_by_holds: {channel: loop/iq_ref, parameter: current_A, least_s: 2.9, settle_s: 1.5}\n"


def answered(*arguments):
    done = leactl(*arguments, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def friction(tmp_path_factory):
    """A short run of the emulated bench, its table, and what it says of itself."""
    here = tmp_path_factory.mktemp("friction")
    chosen = ("--set", "hold_s=3", "--set", "settle_s=1.5", "--set", "trials=1", "--out", here)
    run = answered("run", "friction", *chosen)["run"]
    answered("runs", "export", run, "--format", "csv", "--out", here / "csv")
    [table] = (here / "csv").glob("*.loop.csv")
    return here, run, table, results(run, "friction")


def results(run, experiment, *options):
    return {line["name"]: line for line in answered("analyze", run, "--as", experiment, *options)["results"]}


def imported(here, table, text):
    mapping = here / "map.yaml"
    mapping.write_text(text)
    out = here / f"imported-{len(list(here.glob('imported-*')))}"
    [file] = import_runs([str(table)], mapping, out)
    return file


def by_instants(run):
    with Run.open(run) as found:
        steps = [(s.start, s.stop, s.settle, s.parameters) for s in found.steps if s.name == "hold"]
    lines = [
        f"  - {{name: hold, start_s: {start}, stop_s: {stop}, settle_s: {settle},"
        f" parameters: {{current_A: {about['current_A']}, direction: {about['direction']}}}}}"
        for start, stop, settle, about in steps
    ]
    return "\n".join(["steps:", *lines, ""])


def with_labels(run, table):
    """The table with a column of labels that are empty between the holds."""
    with Run.open(run) as found:
        holds = [(s.start, s.stop) for s in found.steps if s.name == "hold"]
    head, *lines = table.read_text().splitlines()
    rows = [head + ",phase"]
    for line in lines:
        time = float(line.split(",")[0])
        number = next((n for n, (start, stop) in enumerate(holds) if start <= time < stop), None)
        rows.append(f"{line},{'' if number is None else f'level {number % 2}'}")
    labelled = table.with_name("labelled.csv")
    labelled.write_text("\n".join(rows) + "\n")
    return labelled


BY_COLUMN = """
steps_by_column:
  stream: loop
  column: phase
  names: {"level 0": hold, "level 1": hold}
  settle_s: 1.5
  parameters: {current_A: loop/iq_ref}
"""


@pytest.mark.parametrize("way", ["instants", "column", "holds"])
def test_friction_of_an_imported_table_is_that_of_the_run(friction, way):
    here, run, table, expected = friction
    source = with_labels(run, table) if way == "column" else table
    steps = {"instants": by_instants(run), "column": BY_COLUMN, "holds": HOLDS}[way]
    file = imported(here, source, CSV + steps)
    result = results(file, "friction", "--torque-constant", "0.49")
    for name in ("viscous_damping", "coulomb_friction"):
        assert abs(result[name]["value"] - expected[name]["value"]) < expected[name]["std"]
    with Run.open(file) as kept, Run.open(run) as own:
        assert len(kept.steps) >= sum(step.name == "hold" for step in own.steps)
        assert any("steps" in event.message for event in kept.events)


@pytest.mark.parametrize(
    ("steps", "place"),
    [
        ("steps: [{name: hold, start_s: 0, stop_s: 1e6}]\n", "steps[0]"),
        ("steps: [{name: hold, start_s: 1, stop_s: 3}, {name: hold, start_s: 2, stop_s: 4}]\n", "steps[1]"),
        ("steps: [{name: hold, start_s: 3, stop_s: 3}]\n", "not before"),
        ("steps_by_column: {stream: loop, column: phase, names: {a: hold}}\n", "phase"),
        ('steps_by_column: {stream: loop, column: "test_enabled [1]", names: {7: hold}}\n', "7"),
        ("steps_by_column: {stream: other, column: phase, names: {a: hold}}\n", "other"),
        ("steps_by_holds: {channel: loop/iq_ref, parameter: current_A, least_s: 1e4}\n", "loop/iq_ref"),
        ("steps_by_holds: {channel: loop/none, parameter: current_A, least_s: 1}\n", "loop/none"),
        ("steps_by_holds: {channel: loop/iq_ref, parameter: current_A, least_s: 1, settle_s: 2}\n", "settle_s"),
        (HOLDS + "steps: [{name: hold, start_s: 0, stop_s: 1}]\n", "stands beside steps"),
    ],
)
def test_steps_that_cannot_be_are_one_line_and_nothing_is_written(friction, tmp_path, steps, place):
    *_, table, _ = friction
    mapping = tmp_path / "map.yaml"
    mapping.write_text(CSV + steps)
    with pytest.raises(InputError) as refused:
        import_runs([str(table)], mapping, tmp_path / "out")
    assert any(line.startswith(f"{mapping}:") and place in line for line in refused.value.faults)
    assert not (tmp_path / "out").exists()


SMALL = """
mechanical: free
csv: {{delimiter: ";", decimal: "{decimal}"}}
streams:
  loop:
    time: {{column: t}}
    channels: {{iq: {{column: iq, quantity: q_axis_current_reference}}}}
{steps}
"""


def small_table(path, levels, decimal="."):
    """Two seconds a level at 50 rows a second: stamps, the level, and the level again."""
    rows = [f"{k * 0.02:.2f};{level!r};{level!r}" for k, level in enumerate(np.repeat(levels, 100).tolist())]
    path.write_text("\n".join(["t;iq;phase", *rows, ""]).replace(".", decimal))
    return path


def steps_in(file):
    with Run.open(file) as run:
        return [(step.name, round(step.start, 6), round(step.stop, 6), step.parameters) for step in run.steps]


@pytest.mark.parametrize("column", ["iq", "phase"])
@pytest.mark.parametrize(
    ("levels", "decimal"), [((0.5, 1.0, 1.5), "."), ((0.5, 1.0, 1.5), ","), ((20000.01, 20000.02), ".")]
)
def test_a_column_that_tells_steps_may_be_a_channel_too(tmp_path, column, levels, decimal):
    names = ", ".join(f"{level}: level_{number}" for number, level in enumerate(levels))
    by = f"steps_by_column: {{stream: loop, column: {column}, names: {{{names}}}, parameters: {{current_A: loop/iq}}}}"
    table = small_table(tmp_path / "log.csv", levels, decimal)
    expected = [
        (f"level_{n}", 2.0 * n, pytest.approx(2.0 * n + 2.0, abs=0.021), {"current_A": level})
        for n, level in enumerate(levels)
    ]
    assert steps_in(imported(tmp_path, table, SMALL.format(decimal=decimal, steps=by))) == expected


def test_parts_of_a_recording_keep_the_column_that_tells_their_steps(tmp_path):
    by = "steps_by_column: {stream: loop, column: phase, names: {2: hold}}\n"
    parts = "parts: [{suffix: a, time_s: [0, 3]}, {suffix: b, time_s: [3, 5.9]}]\n"
    (tmp_path / "map.yaml").write_text(SMALL.format(decimal=".", steps=parts + by))
    table = small_table(tmp_path / "log.csv", (1.0, 2.0, 3.0))
    first, second = import_runs([str(table)], tmp_path / "map.yaml", tmp_path / "out")
    assert steps_in(first) == [("hold", 2.0, 2.98, {})]
    assert steps_in(second) == [("hold", 0.0, 1.0, {})]


def test_two_names_for_one_label_are_refused(tmp_path):
    by = "steps_by_column: {stream: loop, column: phase, names: {2: a, 2.0: b}}\n"
    with pytest.raises(InputError, match=r"steps_by_column\.names: label 2 stands twice"):
        imported(tmp_path, small_table(tmp_path / "log.csv", (1.0, 2.0)), SMALL.format(decimal=".", steps=by))


@pytest.mark.parametrize(("silent", "told"), [((4.0, 6.0), ""), ((5.0, 6.0), "settle_s: "), ((4.0, 5.0), "")])
def test_a_step_without_a_reading_lacks_its_parameter_and_a_settled_part_without_one_is_refused(tmp_path, silent, told):
    by = """steps_by_column: {stream: loop, column: phase, names: {1: hold, 2: hold, 3: hold}, settle_s: 1,
      parameters: {current_A: loop/iq, role: load, repeat: 2}}"""
    table = small_table(tmp_path / "log.csv", (1.0, 2.0, 3.0))
    rows = [row.split(";") for row in table.read_text().splitlines()]
    rows[1:] = [[t, "" if silent[0] <= float(t) < silent[1] else iq, phase] for t, iq, phase in rows[1:]]
    table.write_text("\n".join(map(";".join, rows)) + "\n")
    text = SMALL.format(decimal=".", steps=by)
    if told:
        with pytest.raises(InputError, match=f"{told}.*loop/iq has no reading from 5 s to 5.98 s"):
            imported(tmp_path, table, text)
        return
    last = {} if silent == (4.0, 6.0) else {"current_A": 3.0}
    outcomes = [about for *_, about in steps_in(imported(tmp_path, table, text))]
    fixed = {"role": "load", "repeat": 2}
    assert outcomes == [{"current_A": 1.0} | fixed, {"current_A": 2.0} | fixed, last | fixed]
