"""Input that cannot be used: one line a fault, each at its place, all at once, and before anything is expanded."""

import time
import tracemalloc

import pytest

from leactl import yamlfile
from leactl.errors import InputError
from leactl.protocol import protocolfile
from tests.protocol.writing import plan, read, text


def faults(*steps, **head):
    with pytest.raises(InputError) as caught:
        plan(*steps, **head)
    return caught.value.faults


@pytest.mark.parametrize(
    ("step", "line"),
    [
        # keys and units
        ("hold: {duration_ms: 5500}", "9:25  steps[1].hold.duration_ms: 5500: unknown key; duration_s was expected"),
        (
            "sweep: {role: test, levels_A: [1], hold_ms: 5500}",
            "9:49  steps[1].sweep.hold_ms: 5500: unknown key; hold_s was expected",
        ),
        (
            "set: {role: test, current_mA: 500}",
            "9:35  steps[1].set.current_mA: 500: unknown key; current_A was expected",
        ),
        (
            "grid: {axes: [{role: test, levels_mA: [1]}], hold_s: 1}",
            "9:43  steps[1].grid.axes[0].levels_mA: unknown key; levels_A was expected",
        ),
        ("tare: {samples: 3, x: 1}", "9:27  steps[1].tare.x: 1: unknown key; one of samples was expected"),
        # types and bounds
        ("hold: {duration_s: '1'}", "9:24  steps[1].hold.duration_s: '1': a number was expected"),
        ("hold: {duration_s: true}", "9:24  steps[1].hold.duration_s: true: a number was expected"),
        (
            "chirp: {role: test, from_Hz: 1}",
            "9:12  steps[1].chirp: no such step; signal: {kind: chirp, ...} was expected",
        ),
        (
            "ramp: {role: test, to: 3, duration_s: 1}",
            "9:28  steps[1].ramp.to: 3: unknown key; to_current_A, to_velocity_rad_s or to_angle_rad was expected",
        ),
        ("hold: {duration_s: 0}", "9:24  steps[1].hold.duration_s: 0: more than 0 was expected"),
        ("hold: {duration_s: 1e9}", "9:24  steps[1].hold.duration_s: 1000000000.0: at most 604800 was expected"),
        ("hold: 5", "9:11  steps[1].hold: 5: a mapping with keys of name, role, current_A"),
        ("tare: {samples: 2.5}", "9:21  steps[1].tare.samples: 2.5: a whole number was expected"),
        ("tare: {samples: 0}", "9:21  steps[1].tare.samples: 0: 1 or more was expected"),
        ("sweep: {role: test, levels_A: 3, hold_s: 1}", "9:35  steps[1].sweep.levels_A: 3: a list was expected"),
        ("prompt: ''", "9:5  steps[1].prompt: '': a text was expected"),
        ('prompt: "a\\e[31m"', "9:13  steps[1].prompt: a text of one printable line was expected"),
        # modes
        (
            "set: {role: test, velocity_rad_s: 3}",
            "9:39  steps[1].set.velocity_rad_s: 3: test is in current mode at this point; current_A was expected",
        ),
        (
            "set: {role: load, current_A: 3}",
            "9:34  steps[1].set.current_A: 3: load is in velocity mode at this point; velocity_rad_s was expected",
        ),
        (
            "sweep: {role: test, levels_A: [1], hold_s: 1, rate_rad_s: 2}",
            "9:63  steps[1].sweep.rate_rad_s: 2: test is in current mode at this point; rate_A_s was expected",
        ),
        (
            "grid: {axes: [{role: load, levels_A: [1]}], hold_s: 1}",
            "9:42  steps[1].grid.axes[0].levels_A: load is in velocity mode at this point; levels_rad_s was expected",
        ),
        (
            "signal: {role: test, kind: sine, amplitude_rad: 1, frequency_Hz: 1, duration_s: 1}",
            "9:53  steps[1].signal.amplitude_rad: 1: test is in current mode at this point; amplitude_A was expected",
        ),
        (
            "set: {role: test}",
            "9:10  steps[1].set.current_A: is required and missing (test is in current mode at this point)",
        ),
        ("mode: {test: currant}", "9:18  steps[1].mode.test: 'currant': 'off', 'current'"),
        ("mode: {}", "9:11  steps[1].mode: a mode for test, load or both was expected"),
        # between keys
        (
            "ramp: {role: test, to_current_A: 1}",
            "9:11  steps[1].ramp.duration_s: either duration_s or rate_A_s was expected",
        ),
        (
            "ramp: {role: test, to_current_A: 1, duration_s: 1, rate_A_s: 1}",
            "9:53  steps[1].ramp.duration_s: either duration_s or rate_A_s was expected",
        ),
        ("hold: {current_A: 1, duration_s: 1}", "9:11  steps[1].hold.role: is required and missing where a setpoint"),
        (
            "hold: {duration_s: 1, settle_s: 1}",
            "9:37  steps[1].hold.settle_s: a settle window of 1 s leaves nothing of 1 s; less was expected",
        ),
        ("hold: {duration_s: 0.001}", "9:24  steps[1].hold.duration_s: 0.001 s: at least one cycle (0.01 s)"),
        (
            "record: {rate_Hz: 30}",
            "9:23  steps[1].record.rate_Hz: 30 Hz: a whole part of rate_Hz (100 Hz) was expected",
        ),
        ("record: {rate_Hz: 200}", "9:23  steps[1].record.rate_Hz: 200 Hz: a whole part of rate_Hz (100 Hz)"),
        (
            "wait_until: {quantity: velocity, role: test, below: 1, unit: rpm, timeout_s: 1}",
            "9:66  steps[1].wait_until.unit: 'rpm': velocity is in rad/s",
        ),
        (
            "wait_until: {quantity: velocity, role: test, unit: rad/s, timeout_s: 1}",
            "9:17  steps[1].wait_until.below: below, above or both were expected",
        ),
        (
            "wait_until: {quantity: velocity, role: test, below: 1, above: 2, unit: rad/s, timeout_s: 1}",
            "9:57  steps[1].wait_until.below: no value is below 1 and above 2",
        ),
        (
            "wait_until: {quantity: speed, role: test, below: 1, unit: rad/s, timeout_s: 1}",
            "9:28  steps[1].wait_until.quantity: 'speed': one of q_axis_current_reference",
        ),
        (
            "grid: {axes: [{role: test, levels_A: [1]}, {role: test, levels_A: [1]}], hold_s: 1}",
            "9:55  steps[1].grid.axes[1].role: test is an axis already",
        ),
        # steps
        ("hodl: {duration_s: 1}", "9:11  steps[1].hodl: no such step; hold was expected"),
        ("xyz: 1", "9:10  steps[1].xyz: no such step; one of bisect, grid, hold, mode"),
        ("4", "9:5  steps[1]: a mapping of one key was expected, one of bisect, grid, hold, mode"),
        (
            "{prompt: a, tare: {samples: 1}}",
            "9:5  steps[1]: a mapping of one key was expected, one of bisect, grid, hold",
        ),
        ("repeat: {times: 2, steps: []}", "9:31  steps[1].repeat.steps: a list of 1 or more was expected"),
        ("repeat: {times: 2, steps: [{hold: {duration_s: -1}}]}", "9:52  steps[1].repeat.steps[0].hold.duration_s: -1"),
        (
            "repeat: {times: 9, steps: [{set: {role: load, current_A: 1}}]}",
            "9:62  steps[1].repeat.steps[0].set.current_A: 1: load is in velocity mode",
        ),
    ],
)
def test_a_step_that_cannot_be_used(step, line):
    told = faults(step)
    assert len(told) == 1
    assert told[0].startswith(f"trial.yaml:{line}")


