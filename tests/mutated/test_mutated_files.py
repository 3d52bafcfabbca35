"""Thousands of spoiled files of each kind: one clear refusal each, soon and in little memory, or a sound reading.

    .venv/bin/pytest -m long tests/mutated

`MUTATED` in the environment is how many of each kind, 2,000 where it is not set.
"""

import os
import random
from pathlib import Path

import leactl_protocols
import pytest

from leactl.bench import benchfile
from leactl.cli.main import main
from leactl.errors import InputError
from leactl.model import motor
from leactl.model.nominal import read_model
from tests.driver.camera import camera
from tests.mutated.child import outcome
from tests.mutated.mutations import MUTATIONS, misspelt

PROTOCOLS = Path(leactl_protocols.__file__).parent
COUNT = int(os.environ.get("MUTATED", "2000"))
MAPPING = """
mechanical: free
run: {protocol: sweep, actuator: a1, created: "2019-03-01T12:00:00+01:00"}
setup: {load_mass: 0.5, note: bolted}
streams:
  loop:
    time: {column: "t [ms]", units: ms}
    channels:
      angle: {column: q, units: deg, quantity: angle, role: test, sign: -1}
      velocity: {column: w, units: rad/s, quantity: velocity, role: test}
"""
ROWS = "t [ms],q,w\n" + "".join(f"{5 * k},{0.3 * k:.3f},{1.047:.3f}\n" for k in range(400))
CAMERA = "Emissivity: 0.95\nTime (s),R1 Avg (°C),R2 Avg (°C)\n" + "".join(
    f"{k / 30:.3f},{25 + 0.01 * k:.2f},{24 + 0.005 * k:.2f}\n" for k in range(300)
)
NOMINAL = """
name: mine
torque_constant: 0.49
rotor_inertia: 0.0024
coulomb_friction: 0.208
viscous_damping: 0.0238
phase_resistance: 0.264
phase_inductance: 0.0003
pole_pairs: 21
"""
# whose keys are names of the user's own: none of them can be misspelt
OWN_NAMES = (
    "regions",
    "parameters",
    "buses",
    "devices",
    "conditions",
    "channels",
    "streams",
    "setup",
    "variants",
    "set",
    "settings",
)


def command(*arguments):
    """Whatever `leactl` with these arguments ends with."""

    def work():
        import sys

        sys.argv = ["leactl", *map(str, arguments)]
        main()
        return 0

    return work


def read_by(reader):
    def run(path):
        def work():
            try:
                reader(path)
            except InputError as fault:
                print(fault)
                return 2
            return 0

        return work

    return run


def texts(folder):
    return [path.read_bytes() for path in sorted(Path(folder).glob("*.yaml"))]


def imported(path):
    (path.parent / "rows.csv").write_text(ROWS)
    return command("runs", "import", path.parent / "rows.csv", "--map", path, "--out", path.parent / "out")


KINDS = {
    "protocol": (texts(PROTOCOLS), lambda path: command("protocol", "check", path)),
    "protocol's plan": (texts(PROTOCOLS), lambda path: command("protocol", "plan", path)),
    "bench": (texts(benchfile.SHIPPED), lambda path: command("bench", "check", path)),
    "motor": (texts(Path(motor.__file__).parent / "motors"), lambda path: command("motor", "show", path)),
    "model": ([NOMINAL.encode()], read_by(read_model)),
    "campaign": (texts(PROTOCOLS / "campaigns"), lambda path: command("campaign", "status", path)),
    "mapping": ([MAPPING.encode()], imported),
    "camera": ([CAMERA.encode()], read_by(lambda path: camera().read_files([path]))),
}


def mutants(kind, rng):
    """Spoiled files of a kind, each with what was done to it."""
    files = KINDS[kind][0]
    for number in range(COUNT):
        mutation = MUTATIONS[number % len(MUTATIONS)]
        yield mutation.__name__, mutation(rng, rng.choice(files), files)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_spoiled_file_is_refused_or_read(tmp_path, kind, record_property):
    rng, faults, statuses = random.Random(20261123), [], {0: 0, 2: 0}
    suffix = ".csv" if kind == "camera" else ".yaml"
    for number, (name, text) in enumerate(mutants(kind, rng)):
        path = tmp_path / f"{number}{suffix}"
        path.write_bytes(text)
        ended = outcome(KINDS[kind][1](path))
        statuses[ended.status] = statuses.get(ended.status, 0) + 1
        if ended.fault:
            faults.append(f"{path} ({name}): {ended.fault}: {ended.said[-400:]}")
        else:
            path.unlink()
    print(f"{kind}: {statuses}")
    assert faults == []


@pytest.mark.long
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "camera"])
def test_a_misspelt_key_is_never_taken_in_silence(tmp_path, kind):
    rng, silent = random.Random(7), []
    for number in range(COUNT):
        spoiled = misspelt(rng, rng.choice(KINDS[kind][0]))
        if spoiled is None:
            continue
        text, key, wrong = spoiled
        path = tmp_path / f"{number}.yaml"
        path.write_bytes(text)
        ended = outcome(KINDS[kind][1](path))
        if ended.fault or (ended.status == 0 and wrong not in ended.said and not own_name(text.decode(), wrong)):
            silent.append(f"{path}: {key} as {wrong}: {ended.fault or 'accepted'}")
        else:
            path.unlink()
    assert silent == []


def own_name(text, key):
    """Whether a key stands under one whose keys are the user's own names."""
    lines = text.split("\n")
    at = next(number for number, line in enumerate(lines) if f"{key}:" in line)
    depth = len(lines[at]) - len(lines[at].lstrip())
    for line in reversed(lines[:at]):
        if line.strip() and not line.strip().startswith("#") and len(line) - len(line.lstrip()) < depth:
            return line.strip().removeprefix("- ").split(":")[0] in OWN_NAMES
    return False
