"""ODrive's CAN Simple protocol, version 2: identifiers, states, errors and the layout of what is sent.

Source: ODrive Robotics, "CAN Protocol" of firmware 0.6 (docs.odriverobotics.com), and its symbol file of 0.6.10.
"""

import struct
from collections.abc import Sequence
from enum import IntEnum


class Command(IntEnum):
    """Lower five bits of a CAN identifier, below those of the node. A query is a frame without data."""

    GET_VERSION = 0x00
    HEARTBEAT = 0x01
    RX_SDO = 0x04  # read or write a parameter of the drive
    TX_SDO = 0x05  # the drive's answer to RX_SDO
    SET_AXIS_STATE = 0x07
    GET_ENCODER_ESTIMATES = 0x09
    SET_CONTROLLER_MODE = 0x0B
    SET_INPUT_POS = 0x0C
    SET_INPUT_VEL = 0x0D
    SET_INPUT_TORQUE = 0x0E
    GET_IQ = 0x14
    GET_BUS_VOLTAGE_CURRENT = 0x17
    CLEAR_ERRORS = 0x18


class AxisState(IntEnum):
    """State of an axis; between idle and closed loop, a drive may report states of its calibration."""

    UNDEFINED = 0
    IDLE = 1
    CLOSED_LOOP_CONTROL = 8


class ControlMode(IntEnum):
    """Quantity that the input demands."""

    TORQUE = 1
    VELOCITY = 2
    POSITION = 3


class InputMode(IntEnum):
    """Filter of the input before the drive follows it."""

    PASSTHROUGH = 1
    TORQUE_RAMP = 6


PROTOCOL = 2  # of firmware 0.5.4 and later
NODE_SHIFT = 5
WATCHDOG_TIMER_EXPIRED = 0x01000000
ERRORS = {
    0x00000001: "INITIALIZING",
    0x00000002: "SYSTEM_LEVEL",
    0x00000004: "TIMING_ERROR",
    0x00000008: "MISSING_ESTIMATE",
    0x00000010: "BAD_CONFIG",
    0x00000020: "DRV_FAULT",
    0x00000040: "MISSING_INPUT",
    0x00000100: "DC_BUS_OVER_VOLTAGE",
    0x00000200: "DC_BUS_UNDER_VOLTAGE",
    0x00000400: "DC_BUS_OVER_CURRENT",
    0x00000800: "DC_BUS_OVER_REGEN_CURRENT",
    0x00001000: "CURRENT_LIMIT_VIOLATION",
    0x00002000: "MOTOR_OVER_TEMP",
    0x00004000: "INVERTER_OVER_TEMP",
    0x00008000: "VELOCITY_LIMIT_VIOLATION",
    0x00010000: "POSITION_LIMIT_VIOLATION",
    WATCHDOG_TIMER_EXPIRED: "WATCHDOG_TIMER_EXPIRED",
    0x02000000: "ESTOP_REQUESTED",
    0x04000000: "SPINOUT_DETECTED",
    0x08000000: "BRAKE_RESISTOR_DISARMED",
    0x10000000: "THERMISTOR_DISCONNECTED",
    0x40000000: "CALIBRATION_ERROR",
}

# after an answer has come twice: a frame may be doubled by chance, but a second drive answers every query
REPEATED_QUERIES = 2
READ, WRITE = 0, 1  # opcodes of RX_SDO
PARAMETER = struct.Struct("<BHB")  # READ or WRITE, number of the parameter, reserved; the value follows
TWO_FLOATS = struct.Struct("<ff")  # position and velocity, demanded and measured current, or bus voltage and current
ONE_FLOAT = struct.Struct("<f")
POSITION = struct.Struct("<fhh")  # position [turns], and velocity and torque that are fed forward
MODES = struct.Struct("<II")  # ControlMode and InputMode
STATE = struct.Struct("<I")  # AxisState
HEARTBEAT = struct.Struct("<IBBBB")  # errors, state, result of a procedure, end of a trajectory, reserved
# protocol, hardware line, version and variant, firmware major, minor, revision, unreleased
VERSION = struct.Struct("<8B")


def hardware_and_firmware(version: Sequence[int]) -> tuple[str, str]:
    """Return hardware and firmware of a drive as text, from the fields of `VERSION`."""
    _protocol, *hardware, major, minor, revision, _unreleased = version
    return ".".join(str(number) for number in hardware), f"{major}.{minor}.{revision}"


def identifiers_of(node: int) -> frozenset[int]:
    """Return the 32 CAN identifiers of a node."""
    return frozenset(range(node << NODE_SHIFT, node + 1 << NODE_SHIFT))


def error_names(error_word: int) -> str:
    """Return the names of the bits that are set in an error word, and the word."""
    names = [name for bit, name in ERRORS.items() if error_word & bit]
    return f"{' and '.join(names) or 'an error unknown here'} (0x{error_word:08X})"