@pytest.mark.parametrize(
    ("step", "words"),
    [
        (
            "ramp: {role: test, to_angle_rad: 1, duration_s: 1}",
            "steps[1].ramp.to_angle_rad: the angle of test is not known",
        ),
        (
            "sweep: {role: test, levels_rad: [1], hold_s: 1, rate_rad_s: 1}",
            "steps[1].sweep.rate_rad_s: the angle of test",
        ),
        (
            "grid: {axes: [{role: test, levels_rad: [1], rate_rad_s: 1}], hold_s: 1}",
            "steps[1].grid.axes[0].rate_rad_s: the angle of test is not known",
        ),
        ("set: {role: load, current_A: 1}", "steps[1].set.role: load is off at this point; a mode step before it"),
    ],
)
def test_a_role_that_is_not_ready(step, words):
    (line,) = faults(step, mode="{test: angle}")
    assert words in line


@pytest.mark.parametrize(
    ("source", "lines"),
    [
        ("", ["trial.yaml:1:1  a mapping with keys of name, title"]),
        ("- 1\n", ["trial.yaml:1:1  a mapping with keys of name, title"]),
        ("name: a\nname: b\n", ["trial.yaml:2:1  name: this key stands twice"]),
        ("a: &a [*a]\n", ["trial.yaml:1:4  a: anchors and aliases are not accepted"]),
        ("name: [", ["trial.yaml:1:8  "]),
        ("name: !!python/name:os.system ls\n", ["trial.yaml:1:7  name: tag"]),
        (text("hold: {duration_s: .inf}"), ["trial.yaml:9:24  steps[1].hold.duration_s: .inf: a finite number"]),
        (text("hold: {duration_s: 1}").replace("name", "nam"), ["trial.yaml:1:6  nam: 'trial': unknown key; name was"]),
        (
            text("hold: {duration_s: 1}").replace("coupled", "loose"),
            ["trial.yaml:2:8  setup: 'loose': 'free', 'locked'"],
        ),
        (text("hold: {duration_s: 1}", rate_Hz=0), ["trial.yaml:3:10  rate_Hz: 0: more than 0 was expected"]),
        (text("hold: {duration_s: 1}", more="record_Hz: 30"), ["trial.yaml:6:12  record_Hz: 30 Hz: a whole part of"]),
        (
            text("hold: {duration_s: 1}", more="acceptance: [{result: a, unit: A}]"),
            ["trial.yaml:6:14  acceptance[0]: low, high or both were expected"],
        ),
        (
            text("hold: {duration_s: 1}", more="acceptance: [{result: a, low: 2, high: 1, unit: A}]"),
            ["trial.yaml:6:31  acceptance[0].low: 2 is above high (1)"],
        ),
        ("name: a\nsetup: free\nrate_Hz: 50\nsteps: []\n", ["trial.yaml:4:8  steps: a list of 1 or more was expected"]),
    ],
)
def test_a_file_that_cannot_be_used(source, lines):
    with pytest.raises(InputError) as caught:
        read(source)
    assert len(caught.value.faults) == len(lines)
    assert all(line.startswith(start) for line, start in zip(caught.value.faults, lines, strict=True))


