"""One bench with a planted effect: diagnosed first, the answer written, and only then the key opened."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from leactl.gap.blind.answers import MODEL_FILE, case_names, runs_of, write
from leactl.gap.blind.check import OpenKey
from leactl.gap.blind.truth import Truth
from leactl.gap.diagnose import diagnose, read_case
from leactl.gap.diagnosis import Cause, DiagnosisResult
from leactl.gap.verdict.decision import NAMED_PROBABILITY
from leactl.processes import Progress

Outcome = Literal["named", "named with others", "missed"]


@dataclass(frozen=True)
class Demonstration:
    """Planted effect, and the diagnosis made before the key was opened."""

    answer: DiagnosisResult
    planted: str
    strength: str
    parameters: Mapping[str, float]  # of the planted effect

    @property
    def cause(self) -> Cause | None:
        """The planted effect among the named causes; None if it is not named."""
        return next((cause for cause in named_causes(self.answer) if cause.effect == self.planted), None)

    @property
    def outcome(self) -> Outcome:
        """Whether the planted effect is named alone, with others, or missed."""
        if self.cause is None:
            return "missed"
        return "named" if len(named_causes(self.answer)) == 1 else "named with others"

    @property
    def others(self) -> tuple[Cause, ...]:
        """Named causes beside the planted one."""
        return tuple(cause for cause in named_causes(self.answer) if cause.effect != self.planted)


def named_causes(answer: DiagnosisResult) -> list[Cause]:
    """Return the causes at even odds or better."""
    return [cause for cause in answer.causes if cause.probability >= NAMED_PROBABILITY]


def demonstrate(cases: Path, out: Path, open_key: OpenKey, progress: Progress) -> Demonstration:
    """Diagnose the only case of a folder, write the answer, and compare it with the key.

    Parameters
    ----------
    out : file of the answer, which is written before the key is opened.
    open_key : reads and checks the key.

    Raises
    ------
    InputError : the folder has no case, the case cannot be diagnosed, or the key is that of other cases.
    """
    [name] = case_names(cases)
    answer = diagnose(read_case(runs_of(cases / name), [], cases / name / MODEL_FILE), progress)
    write(out, answer.as_json())
    progress("opening the key")
    truth = Truth.of(open_key()["cases"][name])
    [planted] = truth.effects
    return Demonstration(answer, planted, truth.strength or "", truth.parameters[planted])
