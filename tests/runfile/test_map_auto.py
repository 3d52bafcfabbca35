"""`--map auto`: right in nine of ten channels of every format, and never sure of a wrong unit."""

import json
import re
import struct

import numpy as np
import pexpect
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet
from scipy.io import savemat

from leactl import yamlfile
from leactl.errors import InputError
from leactl.runfile.importing.column_names import meaning_of
from leactl.runfile.importing.importer import import_runs
from leactl.runfile.importing.mapping import Mapping as MappingFile
from leactl.runfile.importing.proposal.channel_units import LEAVE_OUT, streams_of
from leactl.runfile.importing.proposal.proposal import UNDECIDED, accepted_answer, propose
from leactl.runfile.importing.proposal.survey import survey
from leactl.runfile.importing.sources.registry import open_source
from leactl.runfile.importing.sources.source import SourceRequest, WantedColumn
from leactl.runfile.read.reader import Run
from leactl.units import converter

from ..cli.terminal import COMMAND, leactl
from . import logs
from .logs import EFFORT, HIP, HIP_SPEED, START_NS, WPILOG_HEAD, N, T, wpilog_record, wpilog_start

RPM = 60 / (2 * np.pi)
TURN = 2 * np.pi
RNG = np.random.default_rng(7)
MEASURED = HIP + RNG.normal(0, 2e-4, N)  # an encoder's noise
SPEED = HIP_SPEED + RNG.normal(0, 1e-2, N)
VOLTS = 24.1 + RNG.normal(0, 0.05, N)
WARM = np.linspace(24.0, 31.5, N)
ODRIVE = "axis0."


