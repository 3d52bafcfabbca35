"""What a winding may still hold from before: bounds in a file for each actuator, with the time that they are of.

They cool while nothing runs, for as long as is certain by the clock since boot (`leactl.runner.boot_time`). A process
that died left its actuator no hotter than the limit that its guard kept; its housing may have warmed on until the next
writing was overdue. Where a supply may have been left on, nothing cools. What is not known counts as hot.
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
from leactl.runner.state_folder import Place
from leactl.safety.limits import COLDEST_DEGC, HOTTEST_DEGC
from leactl.safety.thermal.bound import HOUSING, ThermalBound
from leactl.safety.thermal.box import Array, Box

FORMAT, VERSION = "leactl-thermal", 3
WRITTEN_EVERY_S = 1.0
BYTES = 4096  # of a file, so that each writing is one call and covers all of the one before
OVERDUE_S = 10.0  # without a writing, after which a run is ended


@dataclass(frozen=True)
class Recalled:
    """Bounds to start from, and what they are known by."""

    nodes: Array  # hottest phase, mean of the phases, housing [degC]
    known: str
    left_on: float | None = None  # degC that a supply may hold it at which nobody is known to have switched off


class Memory:
    """What is kept of one actuator, for one motor at one limit and ambient [degC], in a place of state."""

    def __init__(self, actuator: str, motor: Motor, limit: float, ambient: float, place: Place) -> None:
        self.actuator, self._motor, self._limit, self._ambient = actuator, motor, limit, ambient
        self._digest = sha256(motor.model_dump_json().encode()).hexdigest()
        self._place, self.path = place, place.windings(_file_name(actuator))
        self._held: int | None = None  # its file, open from the first writing on: the last one needs no descriptor

    def recall(self, now: ClockReadings) -> Recalled:
        """Bounds of this actuator at a moment; hot where nothing can be told.

        Where several places tell of it, since not all users could write to one, the hottest counts.
        """
        recalled = [self._recall(path, now) for path in self._kept()]
        if not recalled:
            return self._hot("nothing is known of it")
        hottest = np.maximum.reduce([one.nodes for one in recalled])
        left_on = max((one.left_on for one in recalled if one.left_on is not None), default=None)
        return Recalled(hottest, max(recalled, key=lambda one: float(one.nodes[0])).known, left_on)

    @property
    def known(self) -> bool:
        """Whether anything is kept of it."""
        return bool(self._kept())

    def _kept(self) -> list[Path]:
        several = self._place.shared or self._place.fault  # a rehearsal's are kept apart
        places = [self._place, *(state_folder.places() if several else ())]
        paths = dict.fromkeys(place.windings(_file_name(self.actuator)) for place in places)
        return [path for path in paths if os.path.lexists(path)]

    def _recall(self, path: Path, now: ClockReadings) -> Recalled:
        try:
            nodes, kept, running, left_on = self._read(path)
            left = now.surely_since(kept)
        except (OSError, ValueError, KeyError, TypeError, ArithmeticError, RecursionError) as error:
            return self._hot(f"{path} cannot be used: {getattr(error, 'strerror', None) or error}")
        if running and left_on is not None:
            hottest = max(self._limit, left_on)
            return Recalled(np.full(3, hottest), f"a supply may heat it still, since {_told(kept.wall)}", left_on)
        bound = ThermalBound([Box.of(self._motor)], self._ambient)
        how = "at rest since"
        if running:
            # its guard would have ended it at the limit; nothing tells for how long it went on
            nodes[:HOUSING] = max(self._limit, *nodes[:HOUSING])
            bound.set(nodes[:, None])
            self._warm_housing(bound)
            nodes = np.array([nodes[0], nodes[1], bound.nodes()[HOUSING, 0]])
            left, how = max(left - OVERDUE_S, 0.0), "its last run ended without a word after"
        bound.set(nodes[:, None])
        bound.rest(left, self._ambient)
        return Recalled(bound.nodes()[:, 0], f"{how} {_told(kept.wall)}")

    def keep(self, nodes: Array, now: ClockReadings, running: bool, left_on: float | None = None) -> None:
        """Write bounds in one call; a file that is cut short all the same counts as hot.

        left_on : what its supply would bring it to [degC] if the run died, where the run may switch one on.

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
        text = (json.dumps(body, indent=1) + "\n").encode().ljust(BYTES)
        if self._held is not None and not state_folder.in_place(self._held, self.path):
            self.let_go()
        if self._held is None:
            self._held = state_folder.opened(self.path, self._place.shared)
        if write_at(self._held, text, 0) < len(text):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if os.fstat(self._held).st_size > len(text):  # something else has written here
            os.ftruncate(self._held, len(text))

    def let_go(self) -> None:
        """Close the file that is kept open between writings."""
        held, self._held = self._held, None
        if held is not None:
            os.close(held)

    def cold(self) -> Recalled:
        """At ambient throughout, as a person says."""
        start = self._ambient + Box.of(self._motor).ambient_rise
        return Recalled(np.full(3, start), "said to be cold")

    def _hot(self, why: str) -> Recalled:
        return Recalled(np.full(3, self._limit), f"counts as hot: {why}")

    def _warm_housing(self, bound: ThermalBound) -> None:
        """What a housing takes up while its winding is held at the limit, until a writing is overdue."""
        rest = bound.state[:HOUSING].copy()
        for _ in range(math.ceil(OVERDUE_S)):
            bound.step(1.0, np.zeros(1), np.zeros(1), np.zeros(1), self._ambient)
            bound.state[:HOUSING] = rest

    def _read(self, path: Path) -> tuple[Array, ClockReadings, bool, float | None]:
        kept = json.loads(state_folder.read(path))
        if kept["format"] != FORMAT or kept["format_version"] != VERSION:
            raise ValueError(f"format {kept['format']} {kept['format_version']}, {FORMAT} {VERSION} was expected")
        if kept["actuator"] != self.actuator:
            raise ValueError(f"it is of actuator '{kept['actuator']}'")
        if kept["motor_sha256"] != self._digest:
            raise ValueError(f"it is of another motor file ('{kept['motor']}')")
        nodes = kept["nodes_degC"]
        if not (
            isinstance(nodes, list)
            and len(nodes) == 3
            and all(type(value) in (int, float) and COLDEST_DEGC <= value <= HOTTEST_DEGC for value in nodes)
        ):
            raise ValueError(f"nodes_degC {nodes}: three temperatures in degC were expected")
        if not isinstance(kept["boot"], str):
            raise TypeError("boot: the identifier of a boot was expected")
        if type(kept["running"]) is not bool:
            raise ValueError("running: true or false was expected")
        left_on = kept["left_on_degC"]
        if left_on is not None and not (type(left_on) in (int, float) and left_on <= HOTTEST_DEGC):
            raise ValueError(f"left_on_degC {left_on!r}: null or a temperature in degC was expected")
        for key in ("time", "since_boot_s"):
            if type(kept[key]) not in (int, float):
                raise ValueError(f"{key} {kept[key]!r}: seconds were expected")
        moment = ClockReadings(float(kept["time"]), kept["boot"], float(kept["since_boot_s"]))
        return np.array(nodes, float), moment, kept["running"], left_on


