"""How a run ended: its status, its error, and what each device confirmed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from leactl.driver.contract import Confirmation
from leactl.driver.safe_state import unconfirmed_devices
from leactl.errors import DeviceError, LeactlError, SafetyTrip, Stopped
from leactl.runfile.write.writer import RecordingFailed
from leactl.runner.channel_limits import LimitVerdict


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    path: Path
    status: str
    reason: str
    error: BaseException | None
    safe: Mapping[str, Confirmation]
    duration_s: float
    overruns: int
    notes: Sequence[str] = ()  # what went wrong beside the run and changes nothing of it
    zeros: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # of each tared channel, before and after
    verdicts: Sequence[LimitVerdict] = ()  # on the limits of channels and searches
    reported: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # what each device said of itself

    def as_json(self) -> dict[str, Any]:
        """How the run ended, as `--json` tells it."""
        return {
            "run": str(self.path),
            "status": self.status,
            "reason": self.reason,
            "duration_s": round(self.duration_s, 6),
            "safe": {name: {"confirmed": said.safe, "detail": said.detail} for name, said in self.safe.items()},
        }


def is_out_of_order(error: BaseException) -> bool:
    """Whether a run ended by a trip, without room for its rows, or by what nobody has foreseen, as for want of memory.

    A person, a device that says itself whether it is in fault, and a limit of acceptance end it in order.
    """
    return isinstance(error, SafetyTrip | RecordingFailed) or not isinstance(error, LeactlError | KeyboardInterrupt)


def with_unconfirmed(error: BaseException | None, safe: Mapping[str, Confirmation]) -> BaseException | None:
    """A device that could not be confirmed safe is an error of its own, or part of the one there is."""
    text = unconfirmed_devices(safe)
    if not text:
        return error
    if error is None:
        return DeviceError(text)
    error.add_note(text)
    return error


def joined(error: BaseException | None, further: BaseException | None) -> BaseException | None:
    """What ended the run stays its error; what came after is part of it."""
    if error is None or further is None:
        return error or further
    if str(further) != str(error):
        error.add_note(str(further) or type(further).__name__)
    return error


def status_of(error: BaseException | None) -> tuple[str, str]:
    """Return the status of a run that ended with an error, or without one, and its reason in one line."""
    if error is None:
        return "complete", ""
    kind = "tripped" if isinstance(error, SafetyTrip) else "stopped" if isinstance(error, Stopped) else "failed"
    return kind, str(error).splitlines()[0] if str(error) else type(error).__name__
