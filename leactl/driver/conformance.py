"""Checks of a driver's class against the contract: units in the names of settings, and the required methods."""

import inspect
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from leactl.driver.contract import Confirmation, Driver, DriverSettings, Identity
from leactl.driver.probe import CanProbe, I2cProbe, LineProbe

UNIT_SUFFIXES = (  # _rad_s ends like _s, _per_V like _V
    "_A",
    "_mA",
    "_V",
    "_s",
    "_ms",
    "_rad",
    "_Nm",
    "_degC",
    "_Hz",
    "_W",
    "_ohm",
    "_sps",
    "_ppm",
)


def faults_of(driver_class: type[Driver]) -> list[str]:
    """Return one line for each breach of the contract by a driver's class; empty if there is none."""
    faults = []
    for attribute, kind in (("summary", str), ("transport", str), ("Settings", type)):
        if not isinstance(getattr(driver_class, attribute, None), kind):
            faults.append(f"{attribute} is missing")
    if faults:
        return faults
    if driver_class.transport not in ("can", "i2c", "serial", "none"):
        faults.append(f"transport '{driver_class.transport}' is none of can, i2c, serial, none")
    transports = driver_class.transport, driver_class.further_transports
    if driver_class.further_transports and transports != ("serial", ("visa",)):
        faults.append("further_transports may only be ('visa',), and only if transport is 'serial'")
    probe_classes: dict[str, type] = {"can": CanProbe, "i2c": I2cProbe, "serial": LineProbe}
    probe_class = probe_classes.get(driver_class.transport)
    if driver_class.probe is not None and not (probe_class and isinstance(driver_class.probe, probe_class)):
        expected = f"a {probe_class.__name__}" if probe_class else "no probe"
        actual = type(driver_class.probe).__name__
        faults.append(f"probe is of class {actual}; {expected} was expected with transport '{driver_class.transport}'")
    if not issubclass(driver_class.Settings, DriverSettings):
        return [*faults, "Settings does not derive from DriverSettings"]
    config = driver_class.Settings.model_config
    if config.get("extra") != "forbid" or not config.get("frozen"):
        faults.append("Settings must be frozen and forbid unknown keys")
    for name, field in driver_class.Settings.model_fields.items():
        # floats only: most whole numbers are counts; a whole number of ms without a suffix is not noticed
        if _holds_float(field.annotation) and not name.endswith(UNIT_SUFFIXES):
            faults.append(f"setting {name} is a number whose name carries no unit")
    if inspect.isabstract(driver_class):
        faults.append(f"does not implement {', '.join(sorted(driver_class.__abstractmethods__))}")
    annotation = inspect.signature(driver_class.safe_state).return_annotation
    if annotation not in (Confirmation, "Confirmation"):
        faults.append("safe_state does not return a Confirmation")
    annotation = inspect.signature(driver_class.identity).return_annotation
    if annotation not in (Identity, "Identity"):
        faults.append("identity does not return an Identity")
    if hasattr(driver_class, "switch_on") and driver_class.stop_now is Driver.stop_now:
        faults.append("a power supply must have a stop_now: its output is switched off before any device is waited for")
    if not driver_class.__doc__:  # `inspect.getdoc` would return the docstring of `Driver`
        faults.append("the class has no docstring")
    return faults


def _holds_float(annotation: Any) -> bool:
    """Return whether a setting holds a float: alone, in a union, in `Annotated`, or as items of a list or tuple."""
    if get_origin(annotation) in (Union, UnionType, Annotated, list, tuple):
        return any(_holds_float(part) for part in get_args(annotation))
    return annotation is float
