"""`leactl bench check --devices` and `--move` on benches whose file is wrong: each fault is found, and its line named.

The far ends of the wires are those of another bench file than the one that is checked, so that the two can disagree.
"""

import copy
from contextlib import nullcontext

import numpy as np
import pytest
import yaml

from leactl.bench import benchfile
from leactl.emulation.bench import emulated_bench
from leactl.errors import AcceptanceFailed, DeviceError, InputError, SafetyTrip, Stopped
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runner.bench_check.check import check_bench, request_at_rest, request_turning
from leactl.runner.bench_check.statement import StatementVerdict, ratio, wrong
from leactl.runner.bench_check.turning import Slope, factor_of_a_turn, slopes
from leactl.runner.operators import confirm_at_once
from leactl.runner.session import execute

SHIPPED = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
TORQUE, SHAFT = "torque of its current over the motor file's", "velocity over that of test"
TURNS, MOTION, CURRENT = "inertia that its current turns", "angle over integral of velocity", "current over its demand"


def same(_bench):
    """Nothing is changed."""


def device(name, **changes):
    return lambda bench: bench["devices"][name].update(changes)


def drive(name, **settings):
    return lambda bench: bench["devices"][name]["settings"].update(settings)


def torque_sensor(**settings):
    return lambda bench: bench["devices"]["torque_sensor"]["settings"]["inputs"][0].update(settings)


def motor_of_test(**parameters):
    return lambda bench: bench["emulated"].update(test=parameters)


def faults(*entries):
    return lambda bench: bench["emulated"].update(faults=[{"at_s": 0, **entry} for entry in entries])


def reads(name, quantity, gain):
    return {"fault": "scaled_sensor", "device": name, "quantity": quantity, "gain": gain}


def dead(name, **quantity):
    return {"fault": "disconnected_sensor", "device": name, **quantity}


@pytest.fixture
def checked(tmp_path, monkeypatch):
    """Check a bench file, changed by `file`, on a bench that is as `truth` changes it."""

    def check(
        file=same, truth=same, move=True, seed=1, current=None, setup="", agrees=lambda: True, limits=None, lost=None
    ):
        bench = copy.deepcopy(SHIPPED)
        bench["emulated"]["seed"] = seed
        bench["limits"] |= limits or {}
        true = copy.deepcopy(bench)
        file(bench)
        truth(true)
        path, other = tmp_path / "mine.yaml", tmp_path / "true.yaml"
        path.write_text(yaml.safe_dump(bench, sort_keys=False))
        other.write_text(yaml.safe_dump(true))
        true_file, true_devices, _ = benchfile.load(str(other))

        class Wired(emulated_bench.EmulatedBench):
            def __init__(self, _file, devices, *args, **options):
                names = {each.name for each in devices}
                super().__init__(true_file, [each for each in true_devices if each.name in names], *args, **options)
                self.wires["can0"].disturb(lambda frame, _source: None if self.loses(frame) else 0.0)

            def loses(self, frame):
                return lost is not None and frame.identifier == lost[0] and self.time.now() >= lost[1]

        rest = request_at_rest(str(path), setup, tmp_path, False, False, ())
        turn = request_turning(str(path), current, setup, tmp_path, False, False, ()) if move else None
        monkeypatch.setattr(emulated_bench, "EmulatedBench", Wired)
        examined = check_bench(
            rest, turn, lambda request: execute(request, confirm_at_once, lambda _: nullcontext()), agrees
        )
        monkeypatch.undo()
        monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
        return examined

    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    return check


def told(examined):
    return {(each.device, each.about): each for each in examined.statements}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_right_bench_is_contradicted_in_nothing(checked, seed):
    examined = checked(seed=seed)
    assert (examined.end(), wrong(examined.statements)) == (None, [])
    moved = [each for each in examined.statements if each.about in (TORQUE, SHAFT, TURNS, MOTION, CURRENT)]
    assert [each.verdict for each in moved] == [StatementVerdict.OK] * 9
    for outcome in examined.outcomes:
        assert (outcome.status, verify(outcome.path)) == ("complete", [])


