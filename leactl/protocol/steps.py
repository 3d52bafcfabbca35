"""Read the steps of protocol files; each step is a mapping with one key, its kind, to a block of settings.

    mode: {test: current, load: angle}     off | current | torque_profile | velocity | angle
    set: {role: test, current_A: 5}        a jump
    ramp: {role: test, to_current_A: 5, duration_s: 1}        or rate_A_s in place of duration_s
    hold: {role: test, current_A: 5, duration_s: 5.5, settle_s: 0.5}       without a setpoint everything stays
    hold: {duration_s: 60, until: {quantity: velocity, role: test, statistic: slope, window_s: 2, above: -0.1,
           below: 0.1, unit: rad/s/s}}     60 s at the longest; `otherwise: fail` where it has to be met
    bisect: {role: test, from_current_A: 0, to_current_A: 2, resolution_A: 0.1, hold_s: 1, rest_s: 1,
             criterion: {quantity: velocity, role: test, window_s: 0.2, above: 1, unit: rad/s}}     see bisection.py
    when: {step: bisect, outcome: bracketed, steps: [...]}      or quantity, role, above, below, unit of a reading
    sweep: {role: test, levels_A: [1, 2], hold_s: 5.5, visit: both, overshoot_A: 0.5, repeats: 6}
    grid: {axes: [{role: load, levels_rad_s: [1, 2]}, {role: test, levels_A: [1, 2]}], hold_s: 3.5}
    signal: {role: test, kind: sine, amplitude_A: 1, frequency_Hz: 2, duration_s: 10}      see signals.py
    wait_until: {quantity: velocity, role: test, below: 0.1, unit: rad/s, timeout_s: 5}
    tare: {samples: 500}
    supply: {test: {voltage_V: 8, current_A: 9}}      direct current through two leads; off ends it
    prompt: Lock the shaft
    weigh: {masses_kg: [1, 2], arm_m: 0.5, hold_s: 5, settle_s: 2}      dead weights on the torque sensor
    record: {rate_Hz: 1000}                0 pauses
    repeat: {times: 3, steps: [...]}

`wait_until` compares the value itself, not its magnitude: for standstill give `above: -0.1` as well.
`sign: -1` mirrors a step, setpoints and the order in which they are visited alike.
"""
# ruff: noqa: N815 (a unit keeps its letter)

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError

from leactl.driver.contract import Mode
from leactl.protocol.parameters import Substituted
from leactl.protocol.schema import Amount, Count, Driven, Duration, Levels, Rate, Rest, Role, Setpoint, Sign
from leactl.protocol.signals import SIGNALS
from leactl.yamlblock import Block
from leactl.yamlfile import Location

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_-]*$", max_length=40)]
Level = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1e4)]


def _none_if_off(setting: Any) -> Any:
    """Return None for the setting `off`, else the setting."""
    return None if setting == Mode.OFF.value else setting


class ModeStep(Block):
    """Put roles into modes, or release them."""

    test: Mode | None = None
    load: Mode | None = None


class TareStep(Block):
    """Zero the sensors; best done before a drive is engaged, since a torque at standstill would be zeroed too."""

    samples: Annotated[int, Field(strict=True, ge=1, le=1_000_000)]


class SetStep(Driven):
    """Jump to a setpoint."""

    needs = ("setpoint",)
    role: Role
    current_A: Setpoint | None = None
    velocity_rad_s: Setpoint | None = None
    angle_rad: Setpoint | None = None
    sign: Sign = 1


class RampStep(Driven):
    """Move the setpoint at a constant rate; analyses identify the ramp by `name`."""

    needs = ("to_setpoint",)
    takes = ("rate",)
    guesses = {"to": "to_current_A, to_velocity_rad_s or to_angle_rad", "rate": "rate_A_s, rate_rad_s2 or rate_rad_s"}
    name: Name = "ramp"
    role: Role
    to_current_A: Setpoint | None = None
    to_velocity_rad_s: Setpoint | None = None
    to_angle_rad: Setpoint | None = None
    duration_s: Duration | None = None
    rate_A_s: Rate | None = None
    rate_rad_s2: Rate | None = None
    rate_rad_s: Rate | None = None
    sign: Sign = 1


class CriterionBlock(Block):
    """A criterion on a channel; the unit must be that of the vocabulary, for a slope per second."""

    quantity: str
    role: Literal["test", "load", "bench"]
    statistic: Literal["mean", "std", "slope"] = "mean"
    window_s: Duration
    below: Setpoint | None = None
    above: Setpoint | None = None
    unit: str


class UntilBlock(CriterionBlock):
    """A criterion on a channel that ends a hold; the unit must be that of the vocabulary, for a slope per second."""

    otherwise: Literal["continue", "fail"] = "continue"


