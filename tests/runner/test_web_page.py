"""A run's page on the wire: who is let in, what is told, how STOP reaches the run, and that no client harms the run."""

import http.client
import itertools
import json
import os
import signal
import socket
import threading
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest

from leactl.errors import InputError, Stopped
from leactl.quantities import ChannelSpec
from leactl.report.web import STOP, feed
from leactl.report.web.feed import STOP_CAUSE, RunPage
from leactl.report.web.server import (
    MOST_CONNECTIONS,
    MOST_REQUEST_BYTES,
    MOST_ROWS,
    HttpExchange,
    PageState,
    Site,
    answer,
)
from leactl.runfile.read.reader import Run
from leactl.runner.progress import Progress

SCRIPT = "</script><script>document.body.remove()</script>"
CHANNELS = (
    ChannelSpec("iq_ref", "q_axis_current_reference", "test", "drive"),
    ChannelSpec("iq", "q_axis_current", "test", "drive"),
    ChannelSpec(f"enabled{SCRIPT}", "drive_enabled", "test", "drive"),
)
PATIENCE_S = 60
MOST_LOOKS = 2000  # for a state, 40 a second


class Client:
    """What a page does with its address."""

    def __init__(self, url):
        self.address = urlsplit(url)
        self.token = parse_qs(self.address.query)["token"][0]

    def ask(self, path="/state", method="GET", token=None, host=None, headers=(), body=None):
        """Status, headers and text of an answer; with the token unless another is given."""
        connection = http.client.HTTPConnection(self.address.hostname, self.address.port, timeout=PATIENCE_S)
        token = self.token if token is None else token
        given = {"Authorization": f"Bearer {token}"} if token else {}
        given |= {} if host is None else {"Host": host}
        try:
            connection.request(method, path, body, given | dict(headers))
            answer = connection.getresponse()
            return answer.status, answer.headers, answer.read().decode()
        finally:
            connection.close()

    def state(self, since=0):
        return json.loads(self.ask(f"/state?since={since}")[2])

    def until(self, over):
        """The state once it is so."""
        return next(filter(over, map(self.state, itertools.repeat(0, MOST_LOOKS))))

    def connect(self):
        return socket.create_connection((self.address.hostname, self.address.port), timeout=PATIENCE_S)


@pytest.fixture(scope="module")
def progress():
    progress = Progress(f"spin{SCRIPT}", 10.0, {"loop": CHANNELS}, step=f"hold{SCRIPT}")
    progress.values, progress.time_s, progress.done_s = [float("nan"), 1.5, 1.0], 2.0, 5.0
    progress.windings, progress.winding_limit = ({"test": 40.0}, {"test": 60.0}), 130.0
    progress.time_left = lambda: {"test": 12.0}
    progress.warnings = [f"warm{SCRIPT}"]
    return progress


@pytest.fixture(scope="module")
def page(progress):
    with RunPage("127.0.0.1:0", f"bench{SCRIPT}") as page:
        page.show(progress)
        yield page


@pytest.fixture(scope="module")
def client(page):
    return Client(page.url)


# -- who is let in ---------------------------------------------------------------------------------------------------


def test_the_address_that_is_printed_opens_the_page(client):
    status, headers, text = client.ask(f"/?{client.address.query}", token="")
    assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    assert headers["Cache-Control"] == "no-store"
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert "default-src 'none'" in text
    assert SCRIPT not in text
    assert client.token not in text


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({"token": "x" * 32}, 401),
        ({"token": "\u00e4"}, 401),
        ({"path": "/", "token": ""}, 401),
        ({"path": "/?token=", "token": ""}, 401),
        ({"path": "/?token=%FF", "token": ""}, 401),
        ({"path": "/nothing", "token": ""}, 401),
        ({"path": "/stop", "method": "POST", "token": ""}, 401),
        ({"method": "OPTIONS", "token": ""}, 401),
        ({"host": "evil.example"}, 403),
        ({"host": "127.0.0.1"}, 403),
        ({"host": ""}, 403),
        ({"path": "/nothing"}, 404),
        ({"path": "/../etc/passwd"}, 404),
        ({"path": "/stop"}, 405),
        ({"path": "/state", "method": "POST"}, 405),
        ({"method": "HEAD"}, 405),
        ({"path": "/stop", "method": "POST", "body": b"x"}, 413),
        ({"path": "/stop", "method": "POST", "headers": {"Transfer-Encoding": "chunked"}}, 413),
        ({"headers": {"X-Long": "x" * MOST_REQUEST_BYTES}}, 431),
    ],
)
def test_others_are_refused_and_nothing_is_stopped(page, client, changes, status):
    answered, _, text = client.ask(**changes)
    assert answered == status
    assert "title" not in text
    assert page.stop_cause() == ""


def test_a_token_in_the_address_alone_stops_and_tells_nothing(page, client):
    for path, method in (("/stop", "POST"), ("/state", "GET")):
        assert client.ask(f"{path}?{client.address.query}", method, token="")[0] == 401
    assert page.stop_cause() == ""


