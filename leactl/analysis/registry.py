"""Experiments by name: the shipped ones by their folder, those of other packages by entry point `leactl.experiments`.

An experiment is a module, or any object, with

    RESULTS = {"ripple": "N*m"}            every result that it may give, with its unit
    CHANNELS = {"torque": "test"}          what a run must have: roles by quantity; optional
    def analyze(runs, **options) -> Result

Its first sentence of documentation says how it is done; the plots and notes of its `Result` are shown as those of
shipped experiments are. Nothing is imported before it is asked for; a package that fails to import is reported when its
experiment is asked for and harms no other.
"""

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from leactl.analysis.estimate import Result
from leactl.errors import InputError
from leactl.runfile.read.reader import Run

ENTRY_POINT_GROUP = "leactl.experiments"
GENERIC_ANALYSIS = "channels"
EXPERIMENTS_PACKAGE = "leactl.analysis.experiments"


@dataclass(frozen=True)
class Experiment:
    """One experiment, loaded."""

    name: str
    source: str  # the distribution that brought it; empty for a shipped one
    analyze: Callable[..., Result]
    results: Mapping[str, str]  # units by name
    channels: Mapping[str, str]  # roles by quantity
    method: str  # one sentence

    def answer(self, runs: Sequence[Run], **options: Any) -> Result:
        """Analyse runs of one actuator under one condition.

        Raises
        ------
        InputError : the runs cannot answer, or the analysis of another package fails or gives what it does not declare.
        """
        for run in runs:
            for quantity, role in self.channels.items():
                if not run.has(quantity, role):
                    run.channel(quantity, role)  # raises with what the run has
        if not self.source:
            return self.analyze(runs, **options)
        try:
            answer = self.analyze(runs, **options)
        except InputError:
            raise
        except Exception as error:  # a foreign analysis may fail in any way; it must not take leactl with it
            raise InputError(f"{self._where} failed: {type(error).__name__}: {error}") from error
        if not isinstance(answer, Result):
            raise InputError(f"{self._where} gave {type(answer).__name__}; a leactl Result was expected")
        for item in answer.results:
            if self.results.get(item.name) != item.units:
                declared = ", ".join(f"{name} [{units}]" for name, units in self.results.items()) or "nothing"
                raise InputError(f"{self._where} gave {item.name} [{item.units}]; it declares {declared}")
        return answer

    @property
    def _where(self) -> str:
        return f"analysis '{self.name}' of {self.source}"


@cache
def shipped_experiments() -> frozenset[str]:
    """Names of the experiments of this package, one of each module in their folder."""
    room = importlib.import_module(EXPERIMENTS_PACKAGE)
    return frozenset(module.name.replace("_", "-") for module in pkgutil.iter_modules(room.__path__))


def names() -> list[str]:
    """Names of all experiments, without importing any."""
    return sorted({*shipped_experiments(), *foreign()})


@cache
def foreign() -> dict[str, EntryPoint]:
    """Entry points of other packages by name; a shipped name stays with the shipped experiment."""
    return {
        point.name: point for point in entry_points(group=ENTRY_POINT_GROUP) if point.name not in shipped_experiments()
    }


def load(name: str) -> Experiment:
    """Load one experiment.

    Raises
    ------
    InputError : there is none of this name, or it cannot be imported or used.
    """
    name = name.replace("_", "-")
    if name in shipped_experiments():
        return as_experiment(name, "", importlib.import_module(f"{EXPERIMENTS_PACKAGE}.{name.replace('-', '_')}"))
    point = foreign().get(name)
    if point is None:
        raise InputError(f"analysis '{name}' is not known; known: {', '.join(names())}")
    source = f"{point.dist.name} {point.dist.version}" if point.dist else "unknown distribution"
    try:
        return as_experiment(name, source, point.load())
    except Exception as error:  # noqa: BLE001 (a foreign plug-in may fail in any way; it must not take leactl with it)
        reason = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        raise InputError(f"analysis '{name}' of {source} cannot be used: {' '.join(reason.split())}") from None


def as_experiment(name: str, source: str, loaded: Any) -> Experiment:
    """Return the experiment that a module, or any object, declares.

    Raises
    ------
    InputError : it lacks `analyze` or `RESULTS`, or they are not what was expected.
    """
    analyze = getattr(loaded, "analyze", None)
    results: Any = getattr(loaded, "RESULTS", None)
    channels: Any = getattr(loaded, "CHANNELS", {})
    if not callable(analyze):
        raise InputError("it has no function analyze(runs, **options)")
    for called, texts in (("RESULTS", results), ("CHANNELS", channels)):
        if not isinstance(texts, Mapping) or not all(isinstance(text, str) for pair in texts.items() for text in pair):
            raise InputError(f"{called} is no mapping of texts to texts")
    text = inspect.getdoc(loaded) or ""
    return Experiment(name, source, analyze, results, channels, " ".join(text.partition("\n\n")[0].split()))