def motion(outcome, role="test"):
    with Run.open(outcome.path) as run:
        return [run.channel(quantity, role).values for quantity in ("angle", "velocity")]


def test_a_shaft_of_a_twentieth_of_the_friction_swings_back_and_comes_to_rest(checked):
    smooth = {"coulomb_friction": 0.01, "viscous_damping": 0.0}
    examined = checked(truth=lambda bench: bench["emulated"].update(test=smooth, load=dict(smooth)))
    angle, velocity = motion(examined.outcomes[-1])
    assert examined.outcomes[-1].status == "complete"
    assert 1.0 < np.abs(angle).max() < np.pi  # a sine of the same amplitude pushes it on by 30 rad
    assert abs(velocity[-1]) < 0.1


def test_a_move_goes_no_farther_and_no_faster_than_was_told_before(checked, tmp_path):
    _request, move = request_turning("emulated", None, "", tmp_path, False, False, ())
    angle, velocity = motion(checked().outcomes[-1])
    assert 0.4 * move.travel < np.abs(angle).max() < move.travel
    assert 0.5 * move.speed < np.abs(velocity).max() < move.speed


@pytest.mark.parametrize(("name", "stands"), [("drive_test", 1.3), ("drive_load", -1.3)])
def test_a_move_that_begins_near_the_limit_of_the_angle_is_refused_with_where_the_shaft_stands(checked, name, stands):
    placed = {**reads(name, "angle", 1.0), "offset": stands}
    examined = checked(truth=faults(placed), limits={"angle_rad": 1.5})
    assert isinstance(examined.end(), InputError)
    assert str(examined.end()).startswith(f"--move: {name} stands at {stands:g} rad, and the move may turn it by 0.99")
    assert "; -1.5 to 1.5 rad are allowed (limits.angle_rad, interlocks.angle): turn the shaft" in str(examined.end())
    assert len(examined.outcomes) == 1  # nothing was moved, nothing is latched
    assert examined.outcomes[0].status == "complete"


def test_an_interlock_of_the_angle_leaves_no_more_room_than_a_limit(checked):
    def narrow(bench):
        bench["interlocks"]["angle"] |= {"trip_low_rad": -0.5}

    assert "; -0.5 to inf rad are allowed" in str(checked(narrow, narrow).end())


def test_a_move_that_begins_far_enough_from_the_limit_of_the_angle_is_made(checked):
    examined = checked(truth=faults({**reads("drive_test", "angle", 1.0), "offset": 0.4}), limits={"angle_rad": 1.5})
    assert (examined.end(), len(examined.outcomes)) == (None, 2)


def test_only_one_drive_at_a_time_swings_within_a_quarter_of_a_turn(checked):
    _rest, move = checked().outcomes
    with Run.open(move.path) as run:
        on = [run.channel("drive_enabled", role).values == 1 for role in ("test", "load")]
        current = run.channel("q_axis_current", "test").values
        angle = run.channel("angle", "test").values
    assert not (on[0] & on[1]).any()
    assert all(part.sum() > 100 for part in on)
    assert np.nanmax(np.abs(current)) < 0.2 * 13.7
    assert np.ptp(angle) < np.pi / 2