def csv(path, columns, delimiter=","):
    rows = zip(*columns.values(), strict=True)
    lines = [delimiter.join(columns), *(delimiter.join(f"{x:.9g}" for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


def mcap(path):
    logs.write_mcap(path)


def degrees_in_mcap(path):
    """A node that publishes degrees as if they were rad."""
    keep = logs.HIP.copy(), logs.HIP_SPEED.copy()
    logs.HIP[:], logs.HIP_SPEED[:] = np.degrees(keep[0]), np.degrees(keep[1])
    try:
        logs.write_mcap(path)
    finally:
        logs.HIP[:], logs.HIP_SPEED[:] = keep


def npz(path):
    np.savez(path, t=T, q=np.degrees(MEASURED), dq=SPEED, tau=EFFORT, iq=0.3 * EFFORT, vbus=VOLTS, temp_motor=WARM)


@pytest.mark.parametrize(
    ("name", "quantity"),
    [
        ("velocity_loop_current", "q_axis_current"),
        ("speed_current", "q_axis_current"),
        ("current velocity [rad/s]", "velocity"),
        ("current_position", "angle"),
        ("temp_sensor_id", ""),
        ("battery_current_id", ""),
        ("id [A]", "d_axis_current"),
    ],
)
def test_the_present_one_of_something_begins_with_current_and_a_number_of_a_thing_is_none(name, quantity):
    assert meaning_of(name).quantity == quantity


def npz_in_rpm(path):
    np.savez(path, time=T, position=MEASURED, speed=SPEED * RPM, target_position=MEASURED)


def mat(path):
    savemat(path, {"log": {"time_s": T, "theta": MEASURED / TURN, "omega": SPEED, "torque_Nm": EFFORT}})


def table(path):
    stamps = pa.array((START_NS + np.round(T * 1e9).astype(np.int64)) // 1000).cast(pa.timestamp("us"))
    wrapped = np.mod(np.degrees(8 * T), 360.0)
    columns = {"timestamp": stamps, "angle": wrapped, "velocity": np.degrees(8 + 0 * T), "current_A": EFFORT}
    parquet.write_table(pa.table(columns), path)


def lerobot(path):
    state = pa.FixedSizeListArray.from_arrays(pa.array(np.degrees(np.stack([HIP, HIP], 1)).reshape(-1)), 2)
    columns = {"observation.state": state, "action": state, "timestamp": T, "frame_index": np.arange(N)}
    parquet.write_table(pa.table(columns), path)


def wpilog(path):
    kinds = {"position-left-drive": "Rotation", "velocity-left-drive": "Rotation per Second", "voltage-left-drive": ""}
    out = [WPILOG_HEAD]
    out += [wpilog_start(at, name, "double", 0, units) for at, (name, units) in enumerate(kinds.items(), start=1)]
    for row, t in enumerate(T):
        values = (MEASURED[row] / TURN, SPEED[row] / TURN, 6 * EFFORT[row])
        for at, value in enumerate(values, start=1):
            out.append(wpilog_record(at, 10**6 + round(t * 1e6) + at, struct.pack("<d", value)))
    path.write_bytes(b"".join(out))


def sysid(path):
    rows = np.stack([T + 3, 6 * EFFORT, MEASURED / TURN, SPEED / TURN], 1).tolist()
    tests = {"fast-backward": rows, "fast-forward": rows, "slow-backward": rows, "slow-forward": rows}
    path.write_text(json.dumps(tests | {"sysid": True, "test": "Simple", "units": "Radians", "unitsPerRotation": 1.0}))


def vesc(path):
    columns = {
        "ms_today": 40_000_000 + np.round(T * 1000), "input_voltage": VOLTS, "temp_mos_max": WARM,
        "temp_motor": WARM + 4,
        "current_motor": EFFORT, "current_in": 0.4 * EFFORT, "d_axis_current": 0.01 * EFFORT, "q_axis_current": EFFORT,
        "erpm": 7 * SPEED * RPM, "duty_cycle": 0.1 * EFFORT, "encoder_position": np.mod(np.degrees(MEASURED), 360),
    }  # fmt: skip
    csv(path, columns, ";")


def odrive(path):
    columns = {"time": T, "pos_estimate": MEASURED / TURN, "vel_estimate": SPEED / TURN, "input_pos": HIP / TURN}
    columns |= {"motor.foc.Iq_measured": EFFORT, "vbus_voltage": VOLTS}
    csv(path, {name if name in ("time", "vbus_voltage") else ODRIVE + name: x for name, x in columns.items()})


def moteus(path):
    names = {"position": MEASURED / TURN, "velocity": SPEED / TURN, "torque_Nm": EFFORT, "q_A": EFFORT, "bus_V": VOLTS}
    rows = [{name: float(values[row]) for name, values in names.items()} for row in range(N)]
    log = [{"timestamp": float(t), "servo_stats": row} for t, row in zip(T, rows, strict=True)]
    path.write_text(json.dumps({"log": log}))


def feetech(path):
    entries = [
        {"timestamp": float(t), "position": float(q), "goal_position": float(q), "speed": float(w), "input_volts": 7.4,
         "temp": 25.0}
        for t, q, w in zip(T, MEASURED, SPEED, strict=True)
    ]  # fmt: skip
    path.write_text(json.dumps({"mass": 0.1, "entries": entries}))


ANGLE, VELOCITY = ("angle", "rad"), ("velocity", "rad/s")
LOGS = {
    "log.mcap": (mcap, {"position": ANGLE, "velocity": VELOCITY, "effort": ("torque", "N*m"),
                        "motor.bus_voltage": ("bus_voltage", "V"), "motor.enabled": ("drive_enabled", "1"),
                        "angle.deg": ("angle", "deg")}),
    "deg.mcap": (degrees_in_mcap, {"position": ("angle", "deg"), "velocity": ("velocity", "deg/s"),
                                   "effort": ("torque", "N*m"), "motor.bus_voltage": ("bus_voltage", "V"),
                                   "motor.enabled": ("drive_enabled", "1")}),
    "log.npz": (npz, {"q": ("angle", "deg"), "dq": VELOCITY, "tau": ("torque", "N*m"), "iq": ("q_axis_current", "A"),
                      "vbus": ("bus_voltage", "V"), "temp_motor": ("winding_temperature", "degC")}),
    "rpm.npz": (npz_in_rpm, {"position": ANGLE, "speed": ("velocity", "rpm"),
                             "target_position": ("angle_reference", "rad")}),
    "log.mat": (mat, {"theta": ("angle", "turn"), "omega": VELOCITY, "torque_Nm": ("torque", "N*m")}),
    "log.parquet": (table, {"angle": ("angle", "deg"), "velocity": ("velocity", "deg/s"),
                            "current_A": ("q_axis_current", "A")}),
    "lerobot.parquet": (lerobot, {"observation.state[0]": ("angle", "deg"), "action[0]": ("angle_reference", "deg"),
                                  "observation.state[1]": ("angle", "deg"), "action[1]": ("angle_reference", "deg")}),
    "log.wpilog": (wpilog, {"position-left-drive": ("angle", "turn"), "velocity-left-drive": ("velocity", "turn/s"),
                            "voltage-left-drive": ("q_axis_voltage", "V")}),
    "sysid.json": (sysid, {"voltage_V": ("q_axis_voltage", "V"), "position": ("angle", "turn"),
                           "velocity": ("velocity", "turn/s")}),
    "vesc.csv": (vesc, {"input_voltage": ("bus_voltage", "V"), "temp_mos_max": ("drive_temperature", "degC"),
                        "temp_motor": ("winding_temperature", "degC"), "current_in": ("bus_current", "A"),
                        "d_axis_current": ("d_axis_current", "A"), "q_axis_current": ("q_axis_current", "A"),
                        "erpm": ("velocity", "rpm"), "encoder_position": ("angle", "deg")}),
    "odrive.csv": (odrive, {"axis0.pos_estimate": ("angle", "turn"), "axis0.vel_estimate": ("velocity", "turn/s"),
                            "axis0.input_pos": ("angle_reference", "turn"), "vbus_voltage": ("bus_voltage", "V"),
                            "axis0.motor.foc.Iq_measured": ("q_axis_current", "A")}),
    "moteus.json": (moteus, {"servo_stats.position": ("angle", "turn"), "servo_stats.velocity": ("velocity", "turn/s"),
                             "servo_stats.torque_Nm": ("torque", "N*m"), "servo_stats.q_A": ("q_axis_current", "A"),
                             "servo_stats.bus_V": ("bus_voltage", "V")}),
    "feetech.json": (feetech, {"position": ANGLE, "goal_position": ("angle_reference", "rad"), "speed": VELOCITY,
                               "input_volts": ("bus_voltage", "V"), "temp": ("housing_temperature", "degC")}),
}  # fmt: skip


@pytest.fixture(scope="module")
def proposals(tmp_path_factory):
    """Each log's channels by the column, or by the entry that a column of a data log is."""
    folder = tmp_path_factory.mktemp("auto")
    results = {}
    for name, (write, _) in LOGS.items():
        write(folder / name)
        streams = streams_of(survey(folder / name), {})
        of_values = {"value": lambda stream: stream.table.records}
        results[name] = {
            of_values.get(channel.column, lambda _, channel=channel: channel.column)(stream): channel
            for stream in streams
            for channel in stream.channels.values()
        }
    return results


def equal(units, true):
    kinds = ("angle", "velocity", "torque", "bus_voltage", "q_axis_current", "winding_temperature", "drive_enabled")
    return [converter(units, kind) for kind in kinds] == [converter(true, kind) for kind in kinds]


def test_nine_of_ten_channels_are_right_and_no_unit_is_surely_wrong(proposals):
    right, of, wrong = 0, 0, []
    for name, (_, truth) in LOGS.items():
        for column, (quantity, units) in truth.items():
            channel = proposals[name].get(column)
            of += 1
            right += channel is not None and channel.quantity == quantity and equal(channel.units[0], units)
            if channel is not None and len(channel.units) == 1 and not equal(channel.units[0], units):
                wrong.append(f"{name} {column}: {channel.units} for {units}, {channel.why}")
    assert wrong == []
    assert right >= 0.9 * of, f"{right} of {of}"


def decided(proposals, name):
    return {column: channel.units[0] for column, channel in proposals[name].items() if len(channel.units) == 1}


def test_what_each_kind_of_evidence_decides(proposals):
    assert decided(proposals, "rpm.npz") == {}
    assert [channel.units[0] for channel in proposals["rpm.npz"].values()] == ["rad", "rpm", "rad"]
    assert decided(proposals, "log.npz") == {"iq": "A", "vbus": "V", "temp_motor": "degC"}
    assert [proposals["log.npz"][name].units[0] for name in ("q", "dq")] == ["deg", "rad/s"]
    assert decided(proposals, "log.parquet") == {"angle": "deg", "current_A": "A"}
    assert decided(proposals, "log.mcap") == {"angle.deg": "deg", "motor.bus_voltage": "V", "motor.enabled": "1"}
    assert decided(proposals, "log.wpilog") == {
        "voltage-left-drive": "V",
        "position-left-drive": "turn",
        "velocity-left-drive": "turn/s",
    }
    assert decided(proposals, "sysid.json") == {"voltage_V": "V"}


def test_what_is_not_measured_is_left_out(tmp_path):
    vesc(tmp_path / "vesc.csv")
    text = propose(survey(tmp_path / "vesc.csv"), {}).text
    assert "# duty_cycle: left out, VESC Tool's realtime data has it, and it is no channel of a run" in text
    csv(tmp_path / "a.csv", {"t": T, "q": HIP, "position_error": HIP, "x": HIP})
    text = propose(survey(tmp_path / "a.csv"), {}).text
    assert "# position_error: left out, its name says error" in text
    assert "# x: left out, its name says nothing known" in text


@pytest.mark.parametrize(
    ("time", "units"),
    [
        (T, ["s"]), (1.7e9 + T, ["s"]), (1.7e12 + 1e3 * T, ["ms"]), (1.7e15 + 1e6 * T, ["us"]),
        (1.7e18 + 1e9 * T, ["ns"]), (1e3 * T, ["s", "ms"]), (1e6 * T, ["ms", "us"]), (1e9 * T, ["us", "ns"]),
        (200 * T, ["s", "ms"]),
    ],
)  # fmt: skip
def test_the_unit_of_stamps(tmp_path, time, units):
    np.savez(tmp_path / "a.npz", t=time, q=HIP)
    (stream,) = streams_of(survey(tmp_path / "a.npz"), {})
    assert set(stream.time_units) == set(units)


@pytest.mark.parametrize("gear", [6.0, 9.0, 10.0, 50.0, 60.0, 360.0, 1 / 6.0, 1 / 60.0, 1 / 360.0])
@pytest.mark.parametrize("units", ["rad", "deg", "turns", ""])
def test_a_gear_is_never_taken_for_a_unit(tmp_path, gear, units):
    position = {"rad": MEASURED, "deg": np.degrees(MEASURED), "turns": MEASURED / TURN, "": MEASURED}[units]
    speed = gear * (SPEED if units in ("rad", "") else SPEED / TURN * {"deg": 360.0, "turns": 1.0}[units])
    name = f"position_{units}".rstrip("_")
    np.savez(tmp_path / "a.npz", **{"t": T, name: position, "velocity": speed})
    (stream,) = streams_of(survey(tmp_path / "a.npz"), {})
    assert len(stream.channels["velocity"].units) > 1
    assert len(stream.channels[name].units) == (1 if units else 4)


GEARS = [1.0, 4.0, 6.0, 6.2, 6.25, 6.33, 6.4, 7.75, 9.0, 9.1, 9.5, 10.0, 19.2, 50.0, 57.0, 60.0, 100.0]


@settings(max_examples=150, deadline=None)
@given(
    angle=st.sampled_from(["rad", "deg", "turn"]),
    velocity=st.sampled_from(["rad/s", "deg/s", "rpm", "turn/s"]),
    gear=st.sampled_from(GEARS),
    names=st.sampled_from([("q", "dq"), ("position_rad", "speed"), ("pos", "velocity_rpm"), ("theta [deg]", "omega")]),
    amplitude=st.floats(0.05, 40.0),
    noise=st.floats(0.0, 0.02),
    counts=st.sampled_from([0, 256, 4096]),
    seed=st.integers(0, 1000),
)
def test_no_unit_is_surely_wrong_whatever_moves(
    tmp_path_factory, angle, velocity, gear, names, amplitude, noise, counts, seed
):
    rng = np.random.default_rng(seed)
    q = amplitude * np.sin(2.0 * T + seed)
    q = np.round(q * counts / TURN) * TURN / counts if counts else q
    w = gear * 2.0 * amplitude * (np.cos(2.0 * T + seed) + rng.normal(0, noise, N))
    said = {"position_rad": "rad", "theta [deg]": "deg", "velocity_rpm": "rpm"}
    units = [said.get(name, true) for name, true in zip(names, (angle, velocity), strict=True)]
    of_angle, of_velocity = converter(units[0], "angle").factor, converter(units[1], "velocity").factor
    path = tmp_path_factory.mktemp("auto") / "a.npz"
    np.savez(path, **{"t": T, names[0]: q / of_angle, names[1]: w / of_velocity})
    (stream,) = streams_of(survey(path), {})
    for channel, true in zip(stream.channels.values(), units, strict=True):
        assert len(channel.units) > 1 or channel.scale_of or equal(channel.units[0], true), channel.why


def test_a_header_that_the_numbers_contradict_is_asked_for(tmp_path):
    np.savez(tmp_path / "a.npz", t=T, position_rad=MEASURED, velocity_rad_s=SPEED * RPM)
    (stream,) = streams_of(survey(tmp_path / "a.npz"), {})
    assert stream.channels["velocity_rad_s"].units == ("rpm", "rad/s")
    answer = {("streams", "loop", "channels", "velocity_rad_s", "units"): "rad/s"}
    (stream,) = streams_of(survey(tmp_path / "a.npz"), answer)
    assert stream.channels["velocity_rad_s"].units == ("rad/s",)


def test_an_angle_whose_header_its_velocity_contradicts_is_asked_for(tmp_path):
    columns = {"t": T, "position [rad]": np.degrees(MEASURED), "velocity [rad/s]": SPEED}
    csv(tmp_path / "a.csv", columns)
    (stream,) = streams_of(survey(tmp_path / "a.csv"), {})
    assert stream.channels["position_rad"].units == ("deg", "rad")
    assert stream.channels["velocity_rad_s"].units == ("rad/s",)
    (question,) = propose(survey(tmp_path / "a.csv"), {("mechanical",): "free"}).questions
    assert "as it would be in deg" in question.text
    for units in question.choices:
        (stream,) = streams_of(survey(tmp_path / "a.csv"), {question.key: units})
        assert [channel.units for channel in stream.channels.values()] == [(units,), ("rad/s",)]


@pytest.mark.parametrize(
    ("name", "period", "units"),
    [
        ("angle_rad", 360.0, ("deg", "rad")),
        ("angle_deg", 2 * np.pi, ("rad", "deg")),
        ("angle_rev", 1.0, ("turn",)),
        ("angle", 1.0, ("turn",)),
        ("angle", 2 * np.pi, ("rad",)),
    ],
)
def test_a_wrapped_angle_jumps_by_a_turn_in_its_unit(tmp_path, name, period, units):
    np.savez(tmp_path / "a.npz", **{"t": T, name: np.mod(T / 0.9, 1.0) * period})
    (stream,) = streams_of(survey(tmp_path / "a.npz"), {})
    assert stream.channels[name].units == units


def test_the_side_of_a_channel_by_its_name(tmp_path):
    np.savez(tmp_path / "a.npz", t=T, brake_torque_Nm=EFFORT, torque_Nm=EFFORT, ambient_temp=WARM)
    (stream,) = streams_of(survey(tmp_path / "a.npz"), {})
    assert {name: channel.role for name, channel in stream.channels.items()} == {
        "brake_torque_Nm": "load", "torque_Nm": "test", "ambient_temp": "bench",
    }  # fmt: skip
    assert "role load by its name" in stream.channels["brake_torque_Nm"].why


OF_FIELD_ORIENTED_CONTROL = {
    "i_d [A]": ("d_axis_current", "A"), "id_A": ("d_axis_current", "A"), "i_q [A]": ("q_axis_current", "A"),
    "u_d [V]": ("d_axis_voltage", "V"), "u_q [V]": ("q_axis_voltage", "V"), "V_bus": ("bus_voltage", "V"),
    "I_bus [A]": ("bus_current", "A"), "I_dc [A]": ("bus_current", "A"), "i_supply": ("bus_current", "A"),
    "battery_i": ("bus_current", "A"), "voltage_ab [V]": ("phase_voltage_ab", "V"), "v_q [V]": ("q_axis_voltage", "V"),
    "current position [rad]": ("angle", "rad"), "current velocity [rad/s]": ("velocity", "rad/s"),
    "current_torque_Nm": ("torque", "N*m"), "motor_current_A": ("q_axis_current", "A"), "torque constant": None,
    "i_a": None, "i_b": None, "current_w": None, "voltage_c [V]": None, "max_current [A]": None, "v_d": None,
    "motor_id": None,
}  # fmt: skip


def test_names_of_field_oriented_control(tmp_path):
    """The axis, the bus or the phase decides, not the letter i or u; a phase is no channel."""
    csv(tmp_path / "a.csv", {"t": T} | dict.fromkeys(OF_FIELD_ORIENTED_CONTROL, VOLTS))
    (stream,) = streams_of(survey(tmp_path / "a.csv"), {})
    taken = {channel.column: (channel.quantity, channel.units[0]) for channel in stream.channels.values()}
    assert taken == {name: meaning for name, meaning in OF_FIELD_ORIENTED_CONTROL.items() if meaning}
    assert stream.left_out["i_a"] == stream.left_out["voltage_c [V]"] == "its name says a phase"


@pytest.mark.parametrize(
    ("names", "taken"),
    [
        (["motor_current_a"], {"motor_current_a": "A"}),
        (["motor_current_a", "motor_current_b"], {}),
        (["bus_voltage_v", "iq_a"], {"bus_voltage_v": "V", "iq_a": "A"}),
        (["I_A"], {"I_A": "A"}),
        (["I_A", "I_B", "I_C"], {}),
        (["I_U", "I_V", "I_W", "voltage_u", "voltage_v"], {}),
        (["I_A", "Voltage_V", "I_a"], {"I_A": "A", "Voltage_V": "V"}),
    ],
)
def test_a_letter_is_a_phase_beside_another_of_its_set_and_a_unit_alone(tmp_path, names, taken):
    values = VOLTS - 20.0  # V and A by no range
    np.savez(tmp_path / "a.npz", t=T, q_rad=HIP, **dict.fromkeys(names, 1000.0 * values))
    (stream,) = streams_of(survey(tmp_path / "a.npz"), {})
    units = {name: channel.units[0] for name, channel in stream.channels.items() if len(channel.units) == 1}
    assert units == {"q_rad": "rad", **taken}
    assert stream.left_out == {name: "its name says a phase" for name in names if name not in taken}


def test_entries_of_a_data_log_are_siblings(tmp_path):
    out = [WPILOG_HEAD]
    out += [wpilog_start(at, f"/arm/{name}", "double", 0, "") for at, name in enumerate(("I_A", "I_B", "iq_A"), 1)]
    out += [
        wpilog_record(at, 10**6 + round(t * 1e6) + at, struct.pack("<d", 1.0 + t)) for t in T[:50] for at in (1, 2, 3)
    ]
    (tmp_path / "a.wpilog").write_bytes(b"".join(out))
    (stream,) = streams_of(survey(tmp_path / "a.wpilog"), {})
    (channel,) = stream.channels.values()
    assert (stream.table.records, channel.quantity, channel.units) == ("/arm/iq_A", "q_axis_current", ("A",))


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("I_phase", "a phase"),
        ("phase_current_A", "a phase"),
        ("phase voltage [V]", "a phase"),
        ("i_rms", "an r.m.s. or peak value"),
        ("motor_current_peak_A", "an r.m.s. or peak value"),
        ("iq_rms", "an r.m.s. or peak value"),
        ("V_rms", "an r.m.s. or peak value"),
    ],
)
def test_a_phase_rms_or_peak_value_is_no_value_of_an_axis(name, reason):
    assert meaning_of(name) == ("", "", "", f"its name says {reason}", "")
    assert meaning_of("battery_current_rms").quantity == "bus_current"


@pytest.mark.parametrize("name", ["current [N]", "voltage_mA", "winding temp [rad]", "current [kVA/s]", "vbus (W/m)"])
def test_a_unit_that_is_not_of_the_quantity_is_asked_for(tmp_path, name):
    csv(tmp_path / "a.csv", {"t": T, name: VOLTS / 10})
    (stream,) = streams_of(survey(tmp_path / "a.csv"), {})
    (channel,) = stream.channels.values()
    assert len(channel.units) > 1
    assert any(why.startswith("yet its unit is") for why in channel.why)


@pytest.mark.parametrize("values", [np.round(74 + VOLTS - 24), np.round(1000 * VOLTS)])
def test_whole_numbers_are_counts_of_any_size(tmp_path, values):
    np.savez(tmp_path / "a.npz", t=T, vbus=values, iq=np.round(EFFORT * 5))
    (stream,) = streams_of(survey(tmp_path / "a.npz"), {})
    assert all(len(channel.units) > 1 for channel in stream.channels.values())


@pytest.mark.parametrize("gear", [6.283, 57.3, 1 / 57.3])
def test_a_factor_beside_one_decides_no_angle(tmp_path, gear):
    np.savez(tmp_path / "a.npz", t=T, position=MEASURED, velocity_rad_s=gear * SPEED)
    (stream,) = streams_of(survey(tmp_path / "a.npz"), {})
    assert len(stream.channels["position"].units) > 1


def test_a_velocity_in_si_follows_from_its_angle(tmp_path):
    np.savez(tmp_path / "a.npz", t=T, position_rad=MEASURED, speed=SPEED, target_position=MEASURED)
    (stream,) = streams_of(survey(tmp_path / "a.npz"), {})
    assert {name: channel.units for name, channel in stream.channels.items()} == {
        "position_rad": ("rad",), "speed": ("rad/s",), "target_position": ("rad",),
    }  # fmt: skip


def test_one_answer_decides_what_hangs_on_it(tmp_path):
    logs.write_mcap(tmp_path / "log.mcap")
    seen = survey(tmp_path / "log.mcap")
    answers = {}
    asked = []
    while questions := propose(seen, answers).questions:
        asked.append(questions[0].key)
        answers[questions[0].key] = questions[0].choices[0]
    assert asked == [("mechanical",), ("streams", "joint_states", "channels", "position", "units")]
    text = propose(seen, answers).text
    assert UNDECIDED not in text
    assert "quantity: torque, units: N*m" in text.replace('"', "")


def test_counts_of_an_encoder_need_its_scale(tmp_path):
    np.savez(tmp_path / "a.npz", t=T, present_position=np.round(2048 + MEASURED / TURN * 4096))
    seen = survey(tmp_path / "a.npz")
    _, scale = propose(seen, {}).questions
    assert (scale.key[-1], scale.choices) == ("scale", ())
    assert [accepted_answer(scale, text) for text in ("1/4096", "0.5", "0", "-1", "1/0", "x", "nan", "1e999")] == [
        "1/4096", "0.5", None, None, None, None, None, None,
    ]  # fmt: skip
    text = propose(seen, {scale.key: "1/4096", ("mechanical",): "free"}).text
    assert "quantity: angle, units: turn, scale: 0.000244140625}" in text
    assert UNDECIDED not in text


@pytest.mark.parametrize(
    ("head", "delimiter", "decimal", "form"),
    [
        ("t\tq [rad]", "\t", ",", 'csv: {delimiter: "\\U00000009", decimal: ","}'),
        ("# t q_rad", " ", ".", 'csv: {delimiter: " "}'),
    ],
)
def test_tabs_with_decimal_commas_and_blanks_are_detected(tmp_path, head, delimiter, decimal, form):
    lines = [
        head,
        *(delimiter.join(f"{x:.18e}".replace(".", decimal) for x in row) for row in zip(T, HIP, strict=True)),
    ]
    (tmp_path / "a.txt").write_text("\n".join(lines))
    proposed = propose(survey(tmp_path / "a.txt"), {("mechanical",): "free"})
    assert form in proposed.text
    assert proposed.questions == []
    (tmp_path / "map.yaml").write_text(proposed.text)
    (file,) = import_runs([str(tmp_path / "a.txt")], tmp_path / "map.yaml", tmp_path / "out")
    with Run.open(file) as run:
        np.testing.assert_allclose(run.channel("angle").values, HIP)


def test_a_column_of_dates_is_offered_as_stamps(tmp_path):
    moments = np.datetime64("2026-11-28T10:00:00") + np.round(T * 1e6).astype("timedelta64[us]")
    rows = [f"{moment}Z,{q},{w}" for moment, q, w in zip(moments, MEASURED, SPEED, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["when,position_rad,speed", *rows]))
    proposed = propose(survey(tmp_path / "a.csv"), {("mechanical",): "free"})
    assert "time: {column: when, units: iso8601}" in proposed.text
    assert proposed.questions == []  # the speed follows from the angle, so the stamps count
    (tmp_path / "map.yaml").write_text(proposed.text)
    (file,) = import_runs([str(tmp_path / "a.csv")], tmp_path / "map.yaml", tmp_path / "out")
    with Run.open(file) as run:
        np.testing.assert_allclose(np.diff(run.channel("angle").time), np.diff(T), atol=1e-5)


def test_a_header_over_two_columns_is_named_as_the_cause(tmp_path):
    rows = [f"{t},{q},{w},{v}" for t, q, w, v in zip(T, HIP, HIP_SPEED, VOLTS, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["t,q [rad],q [rad],vbus", *rows]))
    (stream,) = streams_of(survey(tmp_path / "a.csv"), {})
    assert stream.left_out == dict.fromkeys((1, 2), "its header stands over 2 columns")
    (tmp_path / "b.csv").write_text("\n".join(["t,q [rad],q [rad],q [rad]", *rows]))
    with pytest.raises(InputError, match=r"1 \(its header stands over 3 columns\)"):
        propose(survey(tmp_path / "b.csv"), {})


def test_samples_without_stamps_need_their_rate(tmp_path):
    np.savez(tmp_path / "a.npz", position_rad=MEASURED)
    seen = survey(tmp_path / "a.npz")
    _, rate = propose(seen, {}).questions
    assert (rate.key, accepted_answer(rate, "100")) == (("streams", "loop", "time", "rate_Hz"), "100")
    assert "time: {rate_Hz: UNDECIDED}" in propose(seen, {}).text
    assert "time: {rate_Hz: 100.0}" in propose(seen, {rate.key: "100"}).text
    with pytest.raises(InputError, match="every channel was left out"):
        propose(seen, {rate.key: LEAVE_OUT})


def test_columns_of_a_matrix_go_by_their_index(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"position": np.stack([HIP, HIP], 1).tolist()}))
    seen = survey(tmp_path / "a.json")
    answers = {("mechanical",): "free"}
    while questions := propose(seen, answers).questions:
        answers[questions[0].key] = questions[0].choices[0] if questions[0].choices else "100"
    data = yamlfile.parse(propose(seen, answers).text, "auto").validate(MappingFile)
    (stream,) = data.streams.values()
    assert [(name, channel.column) for name, channel in stream.channels.items()] == [("column_0", 0), ("column_1", 1)]


