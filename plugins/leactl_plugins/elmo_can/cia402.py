"""The CiA 402 power drive state machine, seen from the host: from a statusword to the next controlword."""

from enum import StrEnum


class DriveState(StrEnum):
    """States of the machine (CiA 402, 6.2)."""

    NOT_READY = "not ready to switch on"
    DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"


FAULT_STATES = (DriveState.FAULT, DriveState.FAULT_REACTION)

DISABLE_VOLTAGE = 0x0000
QUICK_STOP = 0x0002
SHUTDOWN = 0x0006
SWITCH_ON = 0x0007
ENABLE_OPERATION = 0x000F
FAULT_RESET = 0x0080

_STATES_OF_MASK_4F = {
    0x00: DriveState.NOT_READY,
    0x40: DriveState.DISABLED,
    0x0F: DriveState.FAULT_REACTION,
    0x08: DriveState.FAULT,
}
_STATES_OF_MASK_6F = {
    0x21: DriveState.READY,
    0x23: DriveState.SWITCHED_ON,
    0x27: DriveState.ENABLED,
    0x07: DriveState.QUICK_STOP,
}
_CONTROLWORDS_TOWARDS_ENABLED = {
    DriveState.DISABLED: SHUTDOWN,
    DriveState.READY: SWITCH_ON,
    DriveState.SWITCHED_ON: ENABLE_OPERATION,
    DriveState.ENABLED: ENABLE_OPERATION,
}


def state_of(statusword: int) -> DriveState:
    """Return the state that a statusword encodes."""
    state = _STATES_OF_MASK_6F.get(statusword & 0x6F)
    if state is not None:
        return state
    return _STATES_OF_MASK_4F.get(statusword & 0x4F, DriveState.NOT_READY)


def towards_enabled(state: DriveState) -> int:
    """Return the controlword for the next transition towards operation enabled; it never resets a fault."""
    return _CONTROLWORDS_TOWARDS_ENABLED.get(state, DISABLE_VOLTAGE)