# what the file says of a bench that is otherwise sound: device, check, value, and the line of the file that is named
WRONG_FILES = {
    "torque sensor turned": (
        torque_sensor(sign=-1),
        "drive_test",
        TORQUE,
        -1.0,
        "torque_sensor.settings.inputs[0].sign",
    ),
    "torque sensor scaled": (
        torque_sensor(scale_per_V=4.5),
        "drive_load",
        TORQUE,
        1.5,
        "torque_sensor.settings.inputs[0].scale_per_V",
    ),
    "second drive mounted the other way": (
        drive("drive_load", sign=-1),
        "drive_load",
        SHAFT,
        -1.0,
        "drive_load.settings.sign",
    ),
    "lines for counts": (
        drive("drive_test", counts_per_turn=10000),
        "drive_load",
        SHAFT,
        0.25,
        "drive_test.settings.counts_per_turn",
    ),
    "lines for counts of the other": (
        drive("drive_load", counts_per_turn=10000),
        "drive_load",
        SHAFT,
        4.0,
        "drive_load.settings.counts_per_turn",
    ),
    "convention of current": (
        drive("drive_test", current_convention="rms"),
        "drive_test",
        TORQUE,
        np.sqrt(0.5),
        "drive_test.settings.current_convention",
    ),
}


@pytest.mark.parametrize("fault", WRONG_FILES)
def test_a_wrong_line_of_the_file_is_named(checked, fault):
    change, name, about, value, line = WRONG_FILES[fault]
    examined = checked(change)
    statement = told(examined)[name, about]
    assert statement.verdict is StatementVerdict.WRONG
    assert statement.measured == pytest.approx(value, rel=0.06)
    assert f"devices.{line}: " in statement.change
    assert ":".join(statement.change.split(":")[:1]).endswith("mine.yaml")
    assert isinstance(examined.end(), AcceptanceFailed)
    if fault.startswith("torque sensor"):  # both drives show it, and nothing else is
        assert {each.about for each in wrong(examined.statements)} == {TORQUE}
        assert told(examined)["drive_load", TORQUE].change.split(":")[:2] == statement.change.split(":")[:2]


def test_a_wrong_torque_constant_is_named_with_its_factor(checked):
    examined = checked(truth=motor_of_test(torque_constant=0.49 * 1.5, back_emf_constant=0.49 * 1.5))
    (statement,) = wrong(examined.statements)
    assert (statement.device, statement.about) == ("drive_test", TORQUE)
    assert statement.measured == pytest.approx(1.5, rel=0.05)
    assert statement.why.startswith("the current is near 3/2")
    assert "torque_constant of motor 'lea' by 1.5" in statement.change


def test_two_encoders_wrong_alike_are_doubted_by_the_inertia(checked):
    examined = checked(
        lambda bench: [drive(f"drive_{role}", counts_per_turn=10000)(bench) for role in ("test", "load")]
    )
    assert wrong(examined.statements) == []
    for role in ("test", "load"):
        statement = told(examined)[f"drive_{role}", TURNS]
        assert (statement.verdict, statement.why[:16]) == (StatementVerdict.UNDECIDED, "as if a turn had")
        assert float(statement.why.split()[5]) == pytest.approx(4.0, rel=0.25)
        assert f"drive_{role}.settings.counts_per_turn" in statement.change


def test_a_drive_that_turns_against_its_current_is_wrong(checked):
    turned = [reads("drive_test", quantity, -1.0) for quantity in ("velocity", "angle")]
    statement = told(checked(truth=faults(*turned)))["drive_test", TURNS]
    assert statement.verdict is StatementVerdict.WRONG
    assert statement.why.startswith("a current turns it backwards")


@pytest.mark.parametrize(
    ("gain", "near"), [(-1.0, "turned"), (60 / (2 * np.pi), "near 2 pi/60"), (2.0, "near 1/2: lines for counts")]
)
def test_a_velocity_that_is_not_the_change_of_the_angle_is_wrong(checked, gain, near):
    statement = told(checked(truth=faults(reads("drive_load", "velocity", gain)), limits={"velocity_rad_s": 400}))
    statement = statement["drive_load", MOTION]
    assert statement.verdict is StatementVerdict.WRONG
    assert statement.measured == pytest.approx(1.0 / gain, rel=0.01)
    assert statement.why.startswith(near)


