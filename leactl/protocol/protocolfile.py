"""Find a protocol file by name or path, check it, and expand it with its parameters to a plan.

name: torque-constant
title: Torque over q-axis current while the load actuator holds position
setup: coupled                  # free | locked | coupled | heated
analysis: torque-constant       # may be left out
rate_Hz: 50                     # control loop
record_Hz: 50                   # default rate_Hz; must divide it
parameters: {hold_s: 5.5}       # replaces a value `$hold_s` below; --set hold_s=3 overrides it
conditions: {loaded: {hold_s: 8}}
steps: [...]                    # see steps.py
acceptance:
  - {result: torque_constant, low: 0.4, high: 0.6, unit: N*m/A}
  - {channel: torque, step: hold, statistic: max, high: 6, unit: N*m, stop: true}
wants: [winding_temperature]    # quantities that the analysis uses; a run names those that no device measures
separates: [time_skew, torque_sensor_lag]     # effects that `leactl gap diagnose` can tell apart by runs of it
needs: [phase_voltage_ab]                     # quantities that the bench must measure; opens its `on_demand` devices
attended: true                  # a person stays by the bench: a supply that could burn a winding may be switched on
"""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from pydantic import ValidationError

from leactl import yamlfile
from leactl.errors import InputError
from leactl.protocol import schema, shipped, steps
from leactl.protocol.expansion import expand
from leactl.protocol.parameters import Substituted, resolve, substitute
from leactl.protocol.plan import Acceptance, ChannelBounds, Plan, SearchLimit, Segment
from leactl.protocol.schema import BisectLimit, Head, ResultLimit, divides
from leactl.protocol.timeline import Timeline

NO_OVERRIDES: Mapping[str, str] = MappingProxyType({})


def locate(name_or_path: str) -> Path:
    """Return the path of a shipped protocol by its name, or the given path.

    Raises
    ------
    InputError : neither the name of a shipped protocol nor a path to a .yaml.
    """
    if name_or_path in shipped.names():
        return shipped.folder() / f"{name_or_path}.yaml"
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(
            f"protocol '{name_or_path}' is not known; known: {', '.join(shipped.names())}, or a path to a .yaml"
        )
    return path


def read_overrides(texts: Sequence[str]) -> dict[str, str]:
    """Parse `name=value` texts of the command line to texts by parameter.

    `seed` is left out, because it belongs to the emulated bench and not to the protocol.

    Raises
    ------
    InputError : one line for each text that is no `name=value`, and for each repeated name.
    """
    faults = [f"--set {item}: name=value was expected" for item in texts if not item.partition("=")[1]]
    pairs = [item.partition("=") for item in texts]
    names = [name.strip() for name, equals, _value in pairs if equals]
    faults += [f"--set {name}: given twice" for name in dict.fromkeys(names) if names.count(name) > 1]
    if faults:
        raise InputError(faults)
    return {name.strip(): value.strip() for name, _equals, value in pairs if name.strip() != "seed"}


def load(name_or_path: str, overrides: Mapping[str, str] = NO_OVERRIDES, condition: str = "") -> Plan:
    """Read, check and expand a protocol, by its shipped name or from a file.

    Parameters
    ----------
    overrides : texts by parameter, from the command line; a list begins with `[`.
    condition : label of a condition; values that the protocol states for it override the defaults.

    Raises
    ------
    InputError : no such protocol, or one line for each of its faults, with file, line and column.
    """
    path = locate(name_or_path)
    return expand_document(yamlfile.load(path), path.parent, overrides, condition)


