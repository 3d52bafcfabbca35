"""The run's side of its page: start the process that serves the page, send it the run's state, and receive STOP.

No client can harm the run: clients connect to `server`, a process of lower priority that holds nothing of the run. The
run's process accepts no connection and parses no request. Four times a second a thread of the run's process copies the
`Progress` that the control loop publishes, which takes some 0.1 ms of the interpreter's time, and writes a line into a
pipe that never blocks; while the pipe is full, no further line is written. The control loop waits for neither. STOP
comes back as one byte, which the thread turns into a cause to stop; the loop checks that cause once a cycle, as it
checks the stop keys, and ends the run through its supervisor.
"""

import errno
import ipaddress
import json
import math
import os
import re
import secrets
import select
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from leactl.errors import InputError
from leactl.quantities import ChannelSpec
from leactl.report.html import render
from leactl.report.web import FREE_PORT_HERE, LAST_REQUEST_S, STOP
from leactl.runner.progress import Progress

STOP_CAUSE: Final = "stopped by the operator: STOP in the run's page"
LINES_A_SECOND: Final = 4
MOST_WARNINGS: Final = 50  # that the page shows: the newest
PATIENCE_S: Final = 2.0  # time for the server to end, beyond LAST_REQUEST_S
LISTEN_BACKLOG: Final = 16  # connections that the system queues before they are accepted
ADDRESS: Final = re.compile(r"\[?(?P<host>[^\[\]]+)\]?:(?P<port>[0-9]{1,5})")
DRAWN_BY_DEFAULT: Final = ("torque", "velocity", "q_axis_current")  # channels of the test actuator
REASONS: Final = {
    errno.EADDRINUSE: "another program has this port; 0 takes a free one",
    errno.EADDRNOTAVAIL: "not an address of this machine",
    errno.EACCES: "this user may not take this port; 0 takes a free one",
}


