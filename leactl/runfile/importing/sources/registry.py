"""Find formats of foreign files by name: shipped ones in their folder, others by entry point `leactl.log_formats`.

A format is a module, or any object, with

    ENDINGS = (".parquet",)                 endings of file names, in lower case
    def open_source(path, request) -> Source
    def recognises(path, head) -> bool      optional: by the first bytes of a file (empty for a folder)

Its name in a mapping is that of the module or of the entry point. A format that needs another package imports it when a
file is opened. A third-party format that fails to load is reported when a file of it is opened; others still work.
"""

import importlib
import pkgutil
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from leactl.errors import InputError
from leactl.regular_files import open_regular
from leactl.runfile.importing.sources.source import LogSource, SourceRequest

GROUP = "leactl.log_formats"
FORMATS_PACKAGE = "leactl.runfile.importing.sources.formats"
HEAD_BYTES = 64


@cache
def shipped() -> frozenset[str]:
    """Return the names of the shipped formats: the modules of their folder."""
    return frozenset(module.name for module in pkgutil.iter_modules(importlib.import_module(FORMATS_PACKAGE).__path__))


def foreign() -> dict[str, EntryPoint]:
    """Return entry points of other packages by name; a shipped format has priority over one of the same name."""
    return {point.name: point for point in entry_points(group=GROUP) if point.name not in shipped()}


def names() -> list[str]:
    """Return the names of all formats, without importing any."""
    return sorted({*shipped(), *foreign()})


def load(name: str) -> Any:
    """Load a format.

    Raises
    ------
    InputError : no format has this name, or it cannot be imported or used.
    """
    if name in shipped():
        return importlib.import_module(f"{FORMATS_PACKAGE}.{name}")
    entry_point = foreign().get(name)
    if entry_point is None:
        raise InputError(f"format '{name}' is not known; known: {', '.join(names())}")
    source = f"{entry_point.dist.name} {entry_point.dist.version}" if entry_point.dist else "unknown distribution"
    try:
        log_format = entry_point.load()
    except Exception as error:  # noqa: BLE001 (a foreign plug-in may fail in any way; it must not take leactl with it)
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"format '{name}' of {source} cannot be used: {reason}") from None
    if not callable(getattr(log_format, "open_source", None)) or not isinstance(
        getattr(log_format, "ENDINGS", None), tuple
    ):
        raise InputError(f"format '{name}' of {source} cannot be used: it has no tuple ENDINGS or no open_source")
    return log_format


def format_of(path: Path) -> str:
    """Return the name of the format of a file: by its content, else by its ending; shipped formats first.

    Raises
    ------
    InputError : no format knows it.
    """
    if name := recognised(path):
        return name
    for name, log_format in loadable().items():
        if path.is_file() and path.name.lower().endswith(tuple(log_format.ENDINGS)):
            return name
    raise InputError(f"{path}: the ending does not tell its format; give `format:` as one of {', '.join(names())}")


def is_log(path: Path) -> bool:
    """Return whether a path is a file, or a folder that a format recognises."""
    return path.is_file() or (path.is_dir() and bool(recognised(path)))


def recognised(path: Path) -> str:
    """Return the name of the first format that recognises a path; empty if none does."""
    first_bytes = head_of(path)
    recognisers = ((name, getattr(loaded, "recognises", None)) for name, loaded in loadable().items())
    return next(
        (name for name, recognises in recognisers if recognises is not None and recognises(path, first_bytes)), ""
    )


def loadable() -> dict[str, Any]:
    """Return all formats that can be loaded, by name, shipped ones first."""
    formats = {}
    for name in (*sorted(shipped()), *sorted(foreign())):
        try:
            formats[name] = load(name)
        except InputError:
            continue  # reported if a mapping names this format
    return formats


def head_of(path: Path) -> bytes:
    """Return the first bytes of a file; empty for a folder or an unreadable file."""
    try:
        with open_regular(path) as file:
            return file.read(HEAD_BYTES)
    except OSError:
        return b""  # reported by the format to which its ending belongs


def open_source(path: Path, name: str | None, request: SourceRequest) -> LogSource:
    """Open a file in the named format, or in the format that `format_of` finds.

    Raises
    ------
    InputError : unreadable, not of its format, or of an unknown format.
    """
    log_format = load(name or format_of(path))
    try:
        source: LogSource = log_format.open_source(path, request)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or ' '.join(str(error).split())}") from None
    return source