class HoldStep(Driven):
    """Keep a setpoint; analyses identify a hold that is not a level by its `name`."""

    guesses = {"current": "current_A", "velocity": "velocity_rad_s", "angle": "angle_rad", "hold_s": "duration_s"}
    takes = ("setpoint",)
    name: Name = "hold"
    role: Role | None = None
    current_A: Setpoint | None = None
    velocity_rad_s: Setpoint | None = None
    angle_rad: Setpoint | None = None
    duration_s: Duration
    settle_s: Rest = 0.0
    until: UntilBlock | None = None
    sign: Sign = 1


class BisectStep(Block):
    """Search for the current at which the outcome of a trial changes.

    A trial holds a current until the criterion is met, at most `hold_s`. The first two trials are at the ends. If their
    outcomes differ, the interval is halved until it is no wider than the resolution. After every trial the setpoint
    rests at zero for `rest_s`, at least one cycle.
    """

    guesses = {"from": "from_current_A", "to": "to_current_A", "resolution": "resolution_A", "until": "criterion"}
    name: Name = "bisect"
    role: Role
    from_current_A: Setpoint
    to_current_A: Setpoint
    resolution_A: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1e6)]
    hold_s: Duration
    settle_s: Rest = 0.0
    rest_s: Rest = 0.0
    criterion: CriterionBlock
    otherwise: Literal["continue", "fail"] = "continue"


class SweepStep(Driven):
    """Hold a sequence of levels, `repeats` times.

    `both` rises through the levels, turns at top + overshoot, falls through them and turns at bottom - overshoot; it
    begins with the lower turn if the setpoint is not below the levels yet. Without an overshoot, the top level is the
    turn and is held once. `around` visits each level from below and from above, and rests at zero for `rest_s` before
    the next. With a rate, a ramp leads to each hold. `pause_s` rests at zero after every repeat but the last.
    """

    needs = ("levels",)
    takes = ("overshoot", "rate")
    role: Role
    levels_A: Levels | None = None
    levels_rad_s: Levels | None = None
    levels_rad: Levels | None = None
    hold_s: Duration
    settle_s: Rest = 0.0
    visit: Literal["up", "down", "both", "around", "as_given"] = "as_given"
    rest_s: Rest = 0.0
    overshoot_A: Amount | None = None
    overshoot_rad_s: Amount | None = None
    overshoot_rad: Amount | None = None
    turn_s: Duration = 0.5
    rate_A_s: Rate | None = None
    rate_rad_s2: Rate | None = None
    rate_rad_s: Rate | None = None
    repeats: Count = 1
    pause_s: Rest = 0.0
    sign: Sign = 1


class GridAxis(Driven):
    """One axis of a grid; with a rate, a ramp leads to each hold."""

    needs = ("levels",)
    takes = ("rate",)
    role: Role
    levels_A: Levels | None = None
    levels_rad_s: Levels | None = None
    levels_rad: Levels | None = None
    rate_A_s: Rate | None = None
    rate_rad_s2: Rate | None = None
    rate_rad_s: Rate | None = None


class GridStep(Block):
    """Hold every combination of levels; the first axis is the outer loop.

    After every row (one pass through the last axis) but the last, currents and velocities rest at zero for `rest_s`;
    angles stay.
    """

    axes: Annotated[tuple[GridAxis, ...], Field(min_length=1, max_length=2)]
    hold_s: Duration
    settle_s: Rest = 0.0
    repeats: Count = 1
    rest_s: Rest = 0.0


class WhenStep(Block):
    """Execute the steps if an earlier step had an outcome, or if a reading is within bounds; skip them otherwise.

    After the steps, modes and setpoints must be the same as before them.
    """

    step: Name | None = None
    outcome: Literal["met", "not_met", "bracketed", "not_identifiable"] | None = None
    quantity: str | None = None
    role: Literal["test", "load", "bench"] | None = None
    below: Setpoint | None = None
    above: Setpoint | None = None
    unit: str | None = None
    steps: Annotated[list[Any], Field(min_length=1)]


class WaitStep(Block):
    """Wait for a measured value; the unit must be that of the vocabulary, so that another unit is noticed."""

    quantity: str
    role: Literal["test", "load", "bench"]
    below: Setpoint | None = None
    above: Setpoint | None = None
    unit: str
    timeout_s: Duration


class Output(Block):
    """Limits of a supply's voltage and current."""

    voltage_V: Level
    current_A: Level


class SupplyStep(Block):
    """Switch on the supply at each role's leads with these limits, or change them; None switches it off."""

    test: Annotated[Output | None, BeforeValidator(_none_if_off)] = None
    load: Annotated[Output | None, BeforeValidator(_none_if_off)] = None

    @property
    def outputs(self) -> dict[str, tuple[float, float] | None]:
        """Voltage [V] and current [A] by role; None for off."""
        outputs = {role: getattr(self, role) for role in ("test", "load") if role in self.model_fields_set}
        return {
            role: None if output is None else (output.voltage_V, output.current_A) for role, output in outputs.items()
        }