def test_a_move_that_trips_tells_no_torque_constant(checked):
    examined = checked(truth=faults({**dead("torque_sensor", quantity="torque"), "at_s": 6.0}))
    assert isinstance(examined.end(), SafetyTrip)
    for role in ("test", "load"):
        statement = told(examined)[f"drive_{role}", TORQUE]
        assert (statement.verdict, statement.why) == (StatementVerdict.UNDECIDED, "the move ended early")


@pytest.mark.parametrize("quantity", ["velocity", "angle", "q_axis_current"])
def test_a_dead_channel_of_a_drive_is_named_though_the_bench_trips(checked, quantity):
    examined = checked(truth=faults(dead("drive_test", quantity=quantity)))
    statement = told(examined)["drive_test", CURRENT if quantity == "q_axis_current" else MOTION]
    assert statement.verdict is StatementVerdict.WRONG
    assert ("no current is read" if quantity == "q_axis_current" else f"the {quantity} is constant") in statement.why
    assert isinstance(examined.end(), SafetyTrip)


@pytest.mark.parametrize("name", ["drive_test", "drive_load"])
def test_a_drive_without_any_motion_is_named_where_the_other_turns_the_shaft(checked, name):
    examined = checked(truth=faults(dead(name, quantity="velocity"), dead(name, quantity="angle")))
    statement = told(examined)[name, SHAFT]
    assert statement.verdict is StatementVerdict.WRONG
    assert statement.why.startswith("no velocity of it")


MOTION_OF_TEST, CURRENT_OF_TEST = 0x281, 0x181  # identifiers of what node 1 answers to a SYNC


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("identifier", "quantities", "starved"),
    [(MOTION_OF_TEST, ("velocity", "angle"), (TORQUE, MOTION)), (CURRENT_OF_TEST, ("q_axis_current",), (TORQUE,))],
)
@pytest.mark.parametrize(("at_s", "since"), [(1.19, "1.18"), (3.99, "3.98")])  # before, and while the shaft turns
def test_a_channel_that_falls_silent_is_named_with_its_device_and_the_time(
    checked, identifier, quantities, starved, at_s, since
):
    examined = checked(lost=(identifier, at_s))
    assert isinstance(examined.end(), SafetyTrip)
    for quantity in quantities:
        statement = told(examined)["drive_test", f"{quantity} of test"]
        assert statement.verdict is StatementVerdict.WRONG
        assert statement.why == f"fell silent at {since} s: is its cable, or its bus, loose?"
    for about in starved if at_s < 3 else (TORQUE,):
        assert told(examined)["drive_test", about].verdict is StatementVerdict.UNDECIDED
        assert f"{quantities[0]} of test: fell silent at " in told(examined)["drive_test", about].why


@pytest.mark.filterwarnings("error")
def test_a_silence_that_a_patient_bench_lets_last_is_named_too(checked):
    examined = checked(lost=(MOTION_OF_TEST, 3.0), limits={"cyclic_age_s": 6.0})
    assert [outcome.status for outcome in examined.outcomes] == ["complete", "complete"]
    assert told(examined)["drive_test", "velocity of test"].why.startswith("fell silent at 2.98 s")
    assert "velocity of test: fell silent at 2.98 s" in told(examined)["drive_load", SHAFT].why


def second_sensor(**settings):
    def put(bench):
        bench["devices"]["second"] = copy.deepcopy(bench["devices"]["torque_sensor"])
        bench["devices"]["second"]["settings"]["address"] = 0x49
        bench["devices"]["second"]["settings"]["inputs"][0].update(settings)

    return put


