"""Collect the actions of a protocol, and track mode and setpoint of each role and the sums of actions and duration.

Every action is counted before it is added, so that a protocol with nested repeats is refused before it grows large.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from leactl.driver.contract import Mode
from leactl.errors import InputError
from leactl.protocol.parameters import Substituted
from leactl.protocol.plan import (
    CRITERION_OUTCOMES,
    SEARCH_OUTCOMES,
    Action,
    Constant,
    Engage,
    Ramp,
    Samples,
    SearchTrial,
    Segment,
    SetpointProfile,
    Until,
)
from leactl.protocol.schema import MAX_ACTIONS, MAX_DURATION_S, MAX_SAMPLES, Driven
from leactl.protocol.setpointkeys import SPELLINGS, Spelling
from leactl.protocol.signals import ProtocolSignal
from leactl.protocol.steps import ProtocolStep
from leactl.yamlfile import Location


@dataclass
class RoleSetpoint:
    """Mode and setpoint of a role at a point of the protocol."""

    mode: Mode = Mode.OFF
    setpoint: float | None = None  # None: unknown, such as the angle at which a drive was engaged
    direction: str = "rising"  # of the last change

    def move_to(self, value: float) -> str:
        """Set a new setpoint and return "rising" or "falling"; an equal setpoint keeps the last direction."""
        previous = self.setpoint
        if previous is not None and value != previous:
            self.direction = "rising" if value > previous else "falling"
        self.setpoint = value
        return self.direction


@dataclass
class Timeline:
    """Actions and faults of a protocol up to the present step, and the mode and setpoint of each role there."""

    document: Substituted
    rate_hz: float
    folder: Path  # of the protocol file
    setup: str = ""  # empty if the head has faults
    actions: list[Action] = field(default_factory=list)
    roles: dict[str, RoleSetpoint] = field(default_factory=lambda: {"test": RoleSetpoint(), "load": RoleSetpoint()})
    faults: dict[str, None] = field(default_factory=dict)  # in order, each once
    signals: dict[tuple[Location, str, ProtocolSignal], Samples] = field(default_factory=dict)
    outcomes: dict[str, tuple[str, ...]] = field(default_factory=dict)  # possible outcomes of earlier steps, by name
    modes_known: bool = True  # False after a faulty `mode` step
    fault_free: bool = True  # False after any faulty step
    _steps: int = 0
    _samples: int = 0
    _duration_s: float = 0.0

    # -- faults and bounds --------------------------------------------------------------------------------------------

    def add_fault(self, step: ProtocolStep, keys: str | tuple[str | int, ...], message: str) -> None:
        """Add a fault at a key, or a path of keys, of a step."""
        path = (keys,) if isinstance(keys, str) else keys
        self.faults.setdefault(self.document.fault((*step.location, *path), message))

    def add_fault_of_either(self, step: ProtocolStep, keys: tuple[str, str], message: str) -> None:
        """Add a fault of two keys: at the second key if its parameter alone was changed, else at the first."""
        first_changed, second_changed = ((*step.location, key) in self.document.changed for key in keys)
        self.add_fault(step, keys[1] if second_changed and not first_changed else keys[0], message)

    def count_towards_limits(
        self, step: ProtocolStep, steps: int = 1, duration_s: float = 0.0, samples: int = 0
    ) -> None:
        """Count the actions, duration and samples of a step.

        Raises
        ------
        InputError : a sum exceeds its limit.
        """
        self.check_limits(step, steps, duration_s, samples)
        self._steps += steps
        self._duration_s += duration_s
        self._samples += samples

    def check_limits(self, step: ProtocolStep, steps: int, duration_s: float = 0.0, samples: int = 0) -> None:
        """Check that a step's minimum of actions, duration and samples fits the limits, before it is expanded.

        Raises
        ------
        InputError : a sum would exceed its limit.
        """
        for total, limit, unit in (
            (self._steps + steps, MAX_ACTIONS, "actions"),
            (self._duration_s + duration_s, MAX_DURATION_S, "s of duration"),
            (self._samples + samples, MAX_SAMPLES, "samples of signals"),
        ):
            if total > limit:
                message = f"the protocol reaches more than {limit:.0f} {unit} here"
                raise InputError(self.document.fault(step.location, message))

    def check_times(self, step: ProtocolStep, keys: tuple[str, str], hold_s: float, settle_s: float) -> None:
        """Add a fault if a hold is shorter than a cycle or not longer than its settle time."""
        if settle_s >= hold_s:
            message = f"a settle window of {settle_s:g} s leaves nothing of {hold_s:g} s; less was expected"
            self.add_fault_of_either(step, keys, message)
        if hold_s < (1 - 1e-9) / self.rate_hz:
            self.add_fault(step, keys[1], f"{hold_s:g} s: at least one cycle ({1 / self.rate_hz:g} s) was expected")

    # -- roles --------------------------------------------------------------------------------------------------------

    def spelling(
        self, step: ProtocolStep, role: str, block: Driven, path: tuple[str | int, ...] = ()
    ) -> Spelling | None:
        """Return the keys of a role's setpoints in its present mode.

        If the mode is unknown or off, or the block has keys of another mode, the result is None, and a fault is added
        if there is none yet. `path` is the path of keys from the step to the block.
        """
        if not self.modes_known:
            return None
        mode = self.roles[role].mode
        if mode is Mode.OFF:
            self.add_fault(step, (*path, "role"), f"{role} is off at this point; a mode step before it was expected")
            return None
        spelling = SPELLINGS[mode]
        keys_fit = True
        for stem in (*block.needs, *block.takes):
            key = spelling.key(stem)
            keys_of_other_modes = {spelling_of_mode.key(stem) for spelling_of_mode in SPELLINGS.values()} - {key}
            wrong_keys = [
                wrong_key for wrong_key in sorted(keys_of_other_modes) if getattr(block, wrong_key) is not None
            ]
            for wrong_key in wrong_keys:
                value = getattr(block, wrong_key)
                value_text = f"{value:g}: " if isinstance(value, float) else ""
                message = f"{value_text}{role} is in {mode} mode at this point; {key} was expected"
                self.add_fault(step, (*path, wrong_key), message)
            is_missing = stem in block.needs and not wrong_keys and getattr(block, key) is None
            if is_missing:
                self.add_fault(step, (*path, key), f"is required and missing ({role} is in {mode} mode at this point)")
            keys_fit = keys_fit and not wrong_keys and not is_missing
        return spelling if keys_fit else None

    def setpoint_before_ramp(self, step: ProtocolStep, role: str, keys: str | tuple[str | int, ...]) -> float | None:
        """Return the setpoint at which a ramp begins; if it is unknown, add a fault at `keys` and return None."""
        setpoint = self.roles[role].setpoint
        if setpoint is None and self.fault_free:
            reason = f"the {self.roles[role].mode} of {role} is not known before its first setpoint"
            self.add_fault(step, keys, f"{reason}; a set or hold before it was expected")
        return setpoint

    # -- actions ------------------------------------------------------------------------------------------------------

    def add(self, step: ProtocolStep, action: Action) -> None:
        """Add an action other than a segment."""
        self.count_towards_limits(step)
        self.actions.append(action)

    def engage(self, step: ProtocolStep, modes: Mapping[str, Mode]) -> None:
        """Add an action that puts roles into modes; their setpoints become zero, or unknown in angle mode."""
        for role, mode in modes.items():
            self.roles[role] = RoleSetpoint(mode, None if mode in (Mode.OFF, Mode.ANGLE) else 0.0)
        self.add(step, Engage(dict(modes)))

    def segment(
        self,
        step: ProtocolStep,
        name: str,
        duration_s: float,
        setpoints: Mapping[str, SetpointProfile],
        parameters: Mapping[str, float | str],
        settle_s: float = 0.0,
        until: Until | None = None,
        trial: SearchTrial | None = None,
    ) -> None:
        """Add a segment, and note the outcomes that its criterion may have."""
        self.count_towards_limits(step, duration_s=duration_s)
        if until is not None:
            self.outcomes[name] = CRITERION_OUTCOMES if trial is None else SEARCH_OUTCOMES
        self.actions.append(Segment(name, duration_s, settle_s, dict(setpoints), dict(parameters), until, trial))

    def hold(
        self,
        step: ProtocolStep,
        name: str,
        times: tuple[float, float],
        role: str,
        value: float,
        parameters: Mapping[str, float | str],
        until: Until | None = None,
    ) -> None:
        """Add a segment at a constant setpoint; `times` are duration and settle time [s]."""
        duration_s, settle_s = times
        self.roles[role].move_to(value)
        self.segment(step, name, duration_s, {role: Constant(value)}, parameters, settle_s, until)

    def ramp(
        self,
        step: ProtocolStep,
        role: str,
        ends: tuple[float, float],
        duration_s: float,
        parameters: Mapping[str, float | str],
        name: str = "ramp",
    ) -> None:
        """Add a ramp between two setpoints."""
        start, stop = ends
        self.roles[role].move_to(stop)
        self.segment(step, name, duration_s, {role: Ramp(start, stop, duration_s)}, parameters)

    def approach(
        self, step: ProtocolStep, role: str, value: float, rate: float | None, parameters: Mapping[str, float | str]
    ) -> bool:
        """Add a ramp to a setpoint if a rate is given and the setpoint changes.

        Returns
        -------
        False if a ramp is needed and the present setpoint is unknown, else True.
        """
        if rate is None or self.roles[role].setpoint == value:
            return True
        start = self.setpoint_before_ramp(step, role, SPELLINGS[self.roles[role].mode].rate)
        if start is not None:
            self.ramp(step, role, (start, value), abs(value - start) / rate, parameters)
        return start is not None
