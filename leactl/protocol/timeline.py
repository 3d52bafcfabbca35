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

    def goes_to(self, value: float) -> str:
        """Set a new setpoint and return "rising" or "falling"; an equal setpoint keeps the last direction."""
        before = self.setpoint
        if before is not None and value != before:
            self.direction = "rising" if value > before else "falling"
        self.setpoint = value
        return self.direction


@dataclass
class Timeline:
    """Actions and faults so far, and the present state of the roles."""

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

    def complain(self, step: ProtocolStep, keys: str | tuple[str | int, ...], message: str) -> None:
        """Add a fault at a key, or a path of keys, of a step."""
        path = (keys,) if isinstance(keys, str) else keys
        self.faults.setdefault(self.document.fault((*step.location, *path), message))

    def complain_of_either(self, step: ProtocolStep, keys: tuple[str, str], message: str) -> None:
        """Add a fault of two keys: at the second key if only its parameter was changed, else at the first."""
        first_changed, second_changed = ((*step.location, key) in self.document.changed for key in keys)
        self.complain(step, keys[1] if second_changed and not first_changed else keys[0], message)

    def charge(self, step: ProtocolStep, steps: int = 1, duration_s: float = 0.0, samples: int = 0) -> None:
        """Count the actions, duration and samples of a step.

        Raises
        ------
        InputError : a sum exceeds its limit.
        """
        self.foresee(step, steps, duration_s, samples)
        self._steps += steps
        self._duration_s += duration_s
        self._samples += samples

    def foresee(self, step: ProtocolStep, steps: int, duration_s: float = 0.0, samples: int = 0) -> None:
        """Check that the least actions, duration and samples of a step fit the limits, before any action is created.

        Raises
        ------
        InputError : a sum would exceed its limit.
        """
        for amount, bound, unit in (
            (self._steps + steps, MAX_ACTIONS, "actions"),
            (self._duration_s + duration_s, MAX_DURATION_S, "s of duration"),
            (self._samples + samples, MAX_SAMPLES, "samples of signals"),
        ):
            if amount > bound:
                message = f"the protocol reaches more than {bound:.0f} {unit} here"
                raise InputError(self.document.fault(step.location, message))

    def check_times(self, step: ProtocolStep, keys: tuple[str, str], hold_s: float, settle_s: float) -> None:
        """Add a fault if a hold is shorter than a cycle or not longer than its settle time."""
        if settle_s >= hold_s:
            message = f"a settle window of {settle_s:g} s leaves nothing of {hold_s:g} s; less was expected"
            self.complain_of_either(step, keys, message)
        if hold_s < (1 - 1e-9) / self.rate_hz:
            self.complain(step, keys[1], f"{hold_s:g} s: at least one cycle ({1 / self.rate_hz:g} s) was expected")

    # -- roles --------------------------------------------------------------------------------------------------------

    def spelling(
        self, step: ProtocolStep, role: str, block: Driven, under: tuple[str | int, ...] = ()
    ) -> Spelling | None:
        """Return the keys of a role's setpoints in its present mode; if the block has other keys, add faults: None.

        `under` is the path of keys from the step to the block.
        """
        if not self.modes_known:
            return None
        mode = self.roles[role].mode
        if mode is Mode.OFF:
            self.complain(step, (*under, "role"), f"{role} is off at this point; a mode step before it was expected")
            return None
        spelling = SPELLINGS[mode]
        fits = True
        for stem in (*block.needs, *block.takes):
            key = spelling.key(stem)
            keys_of_other_modes = {spelling_of_mode.key(stem) for spelling_of_mode in SPELLINGS.values()} - {key}
            wrong_keys = [wrong for wrong in sorted(keys_of_other_modes) if getattr(block, wrong) is not None]
            for wrong in wrong_keys:
                value = getattr(block, wrong)
                shown = f"{value:g}: " if isinstance(value, float) else ""
                message = f"{shown}{role} is in {mode} mode at this point; {key} was expected"
                self.complain(step, (*under, wrong), message)
            missing = stem in block.needs and not wrong_keys and getattr(block, key) is None
            if missing:
                self.complain(step, (*under, key), f"is required and missing ({role} is in {mode} mode at this point)")
            fits = fits and not wrong_keys and not missing
        return spelling if fits else None

    def known_setpoint(self, step: ProtocolStep, role: str, why: str | tuple[str | int, ...]) -> float | None:
        """Return the setpoint at which a ramp begins; if it is unknown, add a fault at the key `why`: None."""
        before = self.roles[role].setpoint
        if before is None and self.fault_free:
            known = f"the {self.roles[role].mode} of {role} is not known before its first setpoint"
            self.complain(step, why, f"{known}; a set or hold before it was expected")
        return before

    # -- actions ------------------------------------------------------------------------------------------------------

    def add(self, step: ProtocolStep, action: Action) -> None:
        """Add an action other than a segment."""
        self.charge(step)
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
        self.charge(step, duration_s=duration_s)
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
        self.roles[role].goes_to(value)
        self.segment(step, name, times[0], {role: Constant(value)}, parameters, times[1], until)

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
        self.roles[role].goes_to(ends[1])
        self.segment(step, name, duration_s, {role: Ramp(*ends, duration_s)}, parameters)

    def approach(
        self, step: ProtocolStep, role: str, value: float, rate: float | None, parameters: Mapping[str, float | str]
    ) -> bool:
        """Add a ramp to a setpoint if a rate is given and the setpoint changes; False if the present one is unknown."""
        if rate is None or self.roles[role].setpoint == value:
            return True
        before = self.known_setpoint(step, role, SPELLINGS[self.roles[role].mode].rate)
        if before is not None:
            self.ramp(step, role, (before, value), abs(value - before) / rate, parameters)
        return before is not None