def expand_document(document: yamlfile.Document, folder: Path, overrides: Mapping[str, str], condition: str) -> Plan:
    """Check and expand a loaded protocol; relative paths of CSV files refer to `folder`.

    Raises
    ------
    InputError : one line for each fault of the protocol.
    """
    if not isinstance(document.data, dict):
        raise InputError(document.fault((), f"a mapping with keys of {', '.join(Head.model_fields)} was expected"))
    faults: list[str] = []
    resolved = resolve(document, overrides, condition, faults)
    substituted = substitute(document, resolved, faults)
    head = _head(substituted, faults)
    rate_hz = head.rate_Hz if head is not None else _rate_or_default(substituted.data.get("rate_Hz"))
    raw_steps = substituted.data.get("steps")
    timeline = Timeline(substituted, rate_hz, folder, head.setup if head is not None else "")
    if isinstance(raw_steps, list):
        checked_steps = steps.read(substituted, raw_steps, ("steps",), faults)
        timeline.faults.update(dict.fromkeys(faults))
        try:
            expand(timeline, checked_steps)
        except InputError as error:
            timeline.faults.update(dict.fromkeys(error.faults))
        faults = list(timeline.faults)
    segments = [action for action in timeline.actions if isinstance(action, Segment)]
    names = list(dict.fromkeys(segment.name for segment in segments))
    trials = [segment.trial for segment in segments if segment.trial is not None]
    searches = {trial.search.name: trial.search.quantity for trial in trials}
    for number, limit in enumerate(head.acceptance) if head is not None and timeline.fault_free else ():
        for key, message in limit.misfits(names, searches):
            faults.append(substituted.fault(("acceptance", number, *([key] if key else [])), message))
    if faults or head is None or resolved is None:
        raise InputError(_sorted_by_position(document.name, faults))
    return Plan(
        name=head.name,
        title=head.title,
        setup=head.setup,
        analysis=head.analysis,
        rate_Hz=head.rate_Hz,
        record_Hz=head.record_Hz or head.rate_Hz,
        parameters=resolved.values,
        condition=condition,
        actions=tuple(timeline.actions),
        acceptance=tuple(_bounds(limit) for limit in head.acceptance),
        text=document.text,
        separates=head.separates,
        needs=head.needs,
        wants=head.wants,
        attended=head.attended,
    )


def _head(document: Substituted, faults: list[str]) -> Head | None:
    """Check the head of the file; if it has faults, add them and return None."""
    try:
        head = Head.model_validate(document.data)
    except ValidationError as error:
        faults.extend(document.explain(error))
        return None
    if head.record_Hz is not None and not divides(head.record_Hz, head.rate_Hz):
        message = f"{head.record_Hz:g} Hz: a whole part of rate_Hz ({head.rate_Hz:g} Hz) was expected"
        faults.append(document.fault(("record_Hz",), message))
    return head


def _bounds(
    limit: ResultLimit | schema.ChannelLimit | BisectLimit,
) -> Acceptance | ChannelBounds | SearchLimit:
    """Convert an acceptance limit of the file to one of the plan; an open bound becomes infinite."""
    low = -math.inf if limit.low is None else limit.low
    high = math.inf if limit.high is None else limit.high
    if isinstance(limit, ResultLimit):
        return Acceptance(limit.result, low, high, limit.unit)
    if isinstance(limit, BisectLimit):
        return SearchLimit(limit.bisect, low, high, limit.unit)
    return ChannelBounds(limit.channel, limit.role, limit.step, limit.statistic, low, high, limit.unit, limit.stop)


def _rate_or_default(rate: object) -> float:
    """Return the control rate [Hz] by which the steps are checked if the head has faults: the file's, else 1000 Hz."""
    is_usable = isinstance(rate, int | float) and not isinstance(rate, bool) and 0 < rate <= 10_000
    return float(rate) if is_usable else 1000.0  # type: ignore[arg-type]


def _sorted_by_position(name: str, faults: list[str]) -> list[str]:
    """Sort faults by line and column; those of the command line come first."""
    position_pattern = re.compile(re.escape(name) + r":(\d+):(\d+)  ")

    def position(fault: str) -> tuple[int, ...]:
        match = position_pattern.match(fault)
        return (int(match[1]), int(match[2])) if match else (0, 0)

    return sorted(dict.fromkeys(faults), key=position)
