"""The process that serves a run's page: `python -m leactl.report.web.server LISTENER`, started by `web.feed`.

LISTENER is the descriptor of a listening socket. stdin carries lines of JSON: the first has the page, its token and its
hosts, the others have the state of the run. A press of STOP is written to stdout as one byte. Requests of clients cost
the run's process nothing, and this process bounds their connections, bytes, time and number per second. When stdin
ends, the run has ended, and this process ends soon after.
"""

import asyncio
import hmac
import io
import json
import os
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from typing import Any, Final
from urllib.parse import parse_qs

from leactl.report.web import LAST_REQUEST_S, STOP

MOST_ROWS: Final = 240  # that are kept: those of a minute, at four a second
MOST_CONNECTIONS: Final = 32  # at a time; a further connection closes the oldest
MOST_ACCEPTED_PER_S: Final = 40  # connections; a page makes two a second
MOST_REQUEST_BYTES: Final = 16384
MOST_DRAINING_READS: Final = 4  # after the answer, of up to MOST_REQUEST_BYTES each, which are dropped
DEADLINE_S: Final = 5.0  # from a connection's start to its end
PART_PAUSE_S: Final = 0.05  # between two reads of a request that comes in parts
NICENESS: Final = 10  # so that the control loop comes first if cores are short
WATCHED_S: Final = 3.0  # since the last request with the token; a page that asked within that time counts as open
MOST_LINE_BYTES: Final = 1 << 20  # of a line on stdin
UNKNOWN_ENDING: Final = "nothing comes from the run any more; its terminal or its file tell how it ended"
HEADERS: Final = {
    "Cache-Control": "no-store",
    # in addition to the page's own policy: another site that frames this page could have STOP pressed
    "Content-Security-Policy": "frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Connection": "close",
}


class PageState:
    """The state of the run that the feed has sent so far: step and times, channels, newest rows, ending."""

    def __init__(self) -> None:
        self.run_state: Mapping[str, Any] = {}  # step, times, windings, warnings, as `feed.run_state` returns them
        self.channels: Sequence[Mapping[str, Any]] = ()
        self.ended: Mapping[str, str] | None = None  # status, reason and file
        self._rows: deque[Sequence[float | None]] = deque(maxlen=MOST_ROWS)
        self._row_count = 0  # of all rows that were sent, of which the newest MOST_ROWS are kept
        self._row_time_s = time.monotonic()  # of the newest row; rows come as long as the control loop runs

    def take(self, line: Mapping[str, Any]) -> None:
        """Update the state by one line of the feed; a key that the line lacks stays as it is."""
        self.run_state = line.get("run_state", self.run_state)
        self.channels = line.get("channels", self.channels)
        self.ended = line.get("ended", self.ended)
        if "row" in line:
            self._rows.append(line["row"])
            self._row_count += 1
            self._row_time_s = time.monotonic()

    def as_json(self, first_row: int) -> dict[str, Any]:
        """Return the run's state with the kept rows from number `first_row` on; the channels only if that is 0."""
        unseen_count = min(max(self._row_count - first_row, 0), len(self._rows))
        return {
            **self.run_state,
            "channels": self.channels if first_row == 0 else None,
            "rows": list(self._rows)[len(self._rows) - unseen_count :],
            "next": self._row_count,
            "silent_s": time.monotonic() - self._row_time_s if self._row_count else 0.0,
            "ended": self.ended,
        }


class Site:
    """What requests read and change: the page, its token and hosts, and the state of the run; STOP goes to stdout."""

    def __init__(self, page: str, token: str, hosts: Sequence[str]) -> None:
        self.page, self.token, self.hosts = page, token, hosts
        self.state = PageState()
        self.last_request_s = float("-inf")  # time of the last request with the token, by `time.monotonic`

    def stop(self) -> None:
        """Ask the run to stop; a pipe that is full holds such requests already."""
        with suppress(BlockingIOError, BrokenPipeError):
            os.write(sys.stdout.fileno(), STOP)


