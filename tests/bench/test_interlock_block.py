"""The `interlocks:` block at the door: what cannot be meant, or would never trip, is one line with its place."""

import json

import pytest

from leactl.bench import benchfile
from leactl.bench.bench import Bench, require_channels_for_interlocks
from leactl.bench.wiring import MachineWiring
from leactl.errors import InputError
from tests.cli.terminal import leactl


def written(tmp_path, interlocks, more=""):
    head, _, rest = (benchfile.SHIPPED / "emulated.yaml").read_text().partition("interlocks:")
    rest = rest.partition("response:")[2]
    if more:
        head = head.replace("limits:\n", f"{more}limits:\n")
    path = tmp_path / "mine.yaml"
    path.write_text(f"{head}interlocks:\n  {interlocks}\nresponse:{rest}")
    return path


def refused(path):
    with pytest.raises(InputError) as caught:
        file, devices, document = benchfile.load(str(path))
        require_channels_for_interlocks(Bench(file, devices, MachineWiring()), document)
    return caught.value.faults


@pytest.mark.parametrize(
    ("interlocks", "column", "message"),
    [
        ("torqe: {trip_Nm: 3}", 10, "interlocks.torqe: unknown key"),
        ("torque: {trip: 3}", 11, "interlocks.torque: trip carries no unit; trip_Nm was expected"),
        ("torque: {trip_Nm: 3, for: 1}", 11, "interlocks.torque: for carries no unit; for_s was expected"),
        ("torque: {trip_A: 3}", 20, "interlocks.torque.trip_A: 3: unknown key; trip_Nm was"),
        (
            "torque: {warn_Nm: 4, trip_Nm: 3}",
            11,
            "interlocks.torque: warn_Nm 4 is beyond the trip of 3; it would never warn",
        ),
        (
            "bus_voltage: {warn_low_V: 23, trip_low_V: 24}",
            16,
            "interlocks.bus_voltage: warn_low_V 23 is beyond the trip of 24; it would never warn",
        ),
        (
            "torque: {trip_Nm: 3, for_s: -0.1}",
            31,
            "interlocks.torque.for_s: -0.1: 0 or more was expected",
        ),
        ("torque: {rate_Nm_per_s: 0}", 27, "interlocks.torque.rate_Nm_per_s: 0: more than 0 was expected"),
        ("torque: {trip_Nm: -3}", 11, "interlocks.torque: trip_Nm -3 is a magnitude; more than 0 was expected"),
        ("torque: {for_s: 1}", 11, "interlocks.torque: for_s 1 s is how long beyond a trip; trip_Nm is missing"),
        ("torque: {role: test}", 11, "interlocks.torque: says nothing; trip_Nm or another value was expected"),
        ("torque: {trip_Nm: 3, trip_low_Nm: 1}", 11, "interlocks.torque: trip_Nm stands beside a low or a high one"),
        (
            "bus_voltage: {trip_low_V: 40, trip_high_V: 30}",
            16,
            "interlocks.bus_voltage: trip_low_V 40 is not below its high one, 30",
        ),
        ("[{trip_Nm: 3}]", 3, "interlocks: a mapping "),
        (
            "housing_temperature: {trip_degC: 358}",
            24,
            "interlocks.housing_temperature: trip_degC 358 is no temperature of a bench; -40 to 200 degC was expected",
        ),
        (
            "torque: {trip_Nm: 18}",
            11,
            "interlocks.torque: a trip at 18 N*m is beyond the limits of -17 to 17 N*m, which trip first",
        ),
        (
            "torque: {trip_Nm: 3, for_s: 1e9}",
            31,
            "torque.for_s: 1000000000.0: it would never trip in time; 60 s or less was",
        ),
        ("torque: {age_s: 61}", 19, "torque.age_s: 61: it would never trip in time; 60 s or less was expected"),
        (
            "torque: {stuck_s: 1e9}",
            21,
            "torque.stuck_s: 1000000000.0: it would never trip in time; 86400 s or less was",
        ),
        (
            "supply: {expected_V: 29.6, band_V: 5, for_s: 1e9}",
            48,
            "supply.for_s: 1000000000.0: it would never trip in time; 60",
        ),
        (
            "torque: {rate_Nm_per_s: 4e5}",
            11,
            "rate_Nm_per_s 400000 would never trip; 340000 N*m per second or less was",
        ),
        ("q_axis_voltage: {rate_V_per_s: 1e300}", 19, "rate_V_per_s 1e+300 would never trip; 1e+07 V per second"),
        (
            "current_disagreement: {floor_A: 1e6}",
            35,
            "current_disagreement.floor_A: 1e+06 would never trip; 1.5 (5 % of limits.current_A) or less was expected",
        ),
        ("torque_disagreement: {tolerance_Nm: 18}", 39, "18 would never trip; 17 (limits.torque_Nm) or less"),
        ("voltage_disagreement: {tolerance_V: 1e6}", 39, "would never trip"),
        ("velocity_disagreement: {tolerance_rad_s: 1e6}", 44, "would never trip"),
        ("torque_disagreement: {tolerance_Nm: 1, for_s: 0}", 49, "for_s: 0: more than 0 was expected"),
        ("loop_overruns: {share_percent: 100}", 34, "share_percent: 100: less than 100 was expected"),
        ("clock: {jump_s: -1}", 19, "interlocks.clock.jump_s: -1: more than 0 was expected"),
        ("disk_space: {warn_MB: 1, trip_MB: 2}", 15, "interlocks.disk_space: warn_MB 1 is beyond the trip of 2"),
    ],
)
def test_a_fault_is_one_line_with_its_place(tmp_path, interlocks, column, message):
    path = written(tmp_path, interlocks)
    line = next(n for n, text in enumerate(path.read_text().splitlines(), 1) if text.strip() == interlocks)
    faults = refused(path)
    assert any(fault.startswith(f"{path}:{line}:{column}  ") and message in fault for fault in faults), faults


