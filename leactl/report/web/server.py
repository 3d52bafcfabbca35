"""The page's own process: `python -m leactl.report.web.server LISTENER`, started by `leactl.report.web.feed`.

stdin brings a line of JSON at a time: first the page, its token and its hosts, then what the run shows. A STOP becomes
one byte on stdout. Clients may do what they like: no work of theirs is done in the run's process, and here connections,
bytes, time and requests per second are bounded. The end of stdin is the end of the run, and soon of this process.
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

from leactl.report.web import LAST_LOOK_S, STOP

MOST_ROWS: Final = 240  # a minute at the pace of the feed
MOST_OPEN: Final = 32  # connections; one more closes the oldest
MOST_A_SECOND: Final = 40  # connections that are accepted; a page makes two a second
MOST_BYTES: Final = 16384  # of a request
MOST_PARTS_AFTER: Final = 4  # of that size, that are read and dropped behind an answer
DEADLINE_S: Final = 5.0  # from a connection's start to its end
PART_PAUSE_S: Final = 0.05  # before more of a request is read that came in parts
NICENESS: Final = 10  # the control loop comes first where cores are short
WATCHED_S: Final = 3.0  # since a page asked last, within which somebody is taken to look at it
MOST_LINE: Final = 1 << 20  # bytes of a line on stdin
NO_WORD: Final = "nothing comes from the run any more; its terminal or its file tell how it ended"
HEADERS: Final = {
    "Cache-Control": "no-store",
    # beside the page's own policy: a page of somebody else that holds this one could have its STOP pressed
    "Content-Security-Policy": "frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Connection": "close",
}


class PageState:
    """What the run has shown by now."""

    def __init__(self) -> None:
        self.standing: Mapping[str, Any] = {}  # step, times, windings, warnings: as `feed.standing` has them
        self.channels: Sequence[Mapping[str, Any]] = ()
        self.ended: Mapping[str, str] | None = None  # status, reason and file
        self._rows: deque[Sequence[float | None]] = deque(maxlen=MOST_ROWS)
        self._count = 0  # of rows that came, kept or not
        self._row_at = time.monotonic()  # a row comes while the loop makes cycles

    def take(self, line: Mapping[str, Any]) -> None:
        """Take a line of the feed."""
        self.standing = line.get("standing", self.standing)
        self.channels = line.get("channels", self.channels)
        self.ended = line.get("ended", self.ended)
        if "row" in line:
            self._rows.append(line["row"])
            self._count += 1
            self._row_at = time.monotonic()

    def as_json(self, since: int) -> dict[str, Any]:
        """Return all that a page lacks that has the rows up to `since`; the channels where it has none."""
        lacking = min(max(self._count - since, 0), len(self._rows))
        return {
            **self.standing,
            "channels": self.channels if since == 0 else None,
            "rows": list(self._rows)[len(self._rows) - lacking :],
            "next": self._count,
            "silent_s": time.monotonic() - self._row_at if self._count else 0.0,
            "ended": self.ended,
        }


class Site:
    """What is served: the page, the run's state, and the way to stop it."""

    def __init__(self, page: str, token: str, hosts: Sequence[str]) -> None:
        self.page, self.token, self.hosts = page, token, hosts
        self.shown = PageState()
        self.asked_at = float("-inf")  # by a page with the token, on the clock of `time.monotonic`

    def stop(self) -> None:
        """Ask the run to stop; a pipe that is full of such requests needs no further one."""
        with suppress(BlockingIOError, BrokenPipeError):
            os.write(sys.stdout.fileno(), STOP)


