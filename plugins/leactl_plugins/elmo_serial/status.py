"""The status register SR of a drive, by its bits (SimplIQ Command Reference, SR)."""

from typing import NamedTuple

from leactl_plugins.elmo.fault_names import motor_fault

MOTOR_ON, FAULT_LATCHED, PROGRAM_RUNNING, CURRENT_LIMITED = 1 << 4, 1 << 6, 1 << 12, 1 << 13
UNIT_MODE_SHIFT, UNIT_MODE_BITS = 7, 0x7
MOTION_SHIFT, MOTION_BITS = 14, 0x3
UNIT_MODES = {1: "torque", 2: "speed", 3: "stepper", 4: "dual loop", 5: "position"}


class StatusRegister(NamedTuple):
    """Value of the status register SR."""

    register: int

    @property
    def motor_on(self) -> bool:
        """Whether the power stage is on."""
        return bool(self.register & MOTOR_ON)

    @property
    def is_fault_latched(self) -> bool:
        """Whether a fault has shut the motor down since it was last switched on; MF says which."""
        return bool(self.register & FAULT_LATCHED)

    @property
    def has_program(self) -> bool:
        """Whether a program runs in the drive, which has to guard it against a silent host."""
        return bool(self.register & PROGRAM_RUNNING)

    @property
    def is_current_limited(self) -> bool:
        """Whether the drive limits its current to the continuous limit."""
        return bool(self.register & CURRENT_LIMITED)

    @property
    def unit_mode(self) -> int:
        """Unit mode (UM), a key of `UNIT_MODES`."""
        return self.register >> UNIT_MODE_SHIFT & UNIT_MODE_BITS

    def __str__(self) -> str:
        mode = UNIT_MODES.get(self.unit_mode, f"unit mode {self.unit_mode}")
        program = "program running" if self.has_program else "no program running"
        return f"motor {'on' if self.motor_on else 'off'}, {mode}, {program}, SR 0x{self.register:X}"


def left_operation(status: StatusRegister, fault_bits: int) -> str:
    """Return why a drive is out of operation, by SR and MF."""
    if status.is_fault_latched or fault_bits:
        return motor_fault(fault_bits)
    if not status.motor_on:
        return "switched off without a fault: by the program in it, an input or another host"
    return str(status)
