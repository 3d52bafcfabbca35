"""Registers of a moteus controller: numbers, scales of whole-number resolutions, modes and fault codes.

Source: mjbots, `docs/protocol/registers.md` of the moteus repository, register map 5; codes above 48 and 103 and the
torque factor from its firmware (`fw/error.h`, `fw/bldc_servo_control.h`, `fw/bldc_servo.cc`).
"""

import math
from enum import IntEnum

MAP_VERSION = 5  # modes since 3, scales of position and velocity since 4, home state since 5


class Register(IntEnum):
    """Numbers of the registers that are used here."""

    MODE = 0x000
    POSITION = 0x001  # revolutions at the output
    VELOCITY = 0x002  # revolutions/s at the output
    TORQUE = 0x003  # N*m at the output, from the q-axis current
    Q_CURRENT = 0x004  # A, amplitude of the phase current
    VOLTAGE = 0x00D  # V, DC link
    TEMPERATURE = 0x00E  # degC, of the board
    FAULT = 0x00F
    PWM_PHASE_A = 0x010  # followed in PWM mode alone
    COMMAND_Q_CURRENT = 0x01C  # followed in current mode alone, in which commands do not expire
    COMMAND_POSITION = 0x020  # NaN: wherever the shaft is
    COMMAND_VELOCITY = 0x021
    COMMAND_FEEDFORWARD_TORQUE = 0x022
    COMMAND_KP_SCALE = 0x023
    COMMAND_KD_SCALE = 0x024
    COMMAND_MAX_TORQUE = 0x025  # NaN: what servo.max_current_A allows
    COMMAND_TIMEOUT = 0x027  # s; 0: servo.default_timeout_s, NaN: none
    COMMAND_VELOCITY_LIMIT = 0x028  # negative: none, NaN: servo.default_velocity_limit
    COMMAND_ACCEL_LIMIT = 0x029
    COMMAND_ILIMIT_SCALE = 0x02B
    MODEL_NUMBER = 0x100
    FIRMWARE_VERSION = 0x101  # 0x010304 is 1.3.4
    REGISTER_MAP_VERSION = 0x102
    SERIAL_NUMBER = 0x120  # three words, the least significant first


class OperatingMode(IntEnum):
    """Values of the mode register that are used here; a controller passes 2 to 4 from stopped to another mode."""

    STOPPED = 0
    FAULT = 1
    ENABLING = 2
    CURRENT = 9
    POSITION = 10
    TIMEOUT = 11
    ZERO_VELOCITY = 12
    BRAKE = 15


MODES = range(16)  # values that the maker documents
_PWM = (1 / 127, 1 / 32767, 1 / 2147483647)
_POSITION = (0.01, 0.0001, 0.00001)
_VELOCITY = (0.1, 0.00025, 0.00001)
_TORQUE = (0.5, 0.01, 0.001)
_TENTHS = (1.0, 0.1, 0.001)  # of temperature and current
SCALES: dict[int, tuple[float, float, float]] = {  # of one count as int8, int16 and int32, in the unit of the register
    Register.POSITION: _POSITION,
    Register.VELOCITY: _VELOCITY,
    Register.TORQUE: _TORQUE,
    Register.Q_CURRENT: _TENTHS,
    Register.VOLTAGE: (0.5, 0.1, 0.001),
    Register.TEMPERATURE: _TENTHS,
    Register.PWM_PHASE_A: _PWM,
    Register.COMMAND_Q_CURRENT: _TENTHS,
    Register.COMMAND_POSITION: _POSITION,
    Register.COMMAND_VELOCITY: _VELOCITY,
    Register.COMMAND_FEEDFORWARD_TORQUE: _TORQUE,
    Register.COMMAND_KP_SCALE: _PWM,
    Register.COMMAND_KD_SCALE: _PWM,
    Register.COMMAND_MAX_TORQUE: _TORQUE,
    Register.COMMAND_TIMEOUT: (0.01, 0.001, 0.000001),
    Register.COMMAND_VELOCITY_LIMIT: _VELOCITY,
    Register.COMMAND_ACCEL_LIMIT: (0.05, 0.001, 0.00001),
    Register.COMMAND_ILIMIT_SCALE: _PWM,
}
"""Registers that hold a physical value; the other ones known here hold whole numbers without a code for NaN."""

KNOWN_REGISTERS = frozenset((*Register, Register.SERIAL_NUMBER + 1, Register.SERIAL_NUMBER + 2))
"""Registers whose scale is known, each word of the serial number included."""

FAULTS = {  # by code, in mode FAULT
    32: "calibration fault",
    33: "motor driver fault",
    34: "over voltage",
    35: "encoder fault",
    36: "motor not configured",
    37: "pwm cycle overrun",
    38: "over temperature",
    39: "outside limit",
    40: "under voltage",
    41: "config changed",
    42: "theta invalid",
    43: "position invalid",
    44: "driver enable fault",
    45: "stop position deprecated",
    46: "timing violation",
    47: "bemf feedforward no accel",
    48: "invalid limits",
}
LIMITS = {  # by code, of what takes power away while the controller follows its mode
    96: "servo.max_velocity",
    97: "servo.max_power_W",
    98: "the maximum system voltage",
    99: "servo.max_current_A",
    100: "servo.fault_temperature",
    101: "servo.motor_fault_temperature",
    102: "the commanded maximum torque",
    103: "servopos.position_min or servopos.position_max",
}
TORQUE_FACTOR = 1.5 / math.sqrt(3.0) * 60.0 / (2.0 * math.pi)
"""Torque constant [N*m per A of amplitude, at the rotor] times motor.Kv [rpm/V]."""


def fault_text(code: int) -> str:
    """Return the meaning of a fault code, in the maker's words."""
    return f"{FAULTS.get(code, 'a fault unknown here')} (code {code})"


def limit_text(code: int) -> str:
    """Return the name of what limits the output, in the maker's words."""
    return f"{LIMITS.get(code, 'a limit unknown here')} (code {code})"