class WeighStep(Block):
    """Ask the operator to hang weights on an arm of the torque sensor: none, rising, falling, none.

    With `sign: -1` the weights pull in the opposite direction.
    """

    masses_kg: Annotated[tuple[Level, ...], Field(min_length=1)]
    arm_m: Level
    hold_s: Duration
    settle_s: Rest = 0.0
    repeats: Count = 1
    sign: Sign = 1


class RecordStep(Block):
    """Record at another rate from now on."""

    rate_Hz: Annotated[float, Field(strict=True, ge=0, le=10_000)]


class RepeatStep(Block):
    """Execute the steps several times."""

    times: Count
    steps: Annotated[list[Any], Field(min_length=1)]


Text = Annotated[str, Field(min_length=1, max_length=500)]
KINDS: dict[str, TypeAdapter[Any]] = {
    "mode": TypeAdapter(ModeStep),
    "set": TypeAdapter(SetStep),
    "ramp": TypeAdapter(RampStep),
    "hold": TypeAdapter(HoldStep),
    "bisect": TypeAdapter(BisectStep),
    "when": TypeAdapter(WhenStep),
    "sweep": TypeAdapter(SweepStep),
    "grid": TypeAdapter(GridStep),
    "wait_until": TypeAdapter(WaitStep),
    "tare": TypeAdapter(TareStep),
    "supply": TypeAdapter(SupplyStep),
    "prompt": TypeAdapter(Text),
    "weigh": TypeAdapter(WeighStep),
    "record": TypeAdapter(RecordStep),
    "repeat": TypeAdapter(RepeatStep),
}


@dataclass(frozen=True)
class ProtocolStep:
    """One step, and its location in the file."""

    location: Location
    kind: str  # for an unknown kind, the closest known one
    content: Any  # the block of the kind; None if it has faults
    inner: tuple["ProtocolStep", ...] = ()  # steps of a `repeat` or `when`


def read(document: Substituted, raw: list[Any], keys: Location, faults: list[str]) -> tuple[ProtocolStep, ...]:
    """Check each step and add its faults; a faulty step remains in the sequence, with None as its content."""
    return tuple(_read_step(document, item, (*keys, index), faults) for index, item in enumerate(raw))


def _read_step(document: Substituted, raw: Any, keys: Location, faults: list[str]) -> ProtocolStep:
    """Check one step; if it has faults, add them and return the step without content."""
    kinds = ", ".join(sorted([*KINDS, "signal"]))
    if not isinstance(raw, Mapping) or len(raw) != 1:
        faults.append(document.fault(keys, f"a mapping of one key was expected, one of {kinds}"))
        return ProtocolStep(keys, "unknown", None)
    kind, settings = next(iter(raw.items()))
    kind_keys = (*keys, kind)
    adapter = _signal(document, settings, kind_keys, faults) if kind == "signal" else KINDS.get(kind)
    if adapter is None:
        if kind != "signal":
            similar_kinds = get_close_matches(kind, [*KINDS, "signal"], n=1)
            if kind in SIGNALS:
                similar_kinds = ["signal"]
                expected = f"signal: {{kind: {kind}, ...}}"
            else:
                expected = similar_kinds[0] if similar_kinds else f"one of {kinds}"
            faults.append(document.fault(kind_keys, f"no such step; {expected} was expected"))
            kind = similar_kinds[0] if similar_kinds else "unknown"
        return ProtocolStep(kind_keys, kind, None)
    try:
        content = adapter.validate_python(settings)
    except ValidationError as error:
        faults.extend(document.explain(error, kind_keys))
        content = None
    inner: tuple[ProtocolStep, ...] = ()
    if kind in ("repeat", "when") and isinstance(settings, Mapping) and isinstance(settings.get("steps"), list):
        inner = read(document, settings["steps"], (*kind_keys, "steps"), faults)
    return ProtocolStep(kind_keys, kind, content, inner)


def _signal(document: Substituted, settings: Any, keys: Location, faults: list[str]) -> TypeAdapter[Any] | None:
    """Return the type of a signal by its key `kind`; if there is no such kind, add a fault and return None."""
    kinds = ", ".join(SIGNALS)
    kind = settings.get("kind") if isinstance(settings, Mapping) else None
    if not isinstance(kind, str) or kind not in SIGNALS:
        kind_text = f"{kind!r}: " if isinstance(kind, str) else ""
        faults.append(document.fault((*keys, "kind"), f"{kind_text}one of {kinds} was expected"))
        return None
    return SIGNALS[kind]
