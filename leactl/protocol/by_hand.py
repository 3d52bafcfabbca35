"""Generate protocols for moving and reading a bench by hand, so that these are checked and recorded like any run.

The protocols are generated as text and not shipped as files, because protocol parameters cannot express a choice of
role, mode and set-up. The run file keeps the text, and `leactl run` accepts it.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from leactl import yamlfile
from leactl.driver.contract import Mode
from leactl.errors import InputError
from leactl.protocol.plan import Plan
from leactl.protocol.protocolfile import expand_document
from leactl.protocol.setpointkeys import SPELLINGS
from leactl.protocol.signals import MultisineSignal

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

RATE_HZ = 50
HOLD_NAME = "held"  # name of the step in which drives turn and apply torque
SWING_FREQUENCIES_HZ = (2.0, 2.4)  # torque keeps its sign for 0.25 s, too short for an interlock on contradictions
SWING_S = 2.5  # whole periods of both frequencies: the beat begins and ends at 0, and the shaft ends where it began
REST_S = 0.5  # time in which friction stops the shaft before the other drive begins
TARE_SAMPLES = 100  # 2 s, as in torque-constant
GENTLE_RATES = {Mode.CURRENT: 5.0, Mode.VELOCITY: 10.0, Mode.ANGLE: 0.5}  # A/s, rad/s^2, rad/s: slow enough for a hand


class Jog(NamedTuple):
    """A short motion: ramp to a setpoint, hold it, and ramp a current or velocity back to zero."""

    role: str
    mode: Mode
    value: float  # A, rad/s or rad; an angle is relative to the present angle of the shaft
    hold_s: float
    rate: float | None = None  # A/s, rad/s^2 or rad/s

    def check(self) -> None:
        """Check the values before a protocol is written.

        Raises
        ------
        InputError : a role other than test and load, a value that is not finite, or a time or rate not above zero.
        """
        faults = []
        if self.role not in ("test", "load"):
            faults.append(f"--role {self.role}: test or load was expected")
        if not math.isfinite(self.value):
            faults.append(f"--{self.mode} {self.value:g}: a finite number was expected")
        if not 0 < self.hold_s < math.inf:
            faults.append(f"--for {self.hold_s:g}: a time above 0 s was expected")
        if self.rate is not None and not 0 < self.rate < math.inf:
            faults.append(f"--rate {self.rate:g}: a rate above 0 was expected")
        if faults:
            raise InputError(faults)

    def steps(self, present_angle: float = 0.0) -> list[str]:
        """Return the protocol's steps; `present_angle` is the present shaft angle [rad], added to an angle setpoint."""
        keys = SPELLINGS[self.mode]
        rate = f"{keys.rate}: {self.rate or GENTLE_RATES[self.mode]!r}"
        setpoint = self.value + (present_angle if self.mode is Mode.ANGLE else 0.0)
        steps = [
            f"ramp: {{role: {self.role}, to_{keys.setpoint}: {setpoint!r}, {rate}}}",
            f"hold: {{name: jog, role: {self.role}, {keys.setpoint}: {setpoint!r}, duration_s: {self.hold_s!r}}}",
        ]
        if self.mode is Mode.ANGLE:
            steps.insert(0, f"set: {{role: {self.role}, {keys.setpoint}: {present_angle!r}}}")
        else:
            steps.append(f"ramp: {{role: {self.role}, to_{keys.setpoint}: 0, {rate}}}")
        return [f"mode: {{{self.role}: {self.mode}}}", *steps, f"mode: {{{self.role}: off}}"]


def reading_steps(duration_s: float) -> list[str]:
    """Return steps that record for `duration_s` with every drive off.

    Raises
    ------
    InputError : the duration is not above zero.
    """
    if not 0 < duration_s < math.inf:
        raise InputError(f"--for {duration_s:g}: a time above 0 s was expected")
    return [f"hold: {{name: read, duration_s: {duration_s!r}}}"]