NAMES = st.lists(st.text(st.characters(exclude_categories=["Cs"]), max_size=12), min_size=1, max_size=4, unique=True)


@settings(max_examples=150, deadline=None)
@given(names=NAMES, prefix=st.sampled_from(["q", "torque ", "iq.", "", "temp["]))
def test_whatever_columns_are_called_the_proposal_is_a_mapping(tmp_path_factory, names, prefix):
    path = tmp_path_factory.mktemp("auto") / "a.json"
    path.write_text(json.dumps({"t": T[:20].tolist(), **{prefix + name: HIP[:20].tolist() for name in names}}))
    try:
        proposal = propose(survey(path), {("mechanical",): "free"})
    except InputError as fault:
        assert all(line.isprintable() for line in fault.faults)
        return
    assert all(question.text.isprintable() for question in proposal.questions)
    data = yamlfile.parse(proposal.text, "auto").data
    columns = [channel["column"] for stream in data["streams"].values() for channel in stream["channels"].values()]
    assert set(columns) <= {"t", *(prefix + name for name in names)}


def test_answers_are_checked(tmp_path):
    np.savez(tmp_path / "a.npz", t=T, torque=EFFORT)
    mechanical, torque = propose(survey(tmp_path / "a.npz"), {}).questions
    assert [accepted_answer(mechanical, text) for text in ("1", "free\n", "5", "loose", LEAVE_OUT, "")] == [
        "free", "free", None, None, None, None,
    ]  # fmt: skip
    assert [accepted_answer(torque, text) for text in ("2", "lbf*ft", "V", LEAVE_OUT)] == [
        "mN*m",
        "lbf*ft",
        None,
        LEAVE_OUT,
    ]


