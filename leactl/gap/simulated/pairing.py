"""Assign simulated runs to real ones: by name, by experiment and condition, by inputs, then by order."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from leactl.errors import InputError
from leactl.gap.diagnosis import SimulatedRun
from leactl.gap.signals.rig import RIG_ENTRIES
from leactl.gap.simulated.inputs import Mismatch, mismatch
from leactl.runfile.read.reader import Run

Kind = tuple[object, ...]


def pair_runs(real: Sequence[Path], simulated: Sequence[Path]) -> tuple[SimulatedRun, ...]:
    """Return the simulated run with the same inputs for each real run.

    A simulated run may belong to several real runs that repeat one experiment. A run of the same name is taken, else
    runs of the same experiment, set-up and condition; of several such runs, those with the same inputs; of several
    with the same inputs, the first belongs to the first real run, the second to the second, and so on.

    Raises
    ------
    InputError : a file is on both sides, or a real run has no simulated run, one with other inputs, or several that
        cannot be told apart; one line each.
    """
    on_both_sides = {path.resolve() for path in real} & {path.resolve() for path in simulated}
    if on_both_sides:
        raise InputError(
            [f"{path}: is both real and simulated; a run can be on one side only" for path in sorted(on_both_sides)]
        )
    with ExitStack() as opened:
        real_runs, simulated_runs = (
            {path: opened.enter_context(Run.open(path)) for path in side} for side in (real, simulated)
        )
        pairing = _Pairing(real_runs, simulated_runs)
        pairs, faults = [], list[str]()
        for path in real_runs:
            try:
                pairs.append(pairing.of(path))
            except InputError as error:
                faults += error.faults
        if faults:
            raise InputError(faults)
    return tuple(pairs)


def kind_of(run: Run) -> Kind:
    """Return the experiment, condition and set-up of a run, which paired runs have in common."""
    names = ("protocol", "condition")
    rig = (run.setup.get(name) for name in RIG_ENTRIES)
    return (*(str(run.attributes.get(name) or "") for name in names), run.mechanical, *rig)


class _Pairing:
    """Open runs of both sides; the inputs of each pair are compared once."""

    def __init__(self, real: Mapping[Path, Run], simulated: Mapping[Path, Run]) -> None:
        self._real, self._simulated = real, simulated
        self._compared: dict[tuple[Path, Path], Mismatch | None] = {}

    def of(self, path: Path) -> SimulatedRun:
        """Return the simulated run of a real run.

        Raises
        ------
        InputError : no simulated run belongs to it, one with other inputs, or several that cannot be told apart.
        """
        same_name = [candidate for candidate in self._simulated if candidate.stem == path.stem]
        candidates = same_name or [
            simulated_path
            for simulated_path, run in self._simulated.items()
            if kind_of(run) == kind_of(self._real[path])
        ]
        if not candidates:
            raise InputError(f"{path}: no simulated run of its name, nor of {self._experiment_text(path)}")
        equal_inputs = [candidate for candidate in candidates if self._mismatch(path, candidate) is None]
        if not equal_inputs:
            nearest = min(candidates, key=lambda candidate: _share(self._mismatch(path, candidate)))
            difference = self._mismatch(path, nearest)
            assert difference is not None
            raise InputError(f"{nearest}: {difference.text}")
        if len(candidates) == 1:
            return SimulatedRun(str(path), str(equal_inputs[0]), "name" if same_name else "experiment")
        if len(equal_inputs) == 1:
            return SimulatedRun(str(path), str(equal_inputs[0]), "inputs")
        repeats = [
            run for run in self._real if any(self._mismatch(run, candidate) is None for candidate in equal_inputs)
        ]
        if len(repeats) != len(equal_inputs):
            names = ", ".join(map(str, equal_inputs))
            raise InputError(
                f"{path}: {len(equal_inputs)} simulated runs have its inputs ({names}) and {len(repeats)} real runs do;"
                " name each as its real run, or give one"
            )
        return SimulatedRun(str(path), str(equal_inputs[repeats.index(path)]), "order")

    def _mismatch(self, path: Path, simulated_path: Path) -> Mismatch | None:
        """Return the first difference of a pair's inputs, compared at the first call."""
        if (path, simulated_path) not in self._compared:
            self._compared[path, simulated_path] = self._compare(self._real[path], self._simulated[simulated_path])
        return self._compared[path, simulated_path]

    @staticmethod
    def _compare(real: Run, simulated: Run) -> Mismatch | None:
        """Return the first difference of two runs in their set-ups or inputs."""
        if real.mechanical != simulated.mechanical:
            real_name, simulated_name = (run.mechanical or "not named" for run in (real, simulated))
            return Mismatch(1.0, f"its set-up is {simulated_name}, that of {real.path} is {real_name}")
        return mismatch(real, simulated)

    def _experiment_text(self, path: Path) -> str:
        run = self._real[path]
        words = [run.attributes.get("protocol"), run.mechanical, run.attributes.get("condition")]
        return "its experiment (" + ", ".join(str(word) for word in words if word) + ")"


def _share(difference: Mismatch | None) -> float:
    """Return the share of samples that differ; zero for None, which is no difference."""
    return 0.0 if difference is None else difference.share