def test_two_sensors_of_one_torque_are_told_and_nothing_is_moved(checked):
    put = second_sensor(location="flange")
    examined = checked(put, put)
    (statement,) = wrong(examined.statements)
    assert isinstance(examined.end(), AcceptanceFailed)
    assert (statement.device, statement.about) == ("torque_sensor", "torque of test")
    assert statement.why == "second measures it too; `--move` and the analyses take one channel only"
    assert "  devices.torque_sensor.settings.inputs[0]: leave it out, or leave second out" in statement.change
    assert len(examined.outcomes) == 1


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({}, "torque of test is measured by torque_sensor too"),
        ({"quantity": "velocity", "scale_per_V": 20}, "velocity of test is measured by drive_test too"),
    ],
)
def test_two_channels_that_no_run_file_tells_apart_are_refused_with_the_file(checked, settings, words):
    with pytest.raises(InputError, match=r"mine.yaml:\d+:\d+  devices.second.settings.inputs\[0\]: " + words):
        checked(second_sensor(**settings))


def test_two_drives_in_one_role_are_refused_with_the_line(checked):
    words = r"mine.yaml:\d+:\d+  devices.drive_load.role: test is the role of drive_test; another one was expected"
    with pytest.raises(InputError, match=words):
        checked(device("drive_load", role="test"))


def test_a_sensor_that_may_stand_for_minutes_is_not_called_frozen_within_a_second(checked):
    def patient(bench):
        bench["interlocks"]["torque"]["stuck_s"] = 600.0

    examined = checked(patient, faults(dead("torque_sensor", quantity="torque")), move=False)
    statement = told(examined)["torque_sensor", "torque of test"]
    assert statement.verdict is StatementVerdict.UNDECIDED
    assert "frozen, or coarser than its noise" in statement.why


def test_a_dead_sensor_is_named_at_rest_and_nothing_is_moved(checked):
    examined = checked(truth=faults(dead("torque_sensor", quantity="torque")))
    (statement,) = wrong(examined.statements)
    assert (statement.device, statement.about) == ("torque_sensor", "torque of test")
    assert statement.why.startswith("frozen: the same in ")
    assert len(examined.outcomes) == 1
    assert isinstance(examined.end(), AcceptanceFailed)


@pytest.mark.parametrize(
    ("file", "truth", "name", "words"),
    [
        (device("drive_load", serial="77"), same, "drive_load", "serial number 2 answers, the bench file says 77"),
        (same, faults(dead("torque_sensor")), "torque_sensor", "bus 'i2c1', address 0x48: not acknowledged"),
    ],
)
def test_a_device_that_cannot_be_opened_is_named_beside_those_that_answer(checked, file, truth, name, words):
    examined = checked(file, truth)
    assert [each.device for each in wrong(examined.statements)] == [name]
    assert told(examined)[name, "answers"].why.startswith(words)
    assert {each.device for each in examined.statements} == {"drive_test", "drive_load", "torque_sensor", "daq"}
    assert isinstance(examined.end(), DeviceError)


def test_firmware_and_serial_number_are_held_against_the_file(checked):
    def state(bench):
        device("drive_load", firmware="Whistle 2", serial="2")(bench)
        device("torque_sensor", serial="A7")(bench)

    statements = told(checked(state, move=False))
    assert statements["drive_load", "serial"].verdict is StatementVerdict.OK
    assert statements["drive_load", "firmware"].verdict is StatementVerdict.WRONG
    assert 'firmware: state firmware: "Whistle 01' in statements["drive_load", "firmware"].change
    assert statements["torque_sensor", "serial"].why == "the bench file says A7, the device reports none"
    assert 'state serial: "1"' in statements["drive_test", "serial"].change


def test_a_sensor_that_says_nothing_is_named_by_the_move_where_no_interlock_says_that_it_has_noise(checked):
    def unwatched(bench):
        bench["interlocks"] = {}

    examined = checked(unwatched, faults(dead("torque_sensor", quantity="torque")))
    at_rest, statement = (told(examined)[key] for key in (("torque_sensor", "torque of test"), ("drive_load", TORQUE)))
    assert at_rest.why == "the same in 41 readings: frozen, or coarser than its noise"
    assert (at_rest.verdict, statement.verdict) == (StatementVerdict.UNDECIDED, StatementVerdict.WRONG)
    assert statement.change.endswith("devices.torque_sensor.settings.inputs[0]: is it connected?")