def test_a_log_that_says_nothing_is_one_line(tmp_path):
    csv(tmp_path / "a.csv", {"t": T, "x": HIP, "y": HIP})
    with pytest.raises(InputError, match="no name says what a column measures: t, x, y; write a mapping"):
        propose(survey(tmp_path / "a.csv"), {})
    (tmp_path / "b.csv").write_text("hello\n")
    with pytest.raises(InputError, match="no row of numbers after line 1"):
        survey(tmp_path / "b.csv")
    (tmp_path / "c.json").write_text("{}")
    with pytest.raises(InputError, match="no table of numbers that a mapping could take"):
        survey(tmp_path / "c.json")


def test_without_a_terminal_the_proposal_is_written_and_nothing_imported(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    npz(tmp_path / "log.npz")
    done = leactl("runs", "import", "log.npz", "--map", "auto", "--map-out", "rig.yaml", input="")
    assert (done.returncode, done.stdout) == (2, "")
    assert "rig.yaml: open: mechanics of the rig: no log says" in done.stderr
    assert "rig.yaml: open: stream loop, 'tau' (torque): torque by its name" in done.stderr
    assert not (tmp_path / "runs").exists()
    text = (tmp_path / "rig.yaml").read_text()
    refused = leactl("runs", "import", "log.npz", "--map", "rig.yaml")
    assert refused.returncode == 2
    assert "rig.yaml:3:13  mechanical: 'UNDECIDED'" in refused.stderr
    assert "'UNDECIDED' are none of N*m, mN*m" in refused.stderr
    again = leactl("runs", "import", "log.npz", "--map", "auto", "--map-out", "rig.yaml", input="")
    assert "rig.yaml: exists already and is never overwritten" in again.stderr
    text = re.sub(r"units: UNDECIDED}  # (\S+).*", r"units: '\1'}", text.replace(": UNDECIDED  #", ": free  #"))
    (tmp_path / "rig.yaml").write_text(text)
    assert leactl("runs", "import", "log.npz", "--map", "rig.yaml", "--out", "runs").returncode == 0
    np.testing.assert_allclose(Run.open(tmp_path / "runs" / "log.h5").channel("angle").values, MEASURED, atol=1e-9)
    shown = leactl("runs", "import", "log.npz", "--map", "auto", input="")
    assert shown.stdout.startswith(
        "# Proposed from log.npz; every line is to be read before it is used.\nformat: npz\n"
    )
    answer = leactl("runs", "import", "log.npz", "--map", "auto", "--json", input="")
    assert json.loads(answer.stdout or answer.stderr)
    aside = leactl("runs", "import", "log.npz", "--map", "rig.yaml", "--map-out", "b.yaml")
    assert "--map-out b.yaml: goes with --map auto" in aside.stderr


def test_in_a_terminal_it_asks_and_imports(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    logs.write_mcap(tmp_path / "log.mcap")
    words = [
        "runs",
        "import",
        "log.mcap",
        "--map",
        "auto",
        "--joint",
        "hip",
        "--out",
        "imported",
        "--map-out",
        "rig.yaml",
    ]
    child = pexpect.spawn(COMMAND[0], [*COMMAND[1:], *words], encoding="utf-8", timeout=60)
    child.expect("mechanics of the rig: no log says")
    child.sendline("loose")
    child.expect("'loose' is no answer")
    child.sendline("1")
    child.expect(r"'position' \(angle\): rad or m by sensor_msgs/JointState")
    child.expect("- leaves it out")
    child.sendline("1")
    child.expect("imported/log-hip.h5")
    child.expect(pexpect.EOF)
    child.close()
    assert child.exitstatus == 0
    np.testing.assert_allclose(
        Run.open(tmp_path / "imported" / "log-hip.h5").channel("velocity").values, logs.HIP_SPEED, atol=1e-9
    )
    again = leactl("runs", "import", "log.mcap", "--map", "rig.yaml", "--out", "again")
    assert again.returncode == 0
    assert sorted(again.stdout.split()) == ["again/log-hip.h5", "again/log-knee.h5"]


HEADER = "t_s,q_rad,v_rad_s"
HELD = [f"{0.01 * k:.2f},{0.1 * k:.1f},10.0" for k in range(40)]


def proposed(path):
    return yamlfile.parse(propose(survey(path), {("mechanical",): "free"}).text, "proposed").data


@pytest.mark.parametrize("column", [0, 1, 2])
@pytest.mark.parametrize("word", ["#N/A", "N/A", "nan", ""])
def test_what_a_spreadsheet_writes_for_a_missed_sample_is_one(tmp_path, word, column):
    path, rows = tmp_path / "log.csv", [row.split(",")[1:] + row.split(",")[1:2] for row in HELD]
    rows[10][column] = word
    path.write_text("\n".join(["q_rad,v_rad_s,tau_Nm", *map(",".join, rows)]) + "\n")
    answers = {("mechanical",): "free", ("streams", "loop", "time", "rate_Hz"): "100"}
    (tmp_path / "map.yaml").write_text(propose(survey(path), answers).text)
    with Run.open(import_runs([str(path)], tmp_path / "map.yaml", tmp_path / "runs")[0]) as run:
        channels = [run.channels(quantity)[0].values for quantity in ("angle", "velocity", "torque")]
    missing = [np.flatnonzero(np.isnan(values)).tolist() for values in channels]
    assert [len(values) for values in channels] == [len(rows)] * 3, "no row is taken for a comment"
    assert missing == [[10] if at == column else [] for at in range(3)]


@pytest.mark.parametrize("nines", ["999", "-9999"])
def test_a_number_is_no_missed_sample_unless_a_person_says_so(tmp_path, nines):
    path = tmp_path / "log.csv"
    rows = [f"{0.01 * k:.2f},0.0,{nines if k > 20 else 0}" for k in range(40)]  # a step of a setpoint
    path.write_text("\n".join(["t_s,q_rad,velocity_cmd_rpm", *rows]) + "\n")
    assert "csv" not in proposed(path)


@pytest.mark.parametrize(("delimiter", "decimal"), [(";", ","), (";", "."), ("|", "."), (",", ".")])
def test_a_delimiter_that_the_first_line_declares_is_taken(tmp_path, delimiter, decimal):
    path = tmp_path / "log.csv"
    rows = [row.replace(",", delimiter) for row in (HEADER, *HELD)]
    path.write_text("\r\n".join([f"sep={delimiter}", *(row.replace(".", decimal) for row in rows)]) + "\r\n")
    mapping = proposed(path)
    assert mapping["csv"]["header_line"] == 2
    assert set(mapping["streams"]["loop"]["channels"]) == {"q_rad", "v_rad_s"}


@pytest.mark.parametrize("name", ["ts", "timestamps", "times"])
def test_stamps_are_known_by_short_and_plural_names(tmp_path, name):
    path = tmp_path / "log.csv"
    path.write_text("\n".join([HEADER.replace("t_s", name), *HELD]) + "\n")
    assert proposed(path)["streams"]["loop"]["time"]["column"] == name


def test_stamps_with_a_stated_unit_come_before_a_counter(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "\n".join(["ts,t_s,q_rad", *(f"{k},{row}" for k, row in enumerate(HELD))]).replace(",10.0", "") + "\n"
    )
    assert proposed(path)["streams"]["loop"]["time"] == {"column": "t_s", "units": "s"}


def test_an_array_of_one_column_is_proposed_once(tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, time=T[:, None], angle_rad=HIP[:, None])
    assert set(proposed(path)["streams"]["loop"]["channels"]) == {"angle_rad"}
    source = open_source(path, "npz", SourceRequest([WantedColumn("angle_rad[0]")]))
    assert source.column("angle_rad[0]", None).tolist() == HIP.tolist(), "as mappings may call it"