def test_all_faults_come_at_once_in_the_order_of_the_file():
    told = faults(
        "set: {role: load, current_A: 3}",
        "repeat: {times: 3, steps: [{hold: {duration_s: $hold_s, settle_ms: 3}}, {prompt: 4}]}",
        "sweep: {role: test, levels_rad: [1], hold_s: -1}",
        "sweep: {role: test, levels_rad: [1], hold_s: 1}",
        more="record_Hz: 33",
        conditions="{x: {nothing: 1}}",
        overrides={"b": "2"},
    )
    assert [line.split("  ")[0].removeprefix("trial.yaml:") for line in told] == [
        "--set b=2: no such parameter; known: none",
        "5:27",
        "6:12",
        "9:34",
        "10:52",
        "10:72",
        "10:86",
        "11:50",
        "12:37",
    ]


def test_behind_a_faulty_mode_step_nothing_is_said_about_modes():
    (line,) = faults("mode: {test: speed}", "set: {role: test, velocity_rad_s: 3}")
    assert "steps[1].mode.test" in line


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (
            ["sweep: {role: test, levels_A: [1], hold_s: 1, repeats: 1000000000}"],
            "repeats: 1000000000: at most 100000 was",
        ),
        (["sweep: {role: test, levels_A: [1], hold_s: 1, repeats: 1e9}"], "repeats: 1000000000.0: a whole number"),
        (["sweep: {role: test, levels_A: [1, 2], hold_s: 0.02, repeats: 99999}"], "more than 100000 actions"),
        (["repeat: {times: 1e9, steps: [{tare: {samples: 1}}]}"], "times: 1000000000.0: a whole number"),
        (["repeat: {times: 1000000000, steps: [{tare: {samples: 1}}]}"], "times: 1000000000: at most 100000 was"),
        (
            ["repeat: {times: 99999, steps: [{repeat: {times: 99999, steps: [{tare: {samples: 1}}]}}]}"],
            "steps[1].repeat.steps[0].repeat: the protocol reaches more than 100000 actions here",
        ),
        (
            ["hold: {duration_s: 604800}", "hold: {duration_s: 1}"],
            "steps[2].hold: the protocol reaches more than 604800 s",
        ),
        (["ramp: {role: test, to_current_A: 1, rate_A_s: 1.0e-9}"], "more than 604800 s of duration"),
        (["signal: {role: test, kind: sine, amplitude_A: 1, frequency_Hz: 1, duration_s: 60000}"], "more than 5000000"),
        (
            [
                "signal: {role: test, kind: multisine, amplitude_A: 1, from_Hz: 1, to_Hz: 2, count: 999,"
                " duration_s: 9000}"
            ],
            "9000 s of 999 frequencies is too much to compute",
        ),
        (
            [
                "grid: {axes: [{role: load, levels_rad_s: "
                f"{list(range(400))}}}, {{role: test, levels_A: {list(range(400))}}}], hold_s: 0.02}}"
            ],
            "steps[1].grid: the protocol reaches more than 100000 actions here",
        ),
    ],
)
def test_what_multiplies_itself_is_refused_while_it_is_small(steps, words):
    tracemalloc.start()
    try:
        started = time.perf_counter()
        told = faults(*steps)
        spent, (_now, peak) = time.perf_counter() - started, tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(told) == 1
    assert words in told[0]
    assert spent < 8
    assert peak < 150e6


def test_a_key_with_a_line_break_stays_one_line():
    (line,) = faults('hold: {duration_s: 1, "a\\nb": 1}')
    assert "\n" not in line


def test_a_long_value_is_cut():
    (line,) = faults(f"hold: {{duration_s: '{'x' * 5000}'}}")
    assert len(line) < 600
    assert line.endswith("a number was expected")


def test_a_file_that_is_absent_or_not_known(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.yaml: No such file"):
        protocolfile.load(str(tmp_path / "nowhere.yaml"))
    with pytest.raises(
        InputError, match=r"protocol 'torque' is not known; known: .*back-emf, .*friction, .*torque-constant.*, or"
    ):
        protocolfile.load("torque")


def test_a_file_that_is_too_large(tmp_path):
    path = tmp_path / "large.yaml"
    path.write_text("# " + "x" * yamlfile.MAX_BYTES)
    with pytest.raises(InputError, match="bytes was expected"):
        protocolfile.load(str(path))