def test_one_drive_alone_does_not_tell_its_friction_from_its_torque(checked):
    def alone(bench):
        del bench["devices"]["drive_load"]

    statements = told(checked(alone, alone))
    assert statements["drive_test", TORQUE].verdict is StatementVerdict.UNDECIDED
    assert statements["drive_test", TORQUE].why == "it takes a shaft that either drive turns, in turn"
    assert statements["drive_test", TURNS].verdict is StatementVerdict.OK
    assert not [each for each in statements.values() if each.verdict is StatementVerdict.WRONG]


def test_a_shaft_that_does_not_turn_tells_nothing(checked):
    statements = told(checked(current=0.2))
    for about in (TURNS, MOTION, TORQUE):
        assert statements["drive_test", about].verdict is StatementVerdict.UNDECIDED
    assert statements["drive_test", CURRENT].verdict is not StatementVerdict.WRONG


def test_nothing_moves_unless_somebody_agrees(checked):
    examined = checked(agrees=lambda: False)
    assert len(examined.outcomes) == 1
    assert isinstance(examined.end(), Stopped)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"setup": "locked"}, "in set-up 'locked' no drive turns"),
        ({"current": -1.0}, "--current -1: a current above 0 A was expected"),
        ({"current": 29.0, "limits": {"velocity_rad_s": 20}}, "limit is 20 rad/s: lower --current"),
        ({"limits": {"angle_rad": 0.1}}, "limit is 0.1 rad: lower --current"),
    ],
)
def test_a_move_without_room_is_refused_before_a_device_is_opened(checked, tmp_path, options, words):
    with pytest.raises(InputError, match=words.replace("(", r"\(")):
        checked(**options)
    assert not list(tmp_path.rglob("*.h5"))


def test_standard_errors_hold_the_slope_in_noise_that_hangs_together():
    chance = np.random.default_rng(5)
    column = np.sin(np.arange(400) / 10.0)
    off = []
    for _ in range(200):
        noise = np.convolve(chance.normal(size=420), np.ones(8) / 8, "valid")[:400]
        (fit,) = slopes(column[:, np.newaxis], 2.0 * column + noise)
        off.append((fit.value - 2.0) / fit.std)
    assert 0.7 < np.std(off) < 1.4


def test_columns_that_the_samples_do_not_tell_apart_give_no_slope():
    column = np.arange(50.0)
    assert slopes(np.column_stack([column, 2.0 * column]), column) == []
    assert slopes(column[:5, np.newaxis], column[:5]) == []


@pytest.mark.parametrize(
    ("value", "std", "verdict"),
    [
        (1.05, 0.01, "ok"),
        (1.2, 0.01, "wrong"),
        (1.0, 0.05, "cannot tell"),
        (3.0, 0.1, "wrong"),
        (1.0, np.nan, "cannot tell"),
    ],
)
def test_a_ratio_is_judged_by_its_bound_and_its_error(value, std, verdict):
    assert ratio("drive", "about", value, std, 0.1).verdict == verdict


@pytest.mark.parametrize(
    ("value", "near"),
    [
        (41.0, "near 41: pole pairs"),
        (1 / 4, "near 1/4: lines for counts"),
        (-1.0, "turned"),
        (1.17, ""),
        (-1.17, "turned, and by 1.17, which is no usual factor"),
        (6.0, "near 6: a gear, or pole pairs"),
    ],
)
def test_a_factor_of_a_turn_has_a_name(value, near):
    assert factor_of_a_turn(Slope(value, 1e-4), 41) == near


def test_a_turned_factor_of_a_size_that_is_hardly_known_is_given_with_its_size():
    assert factor_of_a_turn(Slope(-1.3, 0.2), 41) == "turned, by 1.3"
    assert factor_of_a_turn(Slope(-1.005, 0.2), 41) == "turned"
