"""Characterise electric actuators on a bench: protocols in, HDF5 runs and fitted parameters out.

From Python: `open_run`, `analyze`, `diagnose`, `simulate` and `run_protocol` (docs/how-to/python.md).
"""

from typing import Any

__version__ = "0.1.0"

INTERFACE = (
    "Analysis",
    "Channel",
    "Diagnosis",
    "Performed",
    "Run",
    "Simulated",
    "analyze",
    "diagnose",
    "open_run",
    "run_protocol",
    "simulate",
)


def __getattr__(name: str) -> Any:
    """Load `leactl.interface` when one of its names is first used, so that commands do not wait for its imports."""
    if name not in INTERFACE:
        raise AttributeError(f"module 'leactl' has no attribute '{name}'; it has {', '.join(INTERFACE)}")
    from importlib import import_module

    return getattr(import_module("leactl.interface"), name)


def __dir__() -> list[str]:
    return [*globals(), *INTERFACE]
