"""A trip outlives its process: the bench stays latched in a file until a person resets it."""

import json
import os
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from leactl.errors import LeactlError, SafetyTrip
from leactl.runfile.publish import force_to_disk


@dataclass(frozen=True)
class Trip:
    """Why and when a bench was tripped, and the run that shows it."""

    bench: str
    cause: str
    time: str  # ISO 8601, UTC
    run: str


def state_directory() -> Path:
    """Where leactl keeps what must outlive a process: `LEACTL_STATE`, else the user's state directory (XDG)."""
    own = os.environ.get("LEACTL_STATE")
    if own:
        return Path(own)
    state = os.environ.get("XDG_STATE_HOME")
    return (Path(state) if state else Path.home() / ".local" / "state") / "leactl"


def latch(bench: str, cause: str, run: Path) -> None:
    """Latch a bench, on the disk when this returns; a write that is cut short latches it too, with a cause unknown.

    Raises
    ------
    LeactlError : the latch could not be written; the bench is safe, but the next run will not know.
    """
    trip = Trip(bench, cause, datetime.now(UTC).isoformat(timespec="seconds"), str(run))
    path = _path(bench)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", encoding="utf-8") as file:
            file.write(json.dumps(asdict(trip), indent=1) + "\n")
            file.flush()
            os.fsync(file.fileno())
        force_to_disk(path.parent)
    except OSError as error:
        raise LeactlError(f"{path}: the trip could not be latched: {error.strerror or error}") from None


def latched(bench: str) -> Trip | None:
    """The trip that holds this bench, or None; a latch that cannot be read holds it too."""
    path = _path(bench)
    try:
        return Trip(**json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError) as error:
        return Trip(bench, f"unknown, {path} cannot be read: {error}", "", "")


def refuse_latched(bench: str) -> None:
    """Refuse to move a tripped bench.

    Raises
    ------
    SafetyTrip : with the cause and the command that resets it.
    """
    trip = latched(bench)
    if trip is not None:
        raise SafetyTrip(f"bench '{bench}' is tripped since {trip.time}: {trip.cause}; see: leactl bench reset {bench}")


def release(bench: str) -> None:
    """Take the latch away."""
    _path(bench).unlink(missing_ok=True)


def _path(bench: str) -> Path:
    return state_directory() / f"{bench}.trip.json"