@pytest.mark.parametrize(
    "request_",
    [
        b"\0\xff" * 40 + b"\r\n\r\n",
        b"GET\r\n\r\n",
        b"\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET /\r\n\r\n",
        b"a" * 999999,
    ],
    ids=["bytes", "no path", "nothing", "version", "HTTP 0.9", "endless"],
)
def test_what_is_no_request_is_not_told_back(request_):
    said = answer(request_, Site("the page itself", "token", ["host"]))
    assert b"itself" not in said
    assert b"\xff" not in said
    assert said == b"" or said.split()[1][:1] in (b"4", b"5")


def test_localhost_is_another_name_of_this_machine(client):
    assert client.ask(host=f"LocalHost:{client.address.port}")[0] == 200


# -- what is told ----------------------------------------------------------------------------------------------------


def test_the_state_has_what_the_loop_has_published(client, progress):
    state = client.until(lambda state: state["rows"])
    assert (state["title"], state["step"], state["warnings"]) == (progress.title, progress.step, progress.warnings)
    assert (state["share"], state["done_s"], state["total_s"]) == (0.5, 5.0, 10.0)
    assert state["rows"][0] == [2.0, None, 1.5, 1.0]
    assert state["windings"] == [
        {"role": "test", "estimate_degC": 40.0, "bound_degC": 60.0, "limit_degC": 130.0, "to_limit_s": 12.0}
    ]
    assert [(channel["name"], channel["unit"], channel["chart"]) for channel in state["channels"]] == [
        ("iq_ref", "A", "q axis current, test"),
        ("iq", "A", "q axis current, test"),
        (f"enabled{SCRIPT}", "", "drive enabled, test"),
    ]


def test_a_page_is_given_each_row_once_and_the_last_minute_at_first(client, progress):
    known = client.until(lambda state: state["rows"])["next"]
    progress.time_s += 1.0
    later = client.until(lambda state: state["next"] > known)
    rows = client.state(known)
    assert [row[0] for row in rows["rows"]] == [progress.time_s]
    assert rows["channels"] is None
    assert client.state(later["next"])["rows"] == []
    shown = PageState()
    for number in range(MOST_ROWS + 5):
        shown.take({"row": [number]})
    assert [row[0] for row in shown.as_json(0)["rows"]] == list(range(5, MOST_ROWS + 5))
    assert shown.as_json(MOST_ROWS + 99)["rows"] == []


def test_silence_grows_from_the_newest_row_on(client):
    assert PageState().as_json(0)["silent_s"] == 0.0  # nothing has begun
    client.until(lambda state: state["rows"])
    first, second = (client.state()["silent_s"] for _ in range(2))
    assert 0.0 < first < second


def test_a_number_that_is_none_asks_for_all(page):
    site = Site("", "t", ["h"])
    site.state.take({"row": [1]})
    for since in ("x", "-1", "9" * 20, "%00", ""):
        request = f"GET /state?since={since} HTTP/1.1\r\nHost: h\r\nAuthorization: Bearer t\r\n\r\n"
        assert json.loads(HttpExchange(request.encode(), site).answer.split(b"\r\n\r\n")[1])["rows"] == [[1]]


def test_an_open_page_is_told_how_the_run_ended():
    with RunPage("[::1]:0", "bench") as page:
        client = Client(page.url)
        client.state()
        page.end("complete", "", "a.h5")
        assert client.until(lambda state: state["ended"])["ended"] == {
            "status": "complete",
            "reason": "",
            "run": "a.h5",
        }
    with pytest.raises(OSError):
        client.connect()
    assert page.fault == ""


def test_an_error_before_the_run_is_its_end_too():
    with suppress(OSError), RunPage("127.0.0.1:0", "bench") as page:
        Client(page.url).state()
        raise OSError("no bus\nof this kind")
    assert page._ended == {"status": "failed", "reason": "no bus", "run": ""}


# -- at the door -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("8080", "ADDRESS:PORT was expected"),
        ("127.0.0.1:65536", "ADDRESS:PORT was expected"),
        ("127.0.0.1:-1", "ADDRESS:PORT was expected"),
        ("lab-pc:80", "an IP address of this machine was expected"),
        ("0.0.0.0:0", "the one address at which the page is to be opened"),
        ("[::]:0", "the one address at which the page is to be opened"),
        ("192.0.2.7:0", "not an address of this machine"),
    ],
)
def test_an_address_that_is_none_is_refused(address, words):
    with pytest.raises(InputError, match=words), RunPage(address, "bench"):
        pass


# -- the run ---------------------------------------------------------------------------------------------------------


@contextmanager
def shown(page, progress, then):
    """The run on the page, and what a client does once it has begun."""
    page.show(progress)
    client = Client(page.url)
    client.until(lambda state: "title" in state)
    then(client)
    yield


