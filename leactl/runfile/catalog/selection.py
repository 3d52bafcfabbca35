"""Choose and order runs of a list by what they are of, when they were made and what they were run with."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from leactl import yamlfile
from leactl.errors import InputError
from leactl.runfile.catalog.expression import Test, moment_of, span_of, test_of
from leactl.runfile.summary import STATUSES, Summary

KEYS = ("file", "created", "duration", "status", "protocol", "actuator", "condition", "bench", "operator")
ATTRIBUTES = (*KEYS, "run_id", "seed")  # of a run, where no parameter has the name


@dataclass(frozen=True)
class Selection:
    """What is asked of a run; what is empty is not asked."""

    protocol: str = ""
    actuator: str = ""
    condition: str = ""
    status: str = ""
    since: datetime | None = None
    until: datetime | None = None  # not included
    where: Mapping[str, Sequence[Any]] = field(default_factory=dict)  # of parameters and attributes, what will do
    tests: Sequence[Test] = ()  # expressions, all of which a run has to pass

    @property
    def empty(self) -> bool:
        """Whether every run fits."""
        return self == Selection()

    def fits(self, run: Summary) -> bool:
        """Whether a run is what is asked for; one that cannot be read never is."""
        texts = all(
            getattr(self, name) in ("", getattr(run, name)) for name in ("protocol", "actuator", "condition", "status")
        )
        values = all(_value(run, name) in wanted for name, wanted in self.where.items())
        known = not run.fault and texts and values and self._in_time(run.created)
        return known and all(test(run) for test in self.tests)

    def _in_time(self, created: str) -> bool:
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
    """Read what the options of a command line ask of runs; days are of UTC, and the last one counts whole.

    Raises
    ------
    InputError : one line for each word that no run could fit.
    """
    faults: list[str] = []
    if status and status not in STATUSES:
        faults.append(f"--status {status}: one of {', '.join(STATUSES)} was expected")
    asked: dict[str, Sequence[Any]] = {}
    tests: list[Test] = []
    parameters = parameters_of(runs)
    known = [*sorted(parameters - {*ATTRIBUTES}), *ATTRIBUTES]
    for word in where:
        name, _, text = word.partition("=")
        if not is_pair(word):
            try:
                tests.append(test_of(word, parameters))
            except InputError as fault:
                faults += fault.faults
        elif name not in known:
            faults.append(f"--where {word}: no run has a parameter '{name}'; known: {', '.join(known)}")
        else:
            asked[name] = _values(word, text, faults)
    first, last = _moment("--since", since, 0, faults), _moment("--until", until, 1, faults)
    if faults:
        raise InputError(faults)
    return Selection(protocol, actuator, condition, status, first, last, asked, tuple(tests))


def is_pair(word: str) -> bool:
    """Whether a word is NAME=VALUE, the short form of NAME == VALUE for a name that needs no quotes."""
    name, equals, text = word.partition("=")
    return bool(name and equals) and not text.startswith("=") and not re.search(r"[!<>()'\"\s]", name)


def parameters_of(runs: Iterable[Summary]) -> set[str]:
    """Names of the parameters that any run has."""
    return {name for _, parameters in _alike(runs) for name in parameters}


def ordered(runs: Iterable[Summary], key: str) -> list[Summary]:
    """Runs by one of `KEYS` or by a parameter, those without it last, equal ones as they come.

    Raises
    ------
    InputError : no such key, and no run has such a parameter.
    """
    rows = list(runs)
    if key in KEYS:
        return sorted(rows, key=lambda run: (bool(run.fault), getattr(run, key)))
    if not any(key in run.parameters for run in rows):
        known = ", ".join(sorted({name for run in rows for name in run.parameters})) or "none"
        raise InputError(f"--sort {key}: one of {', '.join(KEYS)}, or a parameter of the runs ({known}), was expected")
    return sorted(rows, key=lambda run: _rank(run.parameters.get(key)))


def differing(runs: Iterable[Summary]) -> set[tuple[str, str]]:
    """Protocols with those of their parameters that are not the same in all their runs."""
    seen: dict[tuple[str, str], list[Any]] = {}
    for protocol, parameters in _alike(runs):
        for name, value in parameters.items():
            values = seen.setdefault((protocol, name), [])
            if value not in values[:2]:  # two tell that it differs
                values.append(value)
    return {key for key, values in seen.items() if len(values) > 1}


def _alike(runs: Iterable[Summary]) -> Iterable[tuple[str, Mapping[str, Any]]]:
    """Protocols with parameters, once for all runs that share the mapping, as those of an index do."""
    return {(run.protocol, id(run.parameters)): (run.protocol, run.parameters) for run in runs}.values()


def _value(run: Summary, name: str) -> Any:
    """A parameter of a run, else its attribute of this name."""
    return run.parameters.get(name, getattr(run, name) if name in ATTRIBUTES else None)


def _rank(value: Any) -> tuple[int, float, str]:
    if value is None:
        return 2, 0.0, ""
    return (0, float(value), "") if isinstance(value, int | float) else (1, 0.0, str(value))


def _values(word: str, text: str, faults: list[str]) -> Sequence[Any]:
    """A value as `--set` reads it, and the same as text; a list of one may be kept as its value."""
    if not text.startswith("["):
        return yamlfile.scalar(text), text
    try:
        value = yamlfile.parse(text, f"--where {word}").data
    except InputError as error:
        faults.extend(error.faults)
        return ()
    return (value, *value) if len(value) == 1 else (value,)


def _moment(option: str, text: str, end: int, faults: list[str]) -> datetime | None:
    """The moment that a date or a date with a time stands for; with `end` 1 the first after it."""
    if not text:
        return None
    try:
        return span_of(text)[end]
    except ValueError:
        faults.append(f"{option} {text}: a date as 2026-01-31 or 2026-01-31T13:00 was expected")
        return None
