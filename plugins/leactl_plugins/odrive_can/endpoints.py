"""Numbers of a drive's parameters, which depend on the firmware, from the maker's `flat_endpoints.json`."""

import json
import struct
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

ENABLE_WATCHDOG = "axis0.config.enable_watchdog"
WATCHDOG_TIMEOUT = "axis0.config.watchdog_timeout"  # s
TORQUE_CONSTANT = "axis0.config.motor.torque_constant"  # N*m per A of amplitude
CURRENT_SOFT_MAX = "axis0.config.motor.current_soft_max"  # A of amplitude
VELOCITY_LIMIT = "axis0.controller.config.vel_limit"  # turns/s
CONTROL_MODE = "axis0.controller.config.control_mode"
INPUT_MODE = "axis0.controller.config.input_mode"
HEARTBEAT_PERIOD = "axis0.config.can.heartbeat_msg_rate_ms"
ENCODER_PERIOD = "axis0.config.can.encoder_msg_rate_ms"  # of readings that are sent without a query; 0: never
CURRENT_PERIOD = "axis0.config.can.iq_msg_rate_ms"
REQUIRED_PARAMETERS = (
    ENABLE_WATCHDOG,
    WATCHDOG_TIMEOUT,
    TORQUE_CONSTANT,
    CURRENT_SOFT_MAX,
    VELOCITY_LIMIT,
    CONTROL_MODE,
    INPUT_MODE,
    HEARTBEAT_PERIOD,
    ENCODER_PERIOD,
    CURRENT_PERIOD,
)
FORMATS = {  # of `struct`, by the maker's name of a type
    "bool": "?",
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "float": "f",
}
EMULATED_TABLE = "emulated"  # in place of a path: the table of the emulated drive


class Endpoint(NamedTuple):
    """One parameter: its number, and the layout of its value."""

    number: int
    layout: struct.Struct


class EndpointTable(NamedTuple):
    """The required parameters of one firmware on one hardware."""

    firmware: str  # "0.6.10"
    hardware: str  # "4.4.58"
    endpoints: dict[str, Endpoint]


@lru_cache(maxsize=8)
def read_table(path: str) -> EndpointTable:
    """Read the table from the maker's file, or that of the emulated drive.

    Raises
    ------
    ValueError : the file cannot be read, has another form, or lacks a required parameter.
    """
    try:
        if path == EMULATED_TABLE:
            text = resources.files(__package__).joinpath("emulated_endpoints.json").read_text("utf-8")
        else:
            text = Path(path).expanduser().read_text("utf-8")
        data: Any = json.loads(text)
        firmware, hardware, endpoints = data["fw_version"], data["hw_version"], data["endpoints"]
        required = {
            path: Endpoint(int(endpoints[path]["id"]), _layout(endpoints[path]["type"])) for path in REQUIRED_PARAMETERS
        }
    except OSError as error:
        raise ValueError(f"'{path}' cannot be read: {error.strerror or error}") from None
    except KeyError as error:
        raise ValueError(f"'{path}' has no {error}; the flat_endpoints.json of firmware 0.6 was expected") from None
    except (ValueError, TypeError) as error:
        raise ValueError(f"'{path}' is no flat_endpoints.json: {error}") from None
    return EndpointTable(str(firmware).partition("-")[0], str(hardware), required)


def _layout(kind: str) -> struct.Struct:
    """Return the layout of a value of this type; raise ValueError if the type is not known."""
    if kind not in FORMATS:
        raise ValueError(f"a parameter is of the type '{kind}'; {', '.join(FORMATS)} were expected")
    return struct.Struct("<" + FORMATS[kind])
