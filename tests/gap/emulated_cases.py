"""Cases of the emulated bench that tests diagnose. The sets of ordinary tests are made at once, and so are those of
long ones: benches side by side take half the time of a core that they take one after another.
"""

import fcntl
import os
from types import SimpleNamespace
from unittest.mock import patch

from leactl.emulation.blind import make as making
from leactl.emulation.blind.draws import usual_effects

EVERY = (*usual_effects(), "power_foldback", "torque_limit", "voltage_limit")
OFTEN = ("torque_ripple",)  # what an ordinary run tries; all of them are a long one
SEED, FEW = 16, 3  # of what no effect explains: the resonator is among the first three
SETS = {
    "sound": {"count": 1, "seed": 11, "kinds": ("none",), "strengths": ("plain",), "prefix": "none"},
    "unknown": {"count": FEW, "seed": SEED, "kinds": ("unknown",), "strengths": ("plain",), "prefix": "unknown"},
    "single": {
        "count": len(OFTEN), "seed": 13, "kinds": ("single",), "effects": OFTEN, "strengths": ("plain",),
        "prefix": "single",
    },
    "saturated": {
        "count": 1, "seed": 14, "kinds": ("single",), "effects": ("saturation",), "strengths": ("strong",),
    },
}  # fmt: skip
SELDOM = {"unknown"}  # sets of long tests


def emulated_cases(tmp_path_factory, name):
    """Folder of a set's cases and of its key; workers that run side by side make each set once."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "emulated-cases"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # until whoever came first has made them
        if not (folder / name / "whole").exists():
            together = [other for other in SETS if (other in SELDOM) == (name in SELDOM)]
            make_all(folder, together)
            for other in together:
                (folder / other / "whole").touch()
    return SimpleNamespace(folder=folder / name, cases=folder / name / "cases", key=folder / name / "key")


def make_all(folder, names):
    """Draw each of some sets as `make` does, and run the benches of all of them together."""
    folders, cases = [], []

    def keep(into, batch):
        folders.extend(into)
        cases.extend(batch)

    with patch.object(making, "write", keep):
        for name in names:
            making.make(out=folder / name / "cases", key_dir=folder / name / "key", **SETS[name])
    making.write(folders, cases)
