"""Characterise electric actuators on a bench: protocols in, HDF5 runs and fitted parameters out.

From Python: `open_run`, `analyze`, `diagnose`, `simulate` and `run_protocol` (docs/how-to/python.md).
"""

import os
import sys
from typing import Any

__version__ = "0.1.0"

# Matrix products here are small: threads of theirs that wait for a core which another process has cost as much time as
# the work. Read when NumPy is first imported, and too late where it is there; whoever sets it otherwise is heeded.
if "numpy" not in sys.modules:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

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
    """Load the functions for Python when one is asked for: a command that needs none must not wait for them."""
    if name not in INTERFACE:
        raise AttributeError(f"module 'leactl' has no attribute '{name}'; it has {', '.join(INTERFACE)}")
    from importlib import import_module

    return getattr(import_module("leactl.interface"), name)


def __dir__() -> list[str]:
    return [*globals(), *INTERFACE]