class Keeper:
    """Writes the bounds of a run every second from a thread of its own, so that no disk holds up the loop."""

    def __init__(
        self, memories: dict[str, Memory], nodes: Callable[[], dict[str, Array]], clock: Callable[[], ClockReadings]
    ) -> None:
        self._memories, self._nodes, self._clock = memories, nodes, clock
        self._ended = threading.Event()
        self._fault = ""
        self._written = clock()
        self.beside: Callable[[], None] = lambda: None  # what else is to be looked after as often
        self.left_on: dict[str, float] = {}  # degC, that a supply may bring each role's winding to if this process dies
        self.seen_off = False  # whether every device was confirmed safe since
        self.doubted = False  # whether something may go on heating them when the run has ended
        self._thread = threading.Thread(target=self._keep_on, name="leactl-thermal", daemon=True)

    def start(self) -> None:
        """Write once, and go on from the thread.

        Raises
        ------
        InputError : the state cannot be kept.
        """
        try:
            self._write(running=True)
        except OSError as error:
            raise InputError(f"the windings' state cannot be kept: {error}; set LEACTL_STATE") from None
        self._thread.start()

    def fault(self) -> str:
        """Why nothing has been written for too long; empty where all is well."""
        since = self._clock().since_boot - self._written.since_boot
        return f"the windings' state was not written for {since:.0f} s: {self._fault}" if since > OVERDUE_S else ""

    def stop(self) -> None:
        """Write a last time, at rest where nothing is doubted; where that fails, the next run takes it all as hot."""
        self._ended.set()
        self._thread.join(OVERDUE_S)
        with suppress(OSError):
            self._write(running=self.doubted)
        for memory in self._memories.values():
            memory.let_go()

    def _keep_on(self) -> None:
        while not self._ended.wait(WRITTEN_EVERY_S):
            self.beside()
            try:
                self._write(running=True)
            except OSError as error:
                self._fault = str(error)

    def _write(self, running: bool) -> None:
        now = self._clock()
        for role, nodes in self._nodes().items():
            left_on = None if self.seen_off else self.left_on.get(role)
            self._memories[role].keep(nodes, now, running or left_on is not None, left_on)
        self._written = now


def _file_name(actuator: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]", "_", actuator)


def _told(time: float) -> str:
    from datetime import UTC, datetime

    try:
        return datetime.fromtimestamp(time, UTC).isoformat(timespec="seconds")
    except (OverflowError, OSError, ValueError):
        return f"{time:g} s"
