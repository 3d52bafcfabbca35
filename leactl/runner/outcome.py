"""Outcome of a run: its status, its error, and the confirmation of each device."""

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
    """Status, error and confirmations of a run that has ended."""

    path: Path
    status: str
    reason: str
    error: BaseException | None
    safe: Mapping[str, Confirmation]
    duration_s: float
    overruns: int
    notes: Sequence[str] = ()  # faults that did not affect the run
    # zero of each tared channel, before and after the tare [its unit]
    zeros: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    verdicts: Sequence[LimitVerdict] = ()  # on the limits of channels and searches
    reported: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # identity that each device reported

    def as_json(self) -> dict[str, Any]:
        """Return the outcome as `--json` prints it."""
        return {
            "run": str(self.path),
            "status": self.status,
            "reason": self.reason,
            "duration_s": round(self.duration_s, 6),
            "safe": {name: {"confirmed": device.safe, "detail": device.detail} for name, device in self.safe.items()},
        }


def is_out_of_order(error: BaseException) -> bool:
    """Return whether a run ended by a trip, a failed recording, or an unexpected error such as lack of memory.

    A stop by a person, an error of a device, and a broken acceptance limit end a run in order.
    """
    return isinstance(error, SafetyTrip | RecordingFailed) or not isinstance(error, LeactlError | KeyboardInterrupt)


def with_unconfirmed(error: BaseException | None, confirmations: Mapping[str, Confirmation]) -> BaseException | None:
    """Return the error of a run, with the devices that are not confirmed safe added, or as an error of their own."""
    text = unconfirmed_devices(confirmations)
    if not text:
        return error
    if error is None:
        return DeviceError(text)
    error.add_note(text)
    return error


def joined(error: BaseException | None, further: BaseException | None) -> BaseException | None:
    """Return the first error of a run, with the text of a further error added as a note."""
    if error is None or further is None:
        return error or further
    if str(further) != str(error):
        error.add_note(str(further) or type(further).__name__)
    return error


def status_of(error: BaseException | None) -> tuple[str, str]:
    """Return the status of a run that ended with an error or, if None, without an error, and its reason in one line."""
    if error is None:
        return "complete", ""
    kind = "tripped" if isinstance(error, SafetyTrip) else "stopped" if isinstance(error, Stopped) else "failed"
    return kind, str(error).splitlines()[0] if str(error) else type(error).__name__
