"""Experiments by name: the shipped ones by their folder, those of other packages by entry point `leactl.experiments`.

An experiment is a module, or any object, with

    RESULTS = {"ripple": "N*m"}            every result that it may give, with its unit
    CHANNELS = {"torque": "test"}          the channels that a run must have: roles by quantity; optional
    def analyze(runs, **options) -> Result

The first paragraph of its docstring says how the experiment is analysed; the plots and notes of its `Result` are shown
like those of shipped experiments. A module is imported when its experiment is asked for; an import that fails is
reported then, and does not affect other experiments.
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
    """One experiment whose module is loaded."""

    name: str
    source: str  # name and version of the distribution that brought it; empty for a shipped experiment
    analyze: Callable[..., Result]
    results: Mapping[str, str]  # units by name
    channels: Mapping[str, str]  # roles by quantity
    method: str  # how it is analysed: the first paragraph of the docstring

    def answer(self, runs: Sequence[Run], **options: Any) -> Result:
        """Analyse runs of one actuator under one condition.

        Raises
        ------
        InputError : the runs do not determine the results, or the analysis of another package fails or returns results
            that it does not declare.
        """
        for run in runs:
            for quantity, role in self.channels.items():
                if not run.has(quantity, role):
                    run.channel(quantity, role)  # raises with what the run has
        if not self.source:
            return self.analyze(runs, **options)
        try:
            result = self.analyze(runs, **options)
        except InputError:
            raise
        except Exception as error:  # a foreign analysis may fail in any way; it must not take leactl with it
            raise InputError(f"{self._where} failed: {type(error).__name__}: {error}") from error
        if not isinstance(result, Result):
            raise InputError(f"{self._where} gave {type(result).__name__}; a leactl Result was expected")
        for estimate in result.results:
            if self.results.get(estimate.name) != estimate.units:
                declared = ", ".join(f"{name} [{units}]" for name, units in self.results.items()) or "nothing"
                raise InputError(f"{self._where} gave {estimate.name} [{estimate.units}]; it declares {declared}")
        return result

    @property
    def _where(self) -> str:
        return f"analysis '{self.name}' of {self.source}"


@cache
def shipped_experiments() -> frozenset[str]:
    """Return the names of the experiments of this package: one for each module in their folder."""
    package = importlib.import_module(EXPERIMENTS_PACKAGE)
    return frozenset(module.name.replace("_", "-") for module in pkgutil.iter_modules(package.__path__))


def names() -> list[str]:
    """Return the names of all experiments, without importing any."""
    return sorted({*shipped_experiments(), *foreign()})


@cache
def foreign() -> dict[str, EntryPoint]:
    """Return the entry points of other packages by name, without those that have the name of a shipped experiment."""
    return {
        entry_point.name: entry_point
        for entry_point in entry_points(group=ENTRY_POINT_GROUP)
        if entry_point.name not in shipped_experiments()
    }


def load(name: str) -> Experiment:
    """Return the experiment of this name, loaded.

    Raises
    ------
    InputError : there is no experiment of this name, or it cannot be imported or used.
    """
    name = name.replace("_", "-")
    if name in shipped_experiments():
        return as_experiment(name, "", importlib.import_module(f"{EXPERIMENTS_PACKAGE}.{name.replace('-', '_')}"))
    entry_point = foreign().get(name)
    if entry_point is None:
        raise InputError(f"analysis '{name}' is not known; known: {', '.join(names())}")
    source = f"{entry_point.dist.name} {entry_point.dist.version}" if entry_point.dist else "unknown distribution"
    try:
        return as_experiment(name, source, entry_point.load())
    except Exception as error:  # noqa: BLE001 (a foreign plug-in may fail in any way; it must not take leactl with it)
        reason = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        raise InputError(f"analysis '{name}' of {source} cannot be used: {' '.join(reason.split())}") from None


def as_experiment(name: str, source: str, loaded: Any) -> Experiment:
    """Return the experiment that a module, or any object, declares.

    Raises
    ------
    InputError : it has no function `analyze`, or its `RESULTS` or `CHANNELS` are no mapping of texts to texts.
    """
    analyze = getattr(loaded, "analyze", None)
    results: Any = getattr(loaded, "RESULTS", None)
    channels: Any = getattr(loaded, "CHANNELS", {})
    if not callable(analyze):
        raise InputError("it has no function analyze(runs, **options)")
    for attribute, mapping in (("RESULTS", results), ("CHANNELS", channels)):
        if not isinstance(mapping, Mapping) or not all(
            isinstance(text, str) for pair in mapping.items() for text in pair
        ):
            raise InputError(f"{attribute} is no mapping of texts to texts")
    docstring = inspect.getdoc(loaded) or ""
    return Experiment(name, source, analyze, results, channels, " ".join(docstring.partition("\n\n")[0].split()))