def test_stop_ends_the_run_and_its_file_tells_the_cause(spin):
    with RunPage("127.0.0.1:0", "emulated") as page:
        outcome, _bench = spin(
            sets=("hold_s=600",),
            watch=lambda progress: shown(page, progress, lambda client: client.ask("/stop", "POST")),
            stops=[page.stop_cause],
        )
    assert (outcome.status, outcome.reason, type(outcome.error)) == ("stopped", STOP_CAUSE, Stopped)
    assert all(confirmation.safe for confirmation in outcome.safe.values())
    with Run.open(outcome.path) as run:
        assert (run.attributes["status"], run.attributes["status_reason"]) == ("stopped", STOP_CAUSE)


def sockets(process="self"):
    """Those that a process holds."""
    results = []
    for place in Path(f"/proc/{process}/fd").iterdir():
        with suppress(FileNotFoundError):
            results.append(str(place.readlink()))
    return [name for name in results if name.startswith("socket")]


def test_stop_is_heard_where_nothing_can_be_shown_any_more(spin, monkeypatch):
    sound, calls = feed.run_state, itertools.count()

    def breaking(progress, cause):
        if progress.title == "spin on emulated" and next(calls):  # and not that of another page
            raise ZeroDivisionError("no such luck")
        return sound(progress, cause)

    def stop(client):
        client.until(lambda _state: page.fault)
        client.ask("/stop", "POST")

    monkeypatch.setattr(feed, "run_state", breaking)
    with RunPage("127.0.0.1:0", "emulated") as page:
        outcome, _bench = spin(
            sets=("hold_s=600",), watch=lambda progress: shown(page, progress, stop), stops=[page.stop_cause]
        )
    assert (outcome.status, outcome.reason) == ("stopped", STOP_CAUSE)
    assert outcome.notes == ["the run's page is no longer fed: ZeroDivisionError: no such luck"]


def slow(client):
    """Requests that never end, answers that are never read, and lines without sense, from ever more connections."""
    held = []
    for number in range(3 * MOST_CONNECTIONS):
        connection = client.connect()
        held.append(connection)
        with suppress(OSError):
            connection.send((b"GET / HT", b"\0" * 4096, b"POST /stop HTTP/1.1\r\n\r\n")[number % 3])
    return held


def test_the_run_is_complete_beside_hostile_clients_and_the_page_still_answers(spin):
    held, ended = [], threading.Event()

    def attack(client):
        held.extend(slow(client))

        def flood():
            while not ended.is_set():
                with suppress(OSError), client.connect() as connection:
                    connection.send(b"x")

        held.append(threading.Thread(target=flood))
        held[-1].start()
        assert "title" in client.state()
        assert (
            len(sockets(page._server.pid)) <= MOST_CONNECTIONS + 4
        )  # its listener, a pair of its own, one that is answered

    with RunPage("127.0.0.1:0", "emulated") as page:
        outcome, _bench = spin(watch=lambda progress: shown(page, progress, attack), stops=[page.stop_cause])
        ended.set()
    held.pop().join()
    for connection in held:
        connection.close()
    assert (outcome.status, outcome.overruns, outcome.notes) == ("complete", 0, [])
    with Run.open(outcome.path) as run:
        assert [event.message for event in run.events if event.level != "info"] == []


def test_the_process_of_the_run_holds_no_connection_to_a_client(spin):
    before, seen = sockets(), []

    def look(client):
        with client.connect():
            seen.extend(sockets())

    with RunPage("127.0.0.1:0", "emulated") as page:
        outcome, _bench = spin(watch=lambda progress: shown(page, progress, look))
    assert outcome.status == "complete"
    assert len(seen) == len(before) + 1  # the client's own end


def test_a_server_that_is_killed_is_noted_in_the_file_and_no_more(spin):
    with RunPage("127.0.0.1:0", "emulated") as page:

        def kill(_client):
            page._server.kill()
            page._thread.join()

        outcome, _bench = spin(watch=lambda progress: shown(page, progress, kill), stops=[page.stop_cause])
    fault = "the run's page is no longer fed: its server has ended"
    assert (outcome.status, outcome.overruns, outcome.notes) == ("complete", 0, [fault])
    with Run.open(outcome.path) as run:
        assert [event.message for event in run.events if event.source == "view"] == [fault]


def test_a_full_pipe_costs_lines_and_nothing_waits_or_grows(spin, monkeypatch):
    monkeypatch.setattr(feed, "LINES_A_SECOND", 1000)
    monkeypatch.setattr(feed, "PATIENCE_S", 0.2)

    def fill(_client):
        os.kill(page._server.pid, signal.SIGSTOP)
        with suppress(BlockingIOError):
            while True:
                os.write(page._server_input, b" " * 65536)

    with RunPage("127.0.0.1:0", "emulated") as page:
        outcome, _bench = spin(watch=lambda progress: shown(page, progress, fill), stops=[page.stop_cause])
    assert (outcome.status, outcome.overruns) == ("complete", 0)
    assert page._unsent.count(b"\n") <= 4  # a part of one, and the last two
    assert page.fault == "the run's page is not told how the run ended: its server takes nothing"


def test_stop_is_one_byte_however_often_it_is_pressed(monkeypatch):
    taken = []
    monkeypatch.setattr(os, "write", lambda _descriptor, data: taken.append(data))
    Site("", "t", ["h"]).stop()
    assert taken == [STOP]
