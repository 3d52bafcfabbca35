"""`leactl bench check` refuses what `leactl run` refuses; --devices and --move as a shell sees them."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.bench.benchfile import SHIPPED, names
from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters
from leactl.errors import InputError
from leactl.model.motor import load_motor
from leactl.runfile.read.reader import Run
from leactl.runner.checked_bench import load_checked
from leactl.runner.request import prepare
from tests.cli.terminal import leactl
from tests.runner.conftest import SPIN

TEXT = (SHIPPED / "emulated.yaml").read_text()
LEA = load_motor("lea")[1].text


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spin.yaml").write_text(SPIN)
    return tmp_path


def emulated(block, **limits):
    text = TEXT.partition("\nemulated:")[0]
    for name, value in limits.items():
        before = next(line for line in text.splitlines() if line.strip().startswith(f"{name}:"))
        text = text.replace(before, f"  {name}: {value}")
    return f"{text}\nemulated:\n{block}"


FAULTS = {
    "emulated parameter": (
        emulated("  test: {bogus: 2}\n"),
        "emulated.test.bogus: unknown parameter; known are winding,",
    ),
    "emulated motor": (
        emulated("  motors: {test: nobody}\n"),
        "emulated.motors.test: motor 'nobody' is not known",
    ),
    "negative resistance": (
        emulated("  test: {phase_resistance: -2}\n"),
        "emulated.test.phase_resistance: -2 is outside 1e-12 to inf",
    ),
    "resistance in words": (
        emulated('  load: {phase_resistance: "abc"}\n'),
        "emulated.load.phase_resistance: found 'abc', expected a number",
    ),
    "thermal": (emulated("  test: {thermal: 3}\n"), "emulated.test.thermal: found 3, expected parameters by name"),
    "thermal node": (
        emulated("  test: {thermal: {winding: 3}}\n"),
        "emulated.test.thermal.winding: unknown parameter; known are winding_ambient_resistance,",
    ),
    "bench parameter": (
        emulated("  bench: {position_gainn: 38}\n"),
        "emulated.bench.position_gainn: unknown parameter; known are bus_voltage,",
    ),
    "effect": (emulated("  effects: [{name: bogus}]\n"), "emulated.effects[0]: effect 'bogus' is unknown; known are"),
    "effect's parameter": (
        emulated("  effects: [{effect: cogging, parameters: {bogus: 1}}]\n"),
        "emulated.effects[0]: effect cogging: bogus: unknown parameter",
    ),
    "effect's key": (
        emulated("  effects: [{effect: cogging, parameter: {amplitude: 1}}]\n"),
        "emulated.effects[0].parameter: unknown key; effect and parameters were expected",
    ),
    "condition": (
        emulated("  conditions: {design: {}, loaded: {viscous_dampening: 1}}\n"),
        "emulated.conditions.loaded.viscous_dampening: unknown parameter; known are",
    ),
    "current limit": (
        emulated("  seed: 1\n", current_A="1e12"),
        "limits.current_A: 1e+12 A takes the test winding to its temperature limit within the ",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_run_refuses_bench_check_refuses_in_the_same_line(here, fault):
    text, words = FAULTS[fault]
    (here / "mine.yaml").write_text(text)
    lines = []
    for command in (["bench", "check", "mine.yaml"], ["run", "spin.yaml", "--bench", "mine.yaml"]):
        done = leactl(*command)
        assert (done.returncode, done.stdout) == (2, ""), done.stdout
        assert len(done.stderr.splitlines()) == 1
        lines.append(done.stderr)
    assert lines[0] == lines[1]
    place, _, message = lines[0].partition("  ")
    file, line, column = place.removeprefix("leactl: ").split(":")
    assert file == "mine.yaml"
    assert int(line) > 1
    assert int(column) >= 1
    assert message.startswith(words)


def own_motor(here, text):
    (here / "own.yaml").write_text(text)
    (here / "mine.yaml").write_text(TEXT.replace("test: lea", "test: own.yaml"))
    assert "own.yaml" in (here / "mine.yaml").read_text()
    with pytest.raises(InputError) as refused:
        load_checked("mine.yaml")
    with pytest.raises(InputError) as of_run:
        prepare("spin.yaml", "mine.yaml", (), "", "", "", here / "runs", False)
    assert of_run.value.faults == refused.value.faults
    return refused.value.faults


@pytest.mark.parametrize(("name", "words"), [("bogus", "motor 'bogus' is not known"), ("no.yaml", "No such file")])
def test_a_motor_that_is_not_there_is_told_where_the_bench_names_it(here, name, words):
    (here / "mine.yaml").write_text(TEXT.replace("test: lea", f"test: {name}"))
    with pytest.raises(InputError) as refused:
        load_checked("mine.yaml")
    assert refused.value.faults[0].startswith("mine.yaml:")
    assert "  motors.test: " in refused.value.faults[0]
    assert words in refused.value.faults[0]


def test_half_a_motor_file_is_refused_with_the_keys_that_it_lacks(here):
    faults = own_motor(here, "name: half\nwinding: wye\npole_pairs: 4\nphase_resistance: 0.3\n")
    assert {fault.partition("  ")[2].partition(":")[0] for fault in faults} >= {"torque_constant", "thermal", "limits"}
    assert all(fault.startswith("own.yaml:") for fault in faults)


@pytest.mark.parametrize("both", [False, True])
def test_a_torque_constant_that_the_motor_s_own_figures_contradict_is_refused(here, both):
    text = LEA.replace("torque_constant: 0.49", "torque_constant: 490")
    if both:
        text = text.replace("back_emf_constant: 0.49", "back_emf_constant: 490")
    faults = own_motor(here, text)
    told = [fault for fault in faults if "  torque_constant: 490 N*m/A is " in fault and "mend the wrong one" in fault]
    assert len(told) == (2 if both else 3)


def test_a_motor_without_tolerances_is_refused_by_the_check_too(here):
    lines = LEA.splitlines(keepends=True)
    start = next(i for i, line in enumerate(lines) if line.startswith("tolerances:"))
    [fault] = own_motor(here, "".join(lines[:start]))
    assert "no `tolerances:`" in fault


@pytest.mark.parametrize("name", names())
def test_every_shipped_bench_passes(name):
    load_checked(name)


@given(
    st.sampled_from(sorted({*ActuatorParameters.__dataclass_fields__, *BenchParameters.__dataclass_fields__})),
    st.data(),
)
def test_no_key_with_a_letter_wrong_is_taken_in_silence(tmp_path_factory, key, data):
    at = data.draw(st.integers(0, len(key) - 1))
    wrong = key[:at] + data.draw(st.sampled_from("aeixz")) + key[at:]
    block = "test" if key in ActuatorParameters.__dataclass_fields__ else "bench"
    path = tmp_path_factory.mktemp("bench") / "mine.yaml"
    path.write_text(emulated(f"  {block}: {{{wrong}: 1}}\n"))
    with pytest.raises(InputError, match=f"emulated.{block}.{wrong}: unknown parameter"):
        load_checked(str(path))


@pytest.mark.parametrize(
    "command",
    [
        ("bench", "show"),
        ("bench", "model"),
        ("protocol", "plan", "spin.yaml", "--bench"),
        ("thermal", "state", "--bench"),
        ("thermal", "plan", "spin.yaml", "--bench"),
        ("safety", "drill"),
    ],
    ids=" ".join,
)
def test_every_command_that_reads_a_bench_refuses_what_the_check_refuses(here, command):
    (here / "mine.yaml").write_text(emulated("  test: {bogus: 2}\n"))
    refused = leactl("bench", "check", "mine.yaml")
    done = leactl(*command, "mine.yaml")
    assert (done.returncode, done.stdout, done.stderr) == (2, "", refused.stderr)
    assert refused.stderr.startswith("leactl: mine.yaml:")


REAL = (SHIPPED / "testbed.yaml").read_text()


def test_a_bus_interface_that_does_not_exist_is_refused_with_the_one_that_was_probably_meant(here, monkeypatch):
    monkeypatch.setenv("LEACTL_MACHINE_STATE", str(here / "machine"))
    (here / "real.yaml").write_text(REAL.replace("interface: socketcan", "interface: socketcann", 1))
    done = leactl("bench", "check", "real.yaml")
    assert (done.returncode, done.stdout) == (2, "")
    assert "  buses.can0.interface: python-can has no interface 'socketcann'; socketcan was expected" in done.stderr
    put = leactl("bench", "read", "testbed", "--bus", "can0=no-such-thing:0")
    assert put.returncode == 2
    assert "bus 'can0': python-can has no interface 'no-such-thing'; one of " in put.stderr


def test_a_bus_put_elsewhere_on_a_bench_emulated_here_is_refused():
    done = leactl("run", "spin.yaml", "--bus", "can0=vcan:0")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "leactl: --bus can0=vcan:0: bench 'emulated' has its buses in this process;"
        " --served meets one that another process serves\n"
    )


MIRRORED = TEXT.replace("{node: 2,", "{node: 2, sign: -1,")  # the drive counts against its far end's shaft


def test_a_move_prints_a_line_for_each_check_and_the_line_to_change(here):
    (here / "mine.yaml").write_text(MIRRORED)
    done = leactl("bench", "check", "mine.yaml", "--move", LEACTL_STATE=str(here / "state"))
    assert done.returncode == 6
    lines = done.stdout.splitlines()
    number = next(at for at, line in enumerate(lines) if "velocity over that of test" in line)
    assert lines[number].split()[:2] == ["wrong", "drive_load"]
    assert ", expected 0.9897 to 1.01; turned" in lines[number]
    place = next(at for at, line in enumerate(MIRRORED.splitlines(), 1) if "sign: -1" in line)
    assert lines[number + 1].strip().startswith(f"mine.yaml:{place}:")
    assert "devices.drive_load.settings.sign: turn it" in lines[number + 1]
    assert lines[-1].endswith(" 2 wrong, 6 cannot tell")
    assert done.stderr.splitlines()[-1].startswith("leactl: 2 of 29 checks are wrong: drive_load: velocity over")


def test_without_a_move_no_drive_is_engaged(here):
    done = leactl("bench", "check", "emulated", "--devices", "--json", LEACTL_STATE=str(here / "state"))
    answer = json.loads(done.stdout)
    assert (done.returncode, len(answer["runs"]), answer["bench"]) == (0, 1, "emulated")
    with Run.open(answer["runs"][0]["run"]) as run:
        assert not any(run.channel("drive_enabled", role).values.any() for role in ("test", "load"))


def test_a_dry_run_tells_the_move_and_opens_nothing(here):
    done = leactl("bench", "check", "testbed", "--move", "--dry-run", "--json", LEACTL_STATE=str(here / "state"))
    answer = json.loads(done.stdout)
    assert (done.returncode, answer["name"]) == (0, "check-swinging")
    assert [peak["value"] for peak in answer["peaks"]] == [pytest.approx(1.87, rel=0.01)] * 2
    assert "one drive after the other swings the shaft, test 1.87 A and load 1.87 A, up to " in done.stderr
    assert not (here / "runs").exists()


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["testbed", "--move"], "a real bench is asked for before it moves, and stdin is no terminal; --yes agrees"),
        (["emulated", "--current", "1"], "--current: goes with --move alone"),
        (["emulated", "--devices", "--yes"], "--yes: goes with --move alone"),
        (["emulated", "--dry-run"], "--dry-run: goes with --devices or --move alone"),
        (["emulated", "--move", "--current", "31"], "the bench's limit is 40 rad/s: lower --current"),
        (
            ["emulated", "--move", "--setup", "heated"],
            "in set-up 'heated' no drive turns",
        ),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_line(here, words, fault):
    done = leactl("bench", "check", *words, LEACTL_STATE=str(here / "state"))
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert fault in done.stderr
