"""Cases of drawn machines, simulated side by side: a step of a hundred runs takes hardly longer than one of eight."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from leactl.gap.diagnose import Case, hold_out_runs
from leactl.gap.signals.record import read_record
from leactl.joints.files import write_run
from leactl.joints.machine import JointMachine, nominal_text
from leactl.joints.run import JointRun
from leactl.joints.stepped import simulate
from leactl.model.nominal import read_model


def write_cases(folder: Path, cases: Mapping[str, tuple[JointMachine, Sequence[JointRun]]]) -> None:
    """Write a folder for each case: the model file of its machine, and its runs."""
    signals = iter(simulate([run for _, runs in cases.values() for run in runs]))
    for name, (machine, runs) in cases.items():
        (folder / name).mkdir()
        (folder / name / "nominal.yaml").write_text(nominal_text(machine), encoding="utf-8")
        for run in runs:
            write_run(folder / name, "case", run, next(signals))


def case_of(folder: Path) -> Case:
    """Read the case of a folder; some of its runs are held out."""
    records = [read_record(path) for path in sorted(folder.glob("*.h5"))]
    return Case(read_model(folder / "nominal.yaml")[0], *hold_out_runs(records))
