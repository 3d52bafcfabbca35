"""Memory of winding temperatures between runs: a file for each actuator, with bounds and their time.

The bounds cool while nothing runs, for as long as is certain by the clock since boot (`leactl.runner.boot_time`). A
process that died left its actuator no hotter than the limit of its guard; its housing may have warmed on until the next
writing was overdue. Where a supply may have been left on, nothing cools. An actuator of which nothing is known counts
as hot.
"""

import errno
import json
import math
import os
import re
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from leactl.errors import InputError
from leactl.model.motor import Motor
from leactl.regular_files import write_at
from leactl.runner import state_folder
from leactl.runner.boot_time import ClockReadings
from leactl.runner.state_folder import StateFolder
from leactl.safety.limits import COLDEST_DEGC, HOTTEST_DEGC
from leactl.safety.thermal.box import Array, Box
from leactl.safety.thermal.temperature_bound import HOUSING, ThermalBound

FORMAT, VERSION = "leactl-thermal", 3
WRITING_INTERVAL_S = 1.0
FILE_BYTES = 4096  # of every writing, so that each is one call and covers the previous one
OVERDUE_S = 10.0  # time without a writing after which a run is ended


@dataclass(frozen=True)
class Recalled:
    """Bounds to start from, and their source."""

    nodes: Array  # hottest phase, mean of the phases, housing [degC]
    known: str  # source of the bounds, for a person
    left_on: float | None = None  # degC, to which a supply that may still be on may bring the winding


