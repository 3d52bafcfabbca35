"""Find driver plug-ins by the entry point `leactl.drivers`; one that fails to load is reported and harms no other."""

from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING

from leactl.errors import InputError

if TYPE_CHECKING:
    from leactl.driver.contract import Driver

GROUP = "leactl.drivers"


@dataclass(frozen=True)
class RegisteredDriver:
    """A registered name with its driver, or the reason why it could not be loaded."""

    name: str
    source: str  # the distribution that registers it
    driver: "type[Driver] | None"
    error: str = ""


@cache
def driver_entry_points() -> tuple[EntryPoint, ...]:
    """Return the entry points of all drivers, cached: a search takes 3 ms, and a run loads every device's driver."""
    return tuple(entry_points(group=GROUP))


def names() -> list[str]:
    """Return the names of all registered drivers, without importing any."""
    return sorted({point.name for point in driver_entry_points()})


def find(name: str) -> RegisteredDriver:
    """Return a registered name with its driver, or with the reason why it could not be loaded.

    Raises
    ------
    InputError : no plug-in of this name is registered.
    """
    matching = [point for point in driver_entry_points() if point.name == name]
    if not matching:
        raise InputError(f"driver '{name}' is not registered; known: {', '.join(names()) or 'none'}")
    return _load(matching[0])


def load(name: str) -> "type[Driver]":
    """Return the class of a driver.

    Raises
    ------
    InputError : it is not registered, or it fails to load.
    """
    registered = find(name)
    if registered.driver is None:
        raise InputError(f"driver '{name}' of {registered.source} cannot be used: {registered.error}")
    return registered.driver


def survey() -> list[RegisteredDriver]:
    """Return every registered name with its driver, or with the reason why it could not be loaded."""
    return [find(name) for name in names()]


@cache
def _source_of(point: EntryPoint) -> str:
    """Return the distribution that registers an entry point, cached: reading its metadata takes up to a millisecond."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else "unknown distribution"


def _load(point: EntryPoint) -> RegisteredDriver:
    """Load the driver of an entry point, and return it or the reason why it could not be loaded."""
    from leactl.driver.contract import Driver

    source = _source_of(point)
    try:
        driver = point.load()
    except Exception as error:  # noqa: BLE001 (a foreign plug-in may fail in any way; it must not end leactl)
        return RegisteredDriver(point.name, source, None, f"{type(error).__name__}: {error}")
    if not (isinstance(driver, type) and issubclass(driver, Driver)):
        return RegisteredDriver(point.name, source, None, f"{point.value} is not a leactl Driver")
    return RegisteredDriver(point.name, source, driver)