class HttpExchange(BaseHTTPRequestHandler):
    """One request and its answer, both as bytes: the standard library parses and writes the HTTP, without a socket."""

    protocol_version = "HTTP/1.1"
    default_request_version = "HTTP/1.0"  # for a request that names no version; answers of HTTP/0.9 have no status
    METHODS: Final = {"/": "GET", "/state": "GET", "/stop": "POST"}

    def __init__(self, request: bytes, site: Site) -> None:
        self.rfile, self.wfile = io.BytesIO(request), (output := io.BytesIO())
        self._site = site
        self.command, self.requestline, self.request_version = "", "", self.protocol_version
        self.raw_requestline = self.rfile.readline()
        if self.parse_request():  # else the library has called send_error
            self._answer()
        self.answer = output.getvalue()

    def _answer(self) -> None:
        """Write the answer to a parsed request: a refusal, the page, the state as JSON, or that STOP was sent."""
        path, _, query = self.path.partition("?")
        refusal = self._refusal(path, query)
        if refusal is not None:
            self._send(*refusal)
            return
        site, parameters = self._site, parse_qs(query)
        site.last_request_s = time.monotonic()
        if path == "/":
            self._send(HTTPStatus.OK, site.page, "text/html")
        elif path == "/stop":
            site.stop()
            self._send(HTTPStatus.ACCEPTED, "{}", "application/json")
        else:
            since = parameters.get("since", ["0"])[0]
            first_row = int(since) if since.isascii() and since.isdigit() and len(since) < 10 else 0
            self._send(HTTPStatus.OK, json.dumps(site.state.as_json(first_row)), "application/json")

    def _refusal(self, path: str, query: str) -> tuple[HTTPStatus, str] | None:
        """Return status and text of a refusal, None for a request to answer; the token is checked before the path."""
        if self.headers.get("Host", "").lower() not in self._site.hosts:
            return HTTPStatus.FORBIDDEN, "not the address that this page was opened at"
        token = self.headers.get("Authorization", "").removeprefix("Bearer ")
        if path == "/" and not token:  # a browser's first request carries the token in its address alone
            token = parse_qs(query).get("token", [""])[0]
        if not hmac.compare_digest(token.encode(errors="replace"), self._site.token.encode()):
            return HTTPStatus.UNAUTHORIZED, "the token of this run is needed; leactl run --web prints it"
        if path not in self.METHODS:
            return HTTPStatus.NOT_FOUND, "no such page"
        if self.command != self.METHODS[path]:
            return HTTPStatus.METHOD_NOT_ALLOWED, f"{self.METHODS[path]} is expected"
        if self.headers.get("Content-Length", "0") != "0" or "Transfer-Encoding" in self.headers:
            return HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "a request without a body is expected"
        return None

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer a request that is no HTTP by its status alone; the library's text would repeat parts of it."""
        self._send(HTTPStatus(code), HTTPStatus(code).phrase)

    def _send(self, status: HTTPStatus, text: str, media_type: str = "text/plain") -> None:
        """Write a response with all headers and a text as its body."""
        body = text.encode(errors="replace")
        self.send_response_only(status)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", f"{media_type}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        if status is HTTPStatus.UNAUTHORIZED:
            self.send_header("WWW-Authenticate", "Bearer")
        if status is HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", self.METHODS[self.path.partition("?")[0]])
        self.end_headers()
        self.wfile.write(body)


def answer(request: bytes, site: Site) -> bytes:
    """Return the answer to the head of a request; one of more than MOST_REQUEST_BYTES is refused with status 431."""
    if len(request) > MOST_REQUEST_BYTES:
        return b"HTTP/1.1 431 Request Header Fields Too Large\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    return HttpExchange(request, site).answer


async def serve(listener: socket.socket, site: Site) -> None:
    """Accept up to MOST_ACCEPTED_PER_S connections a second, and answer one request on each."""
    loop = asyncio.get_running_loop()
    conversations: dict[asyncio.Task[None], None] = {}  # open ones, the oldest first
    while True:
        with suppress(OSError):  # the client has closed the connection already
            connection, _ = await loop.sock_accept(listener)
            if len(conversations) >= MOST_CONNECTIONS:
                next(iter(conversations)).cancel()
            task = loop.create_task(_converse(connection, site))
            conversations[task] = None
            task.add_done_callback(lambda ended_task: conversations.pop(ended_task, None))
        await asyncio.sleep(1.0 / MOST_ACCEPTED_PER_S)


async def _converse(connection: socket.socket, site: Site) -> None:
    """Read one request from a connection, answer it and close the connection, all within DEADLINE_S."""
    loop, request = asyncio.get_running_loop(), b""
    connection.setblocking(False)
    with connection, suppress(OSError):  # the client is gone or too slow; TimeoutError is an OSError
        async with asyncio.timeout(DEADLINE_S):
            while b"\r\n\r\n" not in request and len(request) <= MOST_REQUEST_BYTES:
                if request:
                    await asyncio.sleep(PART_PAUSE_S)
                received = await loop.sock_recv(connection, MOST_REQUEST_BYTES)
                if not received:
                    return
                request += received
            await loop.sock_sendall(connection, answer(request, site))
            connection.shutdown(socket.SHUT_WR)
            # a socket that is closed with unread bytes resets the connection, and the client may lose the answer
            for _ in range(MOST_DRAINING_READS):
                if not await loop.sock_recv(connection, MOST_REQUEST_BYTES):
                    return


async def _follow_the_run(feed: asyncio.StreamReader, site: Site) -> None:
    """Take the lines of the feed until it ends; then let an open page ask how the run ended, for LAST_REQUEST_S."""
    while line := await feed.readline():
        site.state.take(json.loads(line))
    if site.state.ended is None:
        site.state.take({"ended": {"status": "unknown", "reason": UNKNOWN_ENDING, "run": ""}})
    if time.monotonic() - site.last_request_s < WATCHED_S:
        await asyncio.sleep(LAST_REQUEST_S)


async def _main(listener: socket.socket) -> None:
    """Serve the page from the first line of stdin on, until the run has ended."""
    feed = asyncio.StreamReader(limit=MOST_LINE_BYTES)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(feed), sys.stdin)
    site = Site(**json.loads(await feed.readline()))
    serving = asyncio.create_task(serve(listener, site))
    await _follow_the_run(feed, site)
    serving.cancel()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICENESS)
    os.set_blocking(sys.stdout.fileno(), False)
    with socket.socket(fileno=int(sys.argv[1])) as listening:
        listening.setblocking(False)
        asyncio.run(_main(listening))