class Memory:
    """Stored bounds of one actuator, for one motor at one limit and ambient [degC], in one state folder."""

    def __init__(self, actuator: str, motor: Motor, limit: float, ambient: float, folder: StateFolder) -> None:
        self.actuator, self._motor, self._limit, self._ambient = actuator, motor, limit, ambient
        self._digest = sha256(motor.model_dump_json().encode()).hexdigest()
        self._folder, self.path = folder, folder.winding_file(_file_name(actuator))
        self._descriptor: int | None = None  # of the file, open from the first writing until `close_file`

    def recall(self, now: ClockReadings) -> Recalled:
        """Return the bounds of this actuator at the time `now`; it counts as hot if none can be read.

        If several state folders have bounds, because not all users could write to the same folder, the hottest count.
        """
        recalled = [self._recall(path, now) for path in self._paths()]
        if not recalled:
            return self._hot("nothing is known of it")
        hottest = np.maximum.reduce([bounds.nodes for bounds in recalled])
        left_on = max((bounds.left_on for bounds in recalled if bounds.left_on is not None), default=None)
        return Recalled(hottest, max(recalled, key=lambda bounds: float(bounds.nodes[0])).known, left_on)

    @property
    def known(self) -> bool:
        """Whether any state folder has a file of this actuator."""
        return bool(self._paths())

    def _paths(self) -> list[Path]:
        """Return the files of this actuator in all state folders."""
        has_other_folders = self._folder.shared or self._folder.fault  # a rehearsal keeps its files apart
        folders = [self._folder, *(state_folder.folders() if has_other_folders else ())]
        paths = dict.fromkeys(folder.winding_file(_file_name(self.actuator)) for folder in folders)
        return [path for path in paths if os.path.lexists(path)]

    def _recall(self, path: Path, now: ClockReadings) -> Recalled:
        """Return the bounds at the time `now` by one file; the actuator counts as hot if the file cannot be used."""
        try:
            nodes, written, running, left_on = self._read(path)
            rest_s = now.surely_since(written)
        except (OSError, ValueError, KeyError, TypeError, ArithmeticError, RecursionError) as error:
            return self._hot(f"{path} cannot be used: {getattr(error, 'strerror', None) or error}")
        if running and left_on is not None:
            hottest = max(self._limit, left_on)
            return Recalled(
                np.full(3, hottest), f"a supply may heat it still, since {_time_text(written.wall)}", left_on
            )
        bound = ThermalBound([Box.of(self._motor)], self._ambient)
        origin = "at rest since"
        if running:
            # the guard would have ended the run at the limit; how long the run lasted is not known
            nodes[:HOUSING] = max(self._limit, *nodes[:HOUSING])
            bound.set(nodes[:, None])
            self._warm_housing(bound)
            nodes = np.array([nodes[0], nodes[1], bound.nodes()[HOUSING, 0]])
            rest_s, origin = max(rest_s - OVERDUE_S, 0.0), "its last run ended without a word after"
        bound.set(nodes[:, None])
        bound.rest(rest_s, self._ambient)
        return Recalled(bound.nodes()[:, 0], f"{origin} {_time_text(written.wall)}")

    def keep(self, nodes: Array, now: ClockReadings, running: bool, left_on: float | None = None) -> None:
        """Write bounds in one call; a file that is cut short nevertheless counts as hot.

        nodes : bounds of hottest phase, mean of the phases and housing [degC].
        running : whether a run is under way; if the file still says so when it is recalled, the run has died.
        left_on : temperature to which a supply that the run may switch on would bring the winding if the run died
            [degC]; None if it switches none on.

        Raises
        ------
        OSError : the file cannot be written.
        """
        body = {
            "format": FORMAT,
            "format_version": VERSION,
            "actuator": self.actuator,
            "motor": self._motor.name,
            "motor_sha256": self._digest,
            "time": now.wall,
            "boot": now.boot,
            "since_boot_s": now.since_boot,
            "running": running,
            "left_on_degC": left_on,
            "nodes_degC": [round(float(value), 4) for value in nodes],
        }
        text = (json.dumps(body, indent=1) + "\n").encode().ljust(FILE_BYTES)
        if self._descriptor is not None and not state_folder.is_at_path(self._descriptor, self.path):
            self.close_file()
        if self._descriptor is None:
            self._descriptor = state_folder.open_file(self.path, self._folder.shared)
        if write_at(self._descriptor, text, 0) < len(text):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if os.fstat(self._descriptor).st_size > len(text):  # another program has written here
            os.ftruncate(self._descriptor, len(text))

    def close_file(self) -> None:
        """Close the file that is kept open between writings."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            os.close(descriptor)

    def cold(self) -> Recalled:
        """Return bounds at the highest ambient in every node, for an actuator that a person says is cold."""
        start = self._ambient + Box.of(self._motor).ambient_rise
        return Recalled(np.full(3, start), "said to be cold")

    def _hot(self, reason: str) -> Recalled:
        """Return bounds at the limit in every node, for an actuator of which nothing certain is known."""
        return Recalled(np.full(3, self._limit), f"counts as hot: {reason}")

    def _warm_housing(self, bound: ThermalBound) -> None:
        """Warm the housing of a bound for `OVERDUE_S` while its winding is held where it is."""
        winding = bound.state[:HOUSING].copy()
        for _ in range(math.ceil(OVERDUE_S)):
            bound.step(1.0, np.zeros(1), np.zeros(1), np.zeros(1), self._ambient)
            bound.state[:HOUSING] = winding

    def _read(self, path: Path) -> tuple[Array, ClockReadings, bool, float | None]:
        """Return nodes [degC], time of writing, `running` and `left_on` [degC] of a file.

        Raises
        ------
        OSError, ValueError, KeyError, TypeError : the file cannot be used.
        """
        document = json.loads(state_folder.read(path))
        if document["format"] != FORMAT or document["format_version"] != VERSION:
            raise ValueError(
                f"format {document['format']} {document['format_version']}, {FORMAT} {VERSION} was expected"
            )
        if document["actuator"] != self.actuator:
            raise ValueError(f"it is of actuator '{document['actuator']}'")
        if document["motor_sha256"] != self._digest:
            raise ValueError(f"it is of another motor file ('{document['motor']}')")
        nodes = document["nodes_degC"]
        if not (
            isinstance(nodes, list)
            and len(nodes) == 3
            and all(type(value) in (int, float) and COLDEST_DEGC <= value <= HOTTEST_DEGC for value in nodes)
        ):
            raise ValueError(f"nodes_degC {nodes}: three temperatures in degC were expected")
        if not isinstance(document["boot"], str):
            raise TypeError("boot: the identifier of a boot was expected")
        if type(document["running"]) is not bool:
            raise ValueError("running: true or false was expected")
        left_on = document["left_on_degC"]
        if left_on is not None and not (type(left_on) in (int, float) and left_on <= HOTTEST_DEGC):
            raise ValueError(f"left_on_degC {left_on!r}: null or a temperature in degC was expected")
        for key in ("time", "since_boot_s"):
            if type(document[key]) not in (int, float):
                raise ValueError(f"{key} {document[key]!r}: seconds were expected")
        written = ClockReadings(float(document["time"]), document["boot"], float(document["since_boot_s"]))
        return np.array(nodes, float), written, document["running"], left_on


class Keeper:
    """Writes the bounds of a run every second from a separate thread, so that no disk delays the loop."""

    def __init__(
        self, memories: dict[str, Memory], nodes: Callable[[], dict[str, Array]], clock: Callable[[], ClockReadings]
    ) -> None:
        self._memories, self._nodes, self._clock = memories, nodes, clock
        # by role, of the same winding under another label, with the bounds that it has at least
        self.further: dict[str, tuple[Memory, Array]] = {}
        self._ended = threading.Event()
        self._fault = ""
        self._written = clock()
        self.before_writing: Callable[[], None] = lambda: None  # called before each writing of the thread
        # degC by role, to which a supply may bring a winding if this process dies
        self.left_on: dict[str, float] = {}
        self.seen_off = False  # whether every device has been confirmed safe
        self.doubted = False  # whether a device may still heat the windings after the run
        self._thread = threading.Thread(target=self._write_on, name="leactl-thermal", daemon=True)

    def start(self) -> None:
        """Write once, then start the thread.

        Raises
        ------
        InputError : the file cannot be written.
        """
        try:
            self._write(running=True)
        except OSError as error:
            raise InputError(f"the windings' state cannot be kept: {error}; set LEACTL_STATE") from None
        self._thread.start()

    def fault(self) -> str:
        """Return why nothing has been written for `OVERDUE_S`; empty if the last writing is more recent."""
        silence_s = self._clock().since_boot - self._written.since_boot
        return (
            f"the windings' state was not written for {silence_s:.0f} s: {self._fault}" if silence_s > OVERDUE_S else ""
        )

    def stop(self) -> None:
        """Write a last time, as at rest unless `doubted`; if that fails, the windings count as hot in the next run."""
        self._ended.set()
        self._thread.join(OVERDUE_S)
        with suppress(OSError):
            self._write(running=self.doubted)
        for memory in (*self._memories.values(), *(memory for memory, _least in self.further.values())):
            memory.close_file()

    def _write_on(self) -> None:
        """Write once in each interval until `stop`, and keep the text of a failure."""
        while not self._ended.wait(WRITING_INTERVAL_S):
            self.before_writing()
            try:
                self._write(running=True)
            except OSError as error:
                self._fault = str(error)

    def _write(self, running: bool) -> None:
        """Write the bounds of every role.

        Raises
        ------
        OSError : a file cannot be written.
        """
        now = self._clock()
        for role, nodes in self._nodes().items():
            left_on = None if self.seen_off else self.left_on.get(role)
            is_heated = running or left_on is not None
            self._memories[role].keep(nodes, now, is_heated, left_on)
            if role in self.further:
                memory, least = self.further[role]
                memory.keep(np.maximum(nodes, least), now, is_heated, left_on)
        self._written = now


def _file_name(actuator: str) -> str:
    """Return the name of an actuator's file, with `_` for characters that a file name may not have."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", actuator)


def _time_text(time: float) -> str:
    """Return a time of the wall clock [s] in ISO 8601, or as a number if it is outside the calendar."""
    from datetime import UTC, datetime

    try:
        return datetime.fromtimestamp(time, UTC).isoformat(timespec="seconds")
    except (OverflowError, OSError, ValueError):
        return f"{time:g} s"