class RunPage:
    """The page of one run: `with RunPage(address, bench) as page: ...` around it."""

    def __init__(self, address: str, bench: str) -> None:
        """Parse the address to serve the page at; the page is served inside the `with` block only.

        Parameters
        ----------
        address : ADDRESS:PORT as `--web` takes it; port 0 is a free one.
        bench : name of the bench, for the stop command that the page prints.

        Raises
        ------
        InputError : the address is not the IP address of one machine with a port, or this system is not POSIX.
        """
        self._host, self._port = _parsed_address(address)
        self._address_text, self._bench = address, bench
        self._token = secrets.token_urlsafe(24)
        self._progress: Progress | None = None
        self._stop_cause = ""
        self._ended: Mapping[str, str] | None = None
        self._end_event = threading.Event()
        self.fault = ""  # why the page did not get the state of the run up to its end; empty if it did
        self.url = ""  # of the page, with the token
        self._thread = threading.Thread(target=self._feed_until_end, name="leactl-page", daemon=True)

    @property
    def is_of_this_machine_alone(self) -> bool:
        """Return whether no other machine can reach the page."""
        return self._host.is_loopback

    def __enter__(self) -> Self:
        """Start the server process and the thread that sends it the state of the run.

        Raises
        ------
        InputError : the address is not one of this machine, or its port cannot be taken.
        """
        page = render("live.html", ("axes.js", "web/page.js"), bench=self._bench)
        family = socket.AF_INET if self._host.version == 4 else socket.AF_INET6
        try:
            listener = socket.create_server((str(self._host), self._port), family=family, backlog=LISTEN_BACKLOG)
        except OSError as error:
            reason = REASONS.get(error.errno or 0, error.strerror)
            raise InputError(f"--web {self._address_text}: {reason}") from None
        with listener:
            port = listener.getsockname()[1]
            # Ctrl-C does not reach a new session; the token goes by stdin, so that no list of processes shows it
            self._server = subprocess.Popen(
                [sys.executable, "-P", "-m", "leactl.report.web.server", str(listener.fileno())],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                pass_fds=(listener.fileno(),),
                start_new_session=True,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(folder or str(Path.cwd()) for folder in sys.path)},
            )
        host = f"[{self._host}]" if self._host.version == 6 else str(self._host)
        self.url = f"http://{host}:{port}/?token={self._token}"
        host_names = [host, "localhost"] if self.is_of_this_machine_alone else [host]
        accepted_hosts = [f"{name}:{port}" for name in host_names] + (host_names if port == 80 else [])
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._server_input, self._server_output = self._server.stdin.fileno(), self._server.stdout.fileno()
        os.set_blocking(self._server_input, False)
        self._unsent = _line({"page": page, "token": self._token, "hosts": accepted_hosts})
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        if self._ended is None:
            reason = (str(error) or type(error).__name__).splitlines()[0] if error is not None else ""
            self.end("failed", reason, "")
        self._thread.join(PATIENCE_S)
        for pipe in (self._server.stdin, self._server.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        try:
            self._server.wait(LAST_REQUEST_S + PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._server.kill()
            self._server.wait()

    def show(self, progress: Progress) -> None:
        """Show the run that publishes this progress."""
        self._progress = progress

    def stop_cause(self) -> str:
        """Return the cause to stop the run, once STOP was pressed; empty before."""
        return self._stop_cause

    def end(self, status: str, reason: str, run: str) -> None:
        """Show how the run ended: status, reason and path of the run file; nothing is shown after that."""
        self._ended = {"status": status, "reason": reason, "run": run}
        self._end_event.set()

    # -- in the thread ------------------------------------------------------------------------------------------------

    def _feed_until_end(self) -> None:
        """Feed the page until the run ends, then send its ending; if feeding fails, wait for STOP alone."""
        try:
            try:
                self._feed()
            except BrokenPipeError:
                raise
            except Exception as error:  # noqa: BLE001 (a fault of the page must not end the run)
                self._note_fault(f"{type(error).__name__}: {error}")
                while not self._end_event.is_set():  # STOP still has to work
                    self._wait_for_stop(1.0 / LINES_A_SECOND)
            self._send_ending()
        except OSError:
            self._note_fault("its server has ended")

    def _note_fault(self, reason: str) -> None:
        """Store the first fault of the page for the command and the run's file, which report it."""
        self.fault = self.fault or f"the run's page is no longer fed: {reason}"
        if self._progress is not None:
            self._progress.view_fault = self.fault

    def _feed(self) -> None:
        """Send the channels once, then the run's state and its newest row, until the run ends."""
        progress, sent_time_s = None, -math.inf
        while not self._end_event.is_set():
            self._wait_for_stop(1.0 / LINES_A_SECOND)
            if progress is None:
                progress = self._progress
                if progress is not None:
                    self._unsent += _line({"channels": channels(progress.streams)})
            if not self._send() or progress is None:
                continue
            message: dict[str, Any] = {"run_state": run_state(progress, self._stop_cause)}
            if progress.time_s > sent_time_s:
                sent_time_s = progress.time_s
                message["row"] = [round(sent_time_s, 6), *newest_values(progress)]
            self._unsent += _line(message)
            self._send()
        if progress is not None:
            self._unsent += _line({"run_state": run_state(progress, self._stop_cause)})

    def _send_ending(self) -> None:
        """Send how the run ended; wait up to PATIENCE_S / 2 at a time for room in the pipe, then give up."""
        self._unsent += _line({"ended": self._ended})
        while not self._send():
            if not select.select([], [self._server_input], [], PATIENCE_S / 2)[1]:
                self.fault = "the run's page is not told how the run ended: its server takes nothing"
                return

    def _wait_for_stop(self, seconds: float) -> None:
        """Wait for a press of STOP, at most `seconds`; after a press, wait for the end of the run instead.

        Raises
        ------
        BrokenPipeError : the server has ended.
        """
        if self._stop_cause:
            self._end_event.wait(seconds)
        elif select.select([self._server_output], [], [], seconds)[0]:
            if os.read(self._server_output, len(STOP)) != STOP:
                raise BrokenPipeError
            self._stop_cause = STOP_CAUSE

    def _send(self) -> bool:
        """Write the unsent bytes as far as the pipe takes them; return whether all are written."""
        with suppress(BlockingIOError):
            while self._unsent:
                self._unsent = self._unsent[os.write(self._server_input, self._unsent) :]
        return not self._unsent


def _parsed_address(text: str) -> tuple[ipaddress.IPv4Address | ipaddress.IPv6Address, int]:
    """Return the IP address of one machine and the port that ADDRESS:PORT names.

    Raises
    ------
    InputError : the text is no such address, or this system is not POSIX.
    """
    if os.name != "posix" or not hasattr(os, "set_blocking"):  # Windows lets no process inherit a listening socket
        raise InputError("--web: the page of a run is served on POSIX systems alone")
    match = ADDRESS.fullmatch(text)
    if match is None or int(match["port"]) > 65535:
        raise InputError(
            f"--web {text}: ADDRESS:PORT was expected, such as {FREE_PORT_HERE}, [::1]:0 or 192.168.1.20:8080"
        )
    try:
        host = ipaddress.ip_address(match["host"])
    except ValueError:
        raise InputError(
            f"--web {text}: an IP address of this machine was expected, such as 127.0.0.1, not the name of one"
        ) from None
    if host.is_unspecified or host.is_multicast:
        raise InputError(f"--web {text}: the one address at which the page is to be opened was expected")
    return host, int(match["port"])


def channels(streams: Mapping[str, Sequence[ChannelSpec]]) -> list[dict[str, Any]]:
    """Return, stream by stream, each channel as `page.js` takes it: name, unit, title of its chart, kind of curve."""
    return [
        {
            "name": spec.name if stream == "loop" else f"{stream}/{spec.name}",
            "unit": "" if spec.unit == "1" else spec.unit,
            "chart": ", ".join(filter(None, [_quantity(spec), spec.role, spec.location])),
            "is_setpoint": spec.quantity.endswith("_reference"),
            "drawn": spec.role == "test" and _quantity(spec).replace(" ", "_") in DRAWN_BY_DEFAULT,
        }
        for stream, specs in streams.items()
        for spec in specs
    ]


def _quantity(spec: ChannelSpec) -> str:
    """Return the quantity of a channel in words; a setpoint has that of its reading."""
    return spec.quantity.removesuffix("_reference").replace("_", " ")


def newest_values(progress: Progress) -> list[float | None]:
    """Return the newest value of each channel, in the order of `channels`; None where the channel has no number."""
    row_by_stream = {"loop": progress.values, **progress.device_values}
    values: list[float | None] = []
    for stream, specs in progress.streams.items():
        row = row_by_stream.get(stream, ())
        values += [_number(row[k]) if k < len(row) else None for k in range(len(specs))]
    return values


def run_state(progress: Progress, stop_cause: str) -> dict[str, Any]:
    """Return step, times, warnings and winding temperatures of a run, as `page.js` takes them."""
    estimates, bounds = progress.windings
    seconds_to_limit = progress.time_to_limit()
    return {
        "title": progress.title,
        "step": progress.step,
        "share": progress.share,
        "done_s": progress.done_s,
        "total_s": progress.total_s,
        "left_s": _number(progress.left_s),
        "pause": progress.pause,
        "prompt": progress.prompt,
        "warnings": progress.warnings[-MOST_WARNINGS:],
        "warnings_before": max(len(progress.warnings) - MOST_WARNINGS, 0),
        "stopping": stop_cause,
        "windings": [
            {
                "role": role,
                "estimate_degC": _number(estimate),
                "bound_degC": _number(bounds[role]),
                "limit_degC": _number(progress.winding_limit),
                "to_limit_s": _number(seconds_to_limit.get(role, math.inf)),
            }
            for role, estimate in estimates.items()
        ],
    }


def _number(value: float) -> float | None:
    """Return a value rounded to seven significant digits, more than float32 has; None if it is not finite."""
    return float(f"{value:.7g}") if math.isfinite(value) else None


def _line(message: Mapping[str, Any]) -> bytes:
    """Return a message as one line of JSON in UTF-8."""
    return json.dumps(message).encode() + b"\n"
