"""Which simulated run belongs to which real one: by name, by experiment and condition, by inputs, then by order."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from leactl.errors import InputError
from leactl.gap.diagnosis import SimulatedRun
from leactl.gap.simulated.inputs import Mismatch, mismatch
from leactl.runfile.read.reader import Run

RIG = ("drive_gain", "load_mass", "load_length", "load_arm_mass")  # of a set-up, by which runs of a protocol differ
Kind = tuple[object, ...]


def paired(real: Sequence[Path], simulated: Sequence[Path]) -> tuple[SimulatedRun, ...]:
    """The simulated run of each real one, with the same inputs.

    A simulated run may belong to several real ones, as repeats of one experiment are. A run of the same name comes
    first, else one of the same experiment, set-up and condition; of several such, those with the same inputs; of
    several of these, the first belongs to the first real run, and so on.

    Raises
    ------
    InputError : no run, or no single one, belongs to a real run, or it has other inputs; one line each.
    """
    both = {path.resolve() for path in real} & {path.resolve() for path in simulated}
    if both:
        raise InputError(
            [f"{path}: is both real and simulated; a run can be on one side only" for path in sorted(both)]
        )
    with ExitStack() as opened:
        ours, theirs = ({path: opened.enter_context(Run.open(path)) for path in side} for side in (real, simulated))
        pairing = _Pairing(ours, theirs)
        pairs, faults = [], list[str]()
        for path in ours:
            try:
                pairs.append(pairing.of(path))
            except InputError as error:
                faults += error.faults
        if faults:
            raise InputError(faults)
    return tuple(pairs)


def kind_of(run: Run) -> Kind:
    """What runs that can stand for each other have in common."""
    names = ("protocol", "condition")
    rig = (run.setup.get(name) for name in RIG)
    return (*(str(run.attributes.get(name) or "") for name in names), run.mechanical, *rig)


class _Pairing:
    """Open runs of both sides, each pair's inputs compared once."""

    def __init__(self, real: Mapping[Path, Run], simulated: Mapping[Path, Run]) -> None:
        self._real, self._simulated = real, simulated
        self._compared: dict[tuple[Path, Path], Mismatch | None] = {}

    def of(self, path: Path) -> SimulatedRun:
        named = [other for other in self._simulated if other.stem == path.stem]
        alike = named or [o for o, run in self._simulated.items() if kind_of(run) == kind_of(self._real[path])]
        if not alike:
            raise InputError(f"{path}: no simulated run of its name, nor of {self._described(path)}")
        same = [other for other in alike if self._mismatch(path, other) is None]
        if not same:
            nearest = min(alike, key=lambda other: _share(self._mismatch(path, other)))
            fault = self._mismatch(path, nearest)
            assert fault is not None
            raise InputError(f"{nearest}: {fault.text}")
        if len(alike) == 1:
            return SimulatedRun(str(path), str(same[0]), "name" if named else "experiment")
        if len(same) == 1:
            return SimulatedRun(str(path), str(same[0]), "inputs")
        repeats = [run for run in self._real if any(self._mismatch(run, other) is None for other in same)]
        if len(repeats) != len(same):
            names = ", ".join(map(str, same))
            raise InputError(
                f"{path}: {len(same)} simulated runs have its inputs ({names}) and {len(repeats)} real runs do; name"
                " each as its real run, or give one"
            )
        return SimulatedRun(str(path), str(same[repeats.index(path)]), "order")

    def _mismatch(self, path: Path, other: Path) -> Mismatch | None:
        if (path, other) not in self._compared:
            self._compared[path, other] = self._compare(self._real[path], self._simulated[other])
        return self._compared[path, other]

    @staticmethod
    def _compare(real: Run, simulated: Run) -> Mismatch | None:
        if real.mechanical != simulated.mechanical:
            ours, theirs = (run.mechanical or "not named" for run in (real, simulated))
            return Mismatch(1.0, f"its set-up is {theirs}, that of {real.path} is {ours}")
        return mismatch(real, simulated)

    def _described(self, path: Path) -> str:
        run = self._real[path]
        words = [run.attributes.get("protocol"), run.mechanical, run.attributes.get("condition")]
        return "its experiment (" + ", ".join(str(word) for word in words if word) + ")"


def _share(difference: Mismatch | None) -> float:
    return 0.0 if difference is None else difference.share
