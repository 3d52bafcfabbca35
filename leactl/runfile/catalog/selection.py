"""Select and sort runs by attributes, by date and by the parameters of their protocol."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from leactl import yamlfile
from leactl.errors import InputError
from leactl.runfile.catalog.expression import Test, moment_of, read_expression, span_of
from leactl.runfile.summary import STATUSES, Summary

KEYS = ("file", "created", "duration", "status", "protocol", "actuator", "condition", "bench", "operator")
ATTRIBUTES = (*KEYS, "run_id", "seed")  # of a run; a parameter of the same name has priority


@dataclass(frozen=True)
class Selection:
    """Criteria for runs; an empty field sets no criterion."""

    protocol: str = ""
    actuator: str = ""
    condition: str = ""
    status: str = ""
    since: datetime | None = None
    until: datetime | None = None  # not included
    where: Mapping[str, Sequence[Any]] = field(default_factory=dict)  # accepted values by parameter or attribute
    tests: Sequence[Test] = ()  # expressions; a run has to pass all of them

    @property
    def empty(self) -> bool:
        """Whether there is no criterion, so that every run fits."""
        return self == Selection()

    def fits(self, run: Summary) -> bool:
        """Return whether a run meets all criteria; an unreadable run never does."""
        texts_fit = all(
            getattr(self, name) in ("", getattr(run, name)) for name in ("protocol", "actuator", "condition", "status")
        )
        values_fit = all(_value(run, name) in accepted_values for name, accepted_values in self.where.items())
        meets_criteria = not run.fault and texts_fit and values_fit and self._in_time(run.created)
        return meets_criteria and all(test(run) for test in self.tests)

    def _in_time(self, created: str) -> bool:
        """Return whether a run was created between `since` and `until`; with either, an unreadable time was not."""
        if self.since is None and self.until is None:
            return True
        if (moment := moment_of(created)) is None:
            return False
        return (self.since is None or moment >= self.since) and (self.until is None or moment < self.until)


def selection_of(
    runs: Sequence[Summary],
    *,
    protocol: str = "",
    actuator: str = "",
    condition: str = "",
    status: str = "",
    since: str = "",
    until: str = "",
    where: Sequence[str] = (),
) -> Selection:
    """Build the selection from command-line options; days are UTC, and the day of `until` is included.

    Raises
    ------
    InputError : one line for each option that no run could meet.
    """
    faults: list[str] = []
    if status and status not in STATUSES:
        faults.append(f"--status {status}: one of {', '.join(STATUSES)} was expected")
    wanted_values: dict[str, Sequence[Any]] = {}
    tests: list[Test] = []
    parameters = parameters_of(runs)
    known_names = [*sorted(parameters - {*ATTRIBUTES}), *ATTRIBUTES]
    for word in where:
        name, _, text = word.partition("=")
        if not is_pair(word):
            try:
                tests.append(read_expression(word, parameters))
            except InputError as fault:
                faults += fault.faults
        elif name not in known_names:
            faults.append(f"--where {word}: no run has a parameter '{name}'; known: {', '.join(known_names)}")
        else:
            wanted_values[name] = _values(word, text, faults)
    since_moment, until_moment = _moment("--since", since, 0, faults), _moment("--until", until, 1, faults)
    if faults:
        raise InputError(faults)
    return Selection(protocol, actuator, condition, status, since_moment, until_moment, wanted_values, tuple(tests))


def is_pair(word: str) -> bool:
    """Return whether a word has the short form NAME=VALUE of the expression NAME == VALUE."""
    name, equals, text = word.partition("=")
    return bool(name and equals) and not text.startswith("=") and not re.search(r"[!<>()'\"\s]", name)


def parameters_of(runs: Iterable[Summary]) -> set[str]:
    """Return the names of all parameters of all runs."""
    return {name for _, parameters in _distinct_parameters(runs) for name in parameters}


def ordered(runs: Iterable[Summary], key: str) -> list[Summary]:
    """Sort runs by one of `KEYS` or by a parameter; runs without the parameter come last, and the sort is stable.

    Raises
    ------
    InputError : `key` is neither one of `KEYS` nor a parameter of any run.
    """
    rows = list(runs)
    if key in KEYS:
        return sorted(rows, key=lambda run: (bool(run.fault), getattr(run, key)))
    if not any(key in run.parameters for run in rows):
        parameter_names = ", ".join(sorted({name for run in rows for name in run.parameters})) or "none"
        raise InputError(
            f"--sort {key}: one of {', '.join(KEYS)}, or a parameter of the runs ({parameter_names}), was expected"
        )
    return sorted(rows, key=lambda run: _rank(run.parameters.get(key)))


def differing(runs: Iterable[Summary]) -> set[tuple[str, str]]:
    """Return the pairs (protocol, parameter) whose value differs between runs of the protocol."""
    values_by_parameter: dict[tuple[str, str], list[Any]] = {}
    for protocol, parameters in _distinct_parameters(runs):
        for name, value in parameters.items():
            values = values_by_parameter.setdefault((protocol, name), [])
            if value not in values[:2]:  # two different values suffice
                values.append(value)
    return {key for key, values in values_by_parameter.items() if len(values) > 1}


def _distinct_parameters(runs: Iterable[Summary]) -> Iterable[tuple[str, Mapping[str, Any]]]:
    """Return (protocol, parameters) of the runs, once for runs that share one mapping object, as in an index."""
    return {(run.protocol, id(run.parameters)): (run.protocol, run.parameters) for run in runs}.values()


def _value(run: Summary, name: str) -> Any:
    """Return a parameter of a run, else its attribute of this name, else None."""
    return run.parameters.get(name, getattr(run, name) if name in ATTRIBUTES else None)


def _rank(value: Any) -> tuple[int, float, str]:
    """Return the sort key of a parameter: numbers first, then texts, then missing values."""
    if value is None:
        return 2, 0.0, ""
    return (0, float(value), "") if isinstance(value, int | float) else (1, 0.0, str(value))


def _values(word: str, text: str, faults: list[str]) -> Sequence[Any]:
    """Return the values that match a word: its text as `--set` reads it, and the text itself.

    For a list of one item, the item matches too. A list that is not YAML adds a fault and has no values.
    """
    if not text.startswith("["):
        return yamlfile.scalar(text), text
    try:
        value = yamlfile.parse(text, f"--where {word}").data
    except InputError as error:
        faults.extend(error.faults)
        return ()
    return (value, *value) if len(value) == 1 else (value,)


def _moment(option: str, text: str, edge: int, faults: list[str]) -> datetime | None:
    """Return start (`edge` 0) or end (1) of a date, or a moment; None if the text is empty, or (with a fault) wrong."""
    if not text:
        return None
    try:
        return span_of(text)[edge]
    except ValueError:
        faults.append(f"{option} {text}: a date as 2026-01-31 or 2026-01-31T13:00 was expected")
        return None
