"""Logs as robots write them, each by its format's library, of one joint's motion that the tests know."""

import json

import numpy as np

N = 500
T = np.arange(N) * 0.01
START_NS = 1_700_000_000_000_000_000
HIP = 0.8 * np.sin(2.0 * T)
HIP_SPEED = 1.6 * np.cos(2.0 * T)
KNEE = 0.3 - 0.5 * np.cos(3.0 * T)
KNEE_SPEED = 1.5 * np.sin(3.0 * T)
EFFORT = 0.4 * np.sign(HIP_SPEED) + 0.1 * HIP_SPEED

HEADER = """\
{0}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{0}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
""".format("=" * 80)
JOINT_STATE = (
    """\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
"""
    + HEADER
)
DRIVE_STATE = (
    """\
std_msgs/Header header
rig_msgs/Motor motor
{}
MSG: rig_msgs/Motor
float32[4] phase
float64 bus_voltage
bool enabled
""".format("=" * 80)
    + HEADER
)


def types():
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    known = dict(get_types_from_msg(JOINT_STATE, "sensor_msgs/msg/JointState"))
    known |= get_types_from_msg(DRIVE_STATE, "rig_msgs/msg/DriveState")
    store.register(known)
    return store


def header(store, ns):
    stamp = store.types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
    return store.types["std_msgs/msg/Header"](stamp, "base")


def joint_state(store, ns, row, names=("hip", "knee")):
    values = {"hip": (HIP[row], HIP_SPEED[row], EFFORT[row]), "knee": (KNEE[row], KNEE_SPEED[row], 0.0)}
    columns = [np.array([values[name][at] for name in names]) for at in range(3)]
    return store.types["sensor_msgs/msg/JointState"](header(store, ns), list(names), *columns)


def drive_state(store, ns, row):
    motor = store.types["rig_msgs/msg/Motor"](np.array([0, 1, 2, row], np.float32), 24.0 + 0.01 * (row % 3), row > 10)
    return store.types["rig_msgs/msg/DriveState"](header(store, ns), motor)


def stamp_ns(row):
    return START_NS + round(T[row] * 1e9)


def write_mcap(path, rows=range(N), stamp=stamp_ns, chunk_size=1 << 16, compression=None, finish=True, names=None):
    """A log of `/joint_states`, `/drive`, a topic in JSON and one in protobuf; logged 2 ms after its stamps."""
    from mcap.writer import CompressionType, Writer

    store = types()
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_size, compression=compression or CompressionType.ZSTD)
        writer.start()
        channels = {}
        for topic, kind, text in (
            ("/joint_states", "sensor_msgs/msg/JointState", JOINT_STATE),
            ("/drive", "rig_msgs/msg/DriveState", DRIVE_STATE),
        ):
            schema = writer.register_schema(kind, "ros2msg", text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        schema = writer.register_schema("Motor", "jsonschema", b"{}")
        channels["motor"] = writer.register_channel("motor", "json", schema)
        channels["empty"] = writer.register_channel("empty", "json", schema)
        odd = writer.register_channel("odd", "protobuf", writer.register_schema("Odd", "protobuf", b"\x00"))
        for count, row in enumerate(rows):
            ns = stamp(row)
            of_row = names(row) if names else ("hip", "knee") if row % 2 else ("knee", "hip")
            messages = {
                channels["/joint_states"]: store.serialize_cdr(
                    joint_state(store, ns, row, of_row), "sensor_msgs/msg/JointState"
                ),
                channels["/drive"]: store.serialize_cdr(drive_state(store, ns, row), "rig_msgs/msg/DriveState"),
                channels["motor"]: json.dumps({"angle": {"deg": float(np.degrees(HIP[row]))}, "t": [row, 2]}).encode(),
                odd: b"\x08\x01",
            }
            for channel, data in messages.items():
                log_ns = START_NS + round(T[count] * 1e9) + 2_000_000
                writer.add_message(channel, log_ns, bytes(data), log_ns + 500_000)
        if finish:
            writer.finish()
    return path


def wpilog_record(entry, stamp_us, payload):
    """A record as the specification has it, each number as short as it goes."""
    numbers = [(entry, 4), (len(payload), 4), (stamp_us, 8)]
    sizes = [max(1, (number.bit_length() + 7) // 8) for number, _ in numbers]
    head = (sizes[0] - 1) | (sizes[1] - 1) << 2 | (sizes[2] - 1) << 4
    fields = [number.to_bytes(size, "little") for (number, _), size in zip(numbers, sizes, strict=True)]
    return bytes([head]) + b"".join(fields) + payload


def wpilog_text(text):
    return len(text.encode()).to_bytes(4, "little") + text.encode()


def wpilog_start(entry, name, kind, stamp_us=0, metadata=""):
    texts = b"".join(map(wpilog_text, (name, kind, metadata)))
    return wpilog_record(0, stamp_us, b"\0" + entry.to_bytes(4, "little") + texts)


WPILOG_HEAD = b"WPILOG\x00\x01" + wpilog_text("made by a test")


def write_bag(
    path,
    rows=range(N),
    version=9,
    storage="sqlite3",
    compress=None,
    kinds=("joints", "drive"),
    stamp=stamp_ns,
    log=None,
):
    """A ROS 2 bag of `/joint_states` and `/drive`; before version 9 it carries no definitions.

    `stamp` gives the stamp of a row in its header, `log` the recorder's, which is 2 ms later by default.
    """
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    store = types()
    writer = Writer(path, version=version, storage_plugin=StoragePlugin[storage.upper()])
    if compress:
        writer.set_compression(CompressionMode[compress], CompressionFormat.ZSTD)
    with writer:
        made = {"joints": ("/joint_states", "sensor_msgs/msg/JointState", joint_state)}
        made |= {"drive": ("/drive", "rig_msgs/msg/DriveState", drive_state)}
        for kind in kinds:
            topic, msgtype, make = made[kind]
            connection = writer.add_connection(topic, msgtype, typestore=store)
            for row in rows:
                ns = stamp(row)
                logged_ns = log(row) if log else stamp_ns(row) + 2_000_000
                writer.write(connection, logged_ns, store.serialize_cdr(make(store, ns, row), msgtype))
    return path