class HttpExchange(BaseHTTPRequestHandler):
    """One request and its answer, both as bytes: the standard library reads and writes HTTP, and no socket."""

    protocol_version = "HTTP/1.1"
    default_request_version = "HTTP/1.0"  # 0.9, where a request names none, has answers without a status
    METHODS: Final = {"/": "GET", "/state": "GET", "/stop": "POST"}

    def __init__(self, request: bytes, site: Site) -> None:
        self.rfile, self.wfile = io.BytesIO(request), (written := io.BytesIO())
        self._site = site
        self.command, self.requestline, self.request_version = "", "", self.protocol_version
        self.raw_requestline = self.rfile.readline()
        if self.parse_request():  # else it has answered
            self._answer()
        self.answer = written.getvalue()

    def _answer(self) -> None:
        path, _, query = self.path.partition("?")
        refusal = self._refusal(path, query)
        if refusal is not None:
            self._send(*refusal)
            return
        site, given = self._site, parse_qs(query)
        site.asked_at = time.monotonic()
        if path == "/":
            self._send(HTTPStatus.OK, site.page, "text/html")
        elif path == "/stop":
            site.stop()
            self._send(HTTPStatus.ACCEPTED, "{}", "application/json")
        else:
            since = given.get("since", ["0"])[0]
            known = int(since) if since.isascii() and since.isdigit() and len(since) < 10 else 0
            self._send(HTTPStatus.OK, json.dumps(site.shown.as_json(known)), "application/json")

    def _refusal(self, path: str, query: str) -> tuple[HTTPStatus, str] | None:
        """Return status and text of a refusal; without the token nothing is said of what there is."""
        if self.headers.get("Host", "").lower() not in self._site.hosts:
            return HTTPStatus.FORBIDDEN, "not the address that this page was opened at"
        offered = self.headers.get("Authorization", "").removeprefix("Bearer ")
        if path == "/" and not offered:  # a browser's first request has nothing but its address
            offered = parse_qs(query).get("token", [""])[0]
        if not hmac.compare_digest(offered.encode(errors="replace"), self._site.token.encode()):
            return HTTPStatus.UNAUTHORIZED, "the token of this run is needed; leactl run --web prints it"
        if path not in self.METHODS:
            return HTTPStatus.NOT_FOUND, "no such page"
        if self.command != self.METHODS[path]:
            return HTTPStatus.METHOD_NOT_ALLOWED, f"{self.METHODS[path]} is expected"
        if self.headers.get("Content-Length", "0") != "0" or "Transfer-Encoding" in self.headers:
            return HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "a request without a body is expected"
        return None

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer what is no HTTP by a status alone: the library's text would hold parts of the request."""
        self._send(HTTPStatus(code), HTTPStatus(code).phrase)

    def _send(self, status: HTTPStatus, text: str, kind: str = "text/plain") -> None:
        body = text.encode(errors="replace")
        self.send_response_only(status)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        if status is HTTPStatus.UNAUTHORIZED:
            self.send_header("WWW-Authenticate", "Bearer")
        if status is HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", self.METHODS[self.path.partition("?")[0]])
        self.end_headers()
        self.wfile.write(body)


def answer(request: bytes, site: Site) -> bytes:
    """Return the answer to the head of a request."""
    if len(request) > MOST_BYTES:
        return b"HTTP/1.1 431 Request Header Fields Too Large\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    return HttpExchange(request, site).answer


async def serve(listener: socket.socket, site: Site) -> None:
    """Accept connections, so many a second, and answer one request on each."""
    loop = asyncio.get_running_loop()
    open_: dict[asyncio.Task[None], None] = {}  # the oldest first
    while True:
        with suppress(OSError):  # of a client that has gone again
            connection, _ = await loop.sock_accept(listener)
            if len(open_) >= MOST_OPEN:
                next(iter(open_)).cancel()
            task = loop.create_task(_converse(connection, site))
            open_[task] = None
            task.add_done_callback(lambda done: open_.pop(done, None))
        await asyncio.sleep(1.0 / MOST_A_SECOND)


async def _converse(connection: socket.socket, site: Site) -> None:
    loop, request = asyncio.get_running_loop(), b""
    connection.setblocking(False)
    with connection, suppress(OSError):  # one that leaves or takes too long is nobody's loss
        async with asyncio.timeout(DEADLINE_S):
            while b"\r\n\r\n" not in request and len(request) <= MOST_BYTES:
                if request:
                    await asyncio.sleep(PART_PAUSE_S)
                part = await loop.sock_recv(connection, MOST_BYTES)
                if not part:
                    return
                request += part
            await loop.sock_sendall(connection, answer(request, site))
            connection.shutdown(socket.SHUT_WR)
            for _ in range(MOST_PARTS_AFTER):  # what is closed with bytes unread takes the answer away from its reader
                if not await loop.sock_recv(connection, MOST_BYTES):
                    return


async def _follow_the_run(feed: asyncio.StreamReader, site: Site) -> None:
    """Take what the run shows until it shows no more, and let open pages ask for the end."""
    while line := await feed.readline():
        site.shown.take(json.loads(line))
    if site.shown.ended is None:
        site.shown.take({"ended": {"status": "unknown", "reason": NO_WORD, "run": ""}})
    if time.monotonic() - site.asked_at < WATCHED_S:
        await asyncio.sleep(LAST_LOOK_S)


async def _main(listener: socket.socket) -> None:
    feed = asyncio.StreamReader(limit=MOST_LINE)
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