def endless_steps() -> list[str]:
    """Return steps that record with every drive off until the run is stopped, by a prompt that nobody confirms."""
    return ["prompt: Reads until it is stopped"]


def tare_steps() -> list[str]:
    """Return steps that tare the torque sensor, with every drive off."""
    return [f"tare: {{samples: {TARE_SAMPLES}}}"]


def motion_steps(setup: str, roles: Collection[str], velocity: float, current: float, hold_s: float) -> list[str]:
    """Return steps that move the drives as the set-up allows.

    In set-up `coupled`, the load drive turns and the test drive applies torque.

    Parameters
    ----------
    velocity, current : setpoints of the drive that turns [rad/s] and of the drive that applies torque [A].

    Raises
    ------
    InputError : the set-up allows no drive to move.
    """
    test_applies_torque = "test" in roles and (setup == "locked" or (setup == "coupled" and "load" in roles))
    turning_roles = (
        []
        if setup in ("locked", "heated")
        else [role for role in roles if not (test_applies_torque and role == "test")]
    )
    modes = {role: Mode.VELOCITY for role in turning_roles} | ({"test": Mode.CURRENT} if test_applies_torque else {})
    if not modes:
        raise InputError(f"set-up '{setup}' with drives {', '.join(roles) or 'none'}: nothing could be moved")
    ramps = []
    for role, mode in modes.items():
        keys, setpoint = SPELLINGS[mode], velocity if mode is Mode.VELOCITY else current
        ramps.append(f"ramp: {{role: {role}, to_{keys.setpoint}: {setpoint!r}, {keys.rate}: {GENTLE_RATES[mode]!r}}}")
        hold = f"hold: {{name: {HOLD_NAME}, role: {role}, {keys.setpoint}: {setpoint!r}, duration_s: {hold_s!r}}}"
    modes_text = ", ".join(f"{role}: {mode}" for role, mode in modes.items())
    off_text = ", ".join(f"{role}: off" for role in modes)
    return [f"mode: {{{modes_text}}}", *ramps, hold, f"mode: {{{off_text}}}"]


def swinging_steps(currents: Mapping[str, float], tare: bool) -> list[str]:
    """Return steps in which each drive in turn swings the shaft by a beat of two sines, the other drives off.

    A single sine that starts at zero would leave a shaft of little friction turning; after the beat the shaft is at its
    first angle. `currents` has the amplitude of the beat by role [A].
    """
    current_key = SPELLINGS[Mode.CURRENT].setpoint
    signal_keys = f"frequencies_Hz: {list(SWING_FREQUENCIES_HZ)!r}, duration_s: {SWING_S!r}"
    steps = tare_steps() if tare else []
    for role, amplitude in currents.items():
        steps += [
            f"mode: {{{role}: {Mode.CURRENT}}}",
            f"signal: {{role: {role}, kind: multisine, amplitude_A: {amplitude!r}, {signal_keys}}}",
            f"set: {{role: {role}, {current_key}: 0}}",
            f"mode: {{{role}: off}}",
            f"hold: {{name: rest, duration_s: {REST_S!r}}}",
        ]
    return steps


def swing(times: "Array") -> "Array":
    """Return the beat of `swinging_steps` divided by its amplitude, shape (n,), at times (n,) of control cycles [s]."""
    signal = MultisineSignal(
        kind="multisine", role="test", frequencies_Hz=SWING_FREQUENCIES_HZ, amplitude_A=1.0, duration_s=SWING_S
    )
    return signal.around(times, SPELLINGS[Mode.CURRENT])


def plan_of(name: str, setup: str, steps: Sequence[str]) -> Plan:
    """Expand a protocol of these steps to a plan.

    Raises
    ------
    InputError : the same faults as for a protocol file with this text.
    """
    head_text = f"name: {name}\ntitle: By hand\nsetup: {setup}\nrate_Hz: {RATE_HZ}\nsteps:\n"
    text = head_text + "".join(f"  - {step}\n" for step in steps)
    return expand_document(yamlfile.parse(text, name), Path(), {}, "")
