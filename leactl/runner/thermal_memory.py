"""What a winding may still hold from before: bounds in a file for each actuator, with the time that they are of.

They cool while nothing runs. A process that died left its actuator no hotter than the limit that its guard kept; its
housing may have gone on warming until the next writing was overdue. What is not known counts as hot.
"""

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
from leactl.runner.latch import state_directory
from leactl.safety.limits import COLDEST_DEGC, HOTTEST_DEGC
from leactl.safety.thermal.bound import HOUSING, ThermalBound
from leactl.safety.thermal.box import Array, Box

FORMAT, VERSION = "leactl-thermal", 1
WRITTEN_EVERY_S = 1.0
OVERDUE_S = 10.0  # without a writing, after which a run is ended
AHEAD_S = 60.0  # by which another clock may be ahead of this one
FORGOTTEN_S = 48 * 3600.0  # by then any actuator is at ambient


@dataclass(frozen=True)
class Recalled:
    """Bounds to start from, and what they are known by."""

    nodes: Array  # hottest phase, mean of the phases, housing [degC]
    known: str


class Memory:
    """The file of one actuator, for one motor at one limit and ambient [degC]."""

    def __init__(self, actuator: str, motor: Motor, limit: float, ambient: float) -> None:
        self.actuator, self._motor, self._limit, self._ambient = actuator, motor, limit, ambient
        self._digest = sha256(motor.model_dump_json().encode()).hexdigest()
        self.path = _path(actuator)

    def recall(self, now: float) -> Recalled:
        """Bounds of this actuator at a time [s since 1970]; hot where nothing can be told."""
        try:
            nodes, time, running = self._read(now)
        except FileNotFoundError:
            return self._hot("nothing is known of it")
        except (OSError, ValueError, KeyError, TypeError, ArithmeticError, RecursionError) as error:
            return self._hot(f"{self.path} cannot be used: {error}")
        left = max(now - time, 0.0)
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
        none = np.zeros(1)
        bound.step(min(left, FORGOTTEN_S), none, none, none, self._ambient)
        return Recalled(bound.nodes()[:, 0], f"{how} {_told(time)}")

    def keep(self, nodes: Array, now: float, running: bool) -> None:
        """Write bounds, whole or not at all.

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
            "time": now,
            "running": running,
            "nodes_degC": [round(float(value), 4) for value in nodes],
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        fresh = self.path.with_suffix(f".{os.getpid()}.new")
        fresh.write_text(json.dumps(body, indent=1) + "\n", encoding="utf-8")
        fresh.replace(self.path)

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

    def _read(self, now: float) -> tuple[Array, float, bool]:
        kept = json.loads(self.path.read_text(encoding="utf-8"))
        if kept["format"] != FORMAT or kept["format_version"] != VERSION:
            raise ValueError(f"format {kept['format']} {kept['format_version']}, {FORMAT} {VERSION} was expected")
        if kept["actuator"] != self.actuator:
            raise ValueError(f"it is of actuator '{kept['actuator']}'")
        if kept["motor_sha256"] != self._digest:
            raise ValueError(f"it is of another motor file ('{kept['motor']}')")
        nodes, time = kept["nodes_degC"], float(kept["time"])
        if len(nodes) != 3 or not all(COLDEST_DEGC <= float(value) <= HOTTEST_DEGC for value in nodes):
            raise ValueError(f"nodes_degC {nodes}: three temperatures in degC were expected")
        if not (math.isfinite(time) and time <= now + AHEAD_S):
            raise ValueError(f"it is of the future, {_told(time)}")
        if kept["running"] not in (True, False):
            raise ValueError("running: true or false was expected")
        return np.array(nodes, float), time, kept["running"]


class Keeper:
    """Writes the bounds of a run every second from a thread of its own, so that no disk holds up the loop."""

    def __init__(
        self, memories: dict[str, Memory], nodes: Callable[[], dict[str, Array]], clock: Callable[[], float]
    ) -> None:
        self._memories, self._nodes, self._clock = memories, nodes, clock
        self._ended = threading.Event()
        self._fault = ""
        self._written = clock()
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
        since = self._clock() - self._written
        return f"the windings' state was not written for {since:.0f} s: {self._fault}" if since > OVERDUE_S else ""

    def stop(self) -> None:
        """Write a last time, at rest where nothing is doubted; where that fails, the next run takes it all as hot."""
        self._ended.set()
        self._thread.join(OVERDUE_S)
        with suppress(OSError):
            self._write(running=self.doubted)

    def _keep_on(self) -> None:
        while not self._ended.wait(WRITTEN_EVERY_S):
            try:
                self._write(running=True)
            except OSError as error:
                self._fault = str(error)

    def _write(self, running: bool) -> None:
        now = self._clock()
        for role, nodes in self._nodes().items():
            self._memories[role].keep(nodes, now, running)
        self._written = now


def known() -> list[Path]:
    """Files of all actuators that something is known of."""
    return sorted((state_directory() / "thermal").glob("*.json"))


def _path(actuator: str) -> Path:
    return state_directory() / "thermal" / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', actuator)}.json"


def _told(time: float) -> str:
    from datetime import UTC, datetime

    try:
        return datetime.fromtimestamp(time, UTC).isoformat(timespec="seconds")
    except (OverflowError, OSError, ValueError):
        return f"{time:g} s"