@pytest.mark.parametrize("key", ["age_s", "cyclic_age_s"])
def test_a_limit_of_age_that_nobody_lives_to_see_is_refused(tmp_path, key):
    path = written(tmp_path, "torque: {trip_Nm: 3}")
    text = path.read_text()
    path.write_text(
        text.replace("limits:\n", "limits:\n  cyclic_age_s: 0.1\n").replace(f"  {key}: ", f"  {key}: 1e9 # ")
    )
    assert any(
        f"limits.{key}: 1000000000.0: it would never trip in time; 60 s or less" in fault for fault in refused(path)
    )


@pytest.mark.parametrize(
    ("interlocks", "message"),
    [
        ("drive_temperature: {trip_degC: 85}", "drive_temperature: no device measures a drive_temperature; it would"),
        ("torque: {role: load, trip_Nm: 3}", "torque: no device measures a torque of role 'load'; it would never trip"),
    ],
)
def test_an_interlock_on_what_nobody_measures_is_refused(tmp_path, interlocks, message):
    (fault,) = refused(written(tmp_path, interlocks))
    assert message in fault
    assert f"{tmp_path}/mine.yaml:" in fault


THERMISTOR = """  thermistor:
    driver: ads1115
    bus: i2c1
    role: bench
    settings:
      address: 73
      inputs: [{name: t, quantity: housing_temperature, role: test, pins: A0, scale_per_V: 100}]
"""


def test_a_temperature_that_is_measured_needs_a_trip(tmp_path):
    (fault,) = refused(written(tmp_path, "clock: {jump_s: 1}", THERMISTOR))
    assert "housing_temperature: thermistor measures it of role 'test', and no trip_degC says" in fault
    (fault,) = refused(written(tmp_path, "housing_temperature: {role: test, warn_degC: 70}", THERMISTOR))
    assert "and no trip_degC says how hot it may be" in fault
    path = written(tmp_path, "housing_temperature: {role: test, trip_degC: 85}", THERMISTOR)
    file, devices, document = benchfile.load(str(path))
    require_channels_for_interlocks(Bench(file, devices, MachineWiring()), document)


def test_a_bench_without_limits_is_refused_and_one_without_interlocks_has_defaults(tmp_path):
    text = (benchfile.SHIPPED / "emulated.yaml").read_text()
    without = tmp_path / "without.yaml"
    without.write_text(text.partition("limits:")[0] + "emulated: {}\n")
    with pytest.raises(InputError, match=r"without\.yaml:1:1  limits: is required and missing"):
        benchfile.load(str(without))
    head, _, rest = text.partition("interlocks:")
    without.write_text(head + "response:" + rest.partition("response:")[2])
    result = benchfile.load(str(without))[0].interlocks.shown()
    assert set(result) == {"current_disagreement", "loop_overruns", "clock", "disk_space"}


def test_the_check_shows_interlocks_and_refuses_with_status_2(tmp_path):
    shown = leactl("bench", "check", "testbed")
    assert (
        "  interlock torque_disagreement    tolerance_Nm 0.5, share_percent 5.0, for_s 0.2" in shown.stdout.splitlines()
    )
    answer = json.loads(leactl("bench", "check", "testbed", "--json").stdout)
    assert answer["interlocks"]["supply"] == {"expected_V": 29.6, "band_V": 5.0, "for_s": 0.0}
    done = leactl("bench", "check", str(written(tmp_path, "drive_temperature: {trip_degC: 85}")))
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1
