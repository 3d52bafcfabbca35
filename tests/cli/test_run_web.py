"""`leactl run --web` as a shell and a browser see it: refused at the door, shown while it goes, stopped by its STOP."""

import json
import re
import socket
import subprocess
from pathlib import Path

import h5py
import pytest

from leactl.quantities import ChannelSpec
from leactl.report.web.feed import STOP_CAUSE, RunPage
from leactl.runner.progress import Progress
from tests.cli.terminal import COMMAND, leactl
from tests.report.browser import needs_chromium
from tests.report.devtools import tab
from tests.runner.conftest import SPIN

SCRIPT = "\"'></script><script>harmed = 1</script><svg onload=harmed=1><b>&lt;"
SPINNING = ("run", "spin.yaml", "--web", "--json")


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    (tmp_path / "spin.yaml").write_text(SPIN)
    return tmp_path


def test_a_taken_port_and_a_strange_address_are_refused_before_the_bench_is_touched(here):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        done = leactl("run", "spin.yaml", "--web", address, "--events", "events.jsonl")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"leactl: --web {address}: another program has this port; 0 takes a free one\n"
    assert leactl("run").stderr == "leactl: missing argument 'protocol'; leactl run --help tells the usage\n"
    for words in (
        ("--web", "8080"),
        ("--web", "192.0.2.7"),
        ("--web", ":80"),
        ("--web=lab-pc:80",),
        ("--web", "localhost:80"),
        ("--web=", "--dry-run"),
    ):
        done = leactl("run", "spin.yaml", *words, "--json")
        assert done.returncode == 2
        assert json.loads(done.stdout)["faults"][0]["message"].startswith("--web ")
        assert len(done.stderr.splitlines()) == 1
    assert sorted(path.name for path in here.iterdir()) == ["spin.yaml"]


def test_web_stands_alone_before_a_protocol_and_nobody_needs_to_look(here):
    done = leactl("run", "--web", "spin.yaml", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["status"] == "complete"
    assert re.match(r"leactl: the run's page: http://127\.0\.0\.1:\d+/\?token=[\w-]{32}\n", done.stderr)
    (path,) = (here / "runs").glob("*.h5")
    assert "token=" not in str(list(h5py.File(path).attrs.items()))


def look_at_scripts(tab):
    """A run whose every text is a script: the page shows them and runs none."""
    channel = ChannelSpec(SCRIPT, "torque", SCRIPT, "sensor", units=SCRIPT)
    progress = Progress(SCRIPT, 1.0, {"loop": [channel]}, [1.0], step=SCRIPT, prompt=SCRIPT, warnings=[SCRIPT])
    progress.windings = ({SCRIPT: 20.0}, {SCRIPT: 20.0})
    with RunPage("127.0.0.1:0", SCRIPT) as page:
        page.show(progress)
        tab.call("Page.navigate", url=page.url)
        tab.until("document.getElementById('values') && document.getElementById('values').rows.length")
        page.end(SCRIPT, SCRIPT, SCRIPT)
        tab.until("document.getElementById('stop').textContent === 'ENDED'")
    assert tab.look("document.scripts.length") == 1
    assert tab.look("document.querySelectorAll('svg[onload], b').length") == 0
    assert tab.look("document.body.textContent").count(SCRIPT) >= 9
    assert tab.look("globalThis.harmed === undefined")
    assert tab.console == []


def lose_the_connection(tab):
    with RunPage("127.0.0.1:0", "mine") as page:
        page.show(Progress("spin", 1.0, {}))
        tab.call("Page.navigate", url=page.url)
        tab.until("document.getElementById('state') && document.getElementById('state').textContent === 'live'")
        page._server.kill()
        tab.until("document.getElementById('state').textContent === 'not connected'")
        notice = tab.look("document.getElementById('notice').textContent")
        assert notice.startswith("Connection lost: the run goes on.")
        assert "leactl bench stop mine" in notice
        assert tab.look("document.getElementById('title').textContent") == "spin"
        tab.press("Tab", 9)
        tab.press("Enter", 13)
        tab.until("document.getElementById('notice').textContent.includes('STOP did not reach the run')")


@needs_chromium
def test_a_browser_shows_the_run_and_its_stop_ends_it(here):
    run = subprocess.Popen(
        [*COMMAND, *SPINNING, "--set", "hold_s=3600"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        url = re.search(r"http\S+", run.stderr.readline())[0]
        with tab(here) as page:
            page.call("Page.navigate", url=url)
            page.until("document.querySelectorAll('#charts figure:not([hidden]) path.reading[d]').length >= 3")
            for width in (400, 1400):
                page.show_at(width, 900, "light" if width == 400 else "dark")
                seen = page.look("document.getElementById('values').textContent")
                page.until(f"document.getElementById('values').textContent !== {json.dumps(seen)}")
                assert page.look("document.documentElement.scrollWidth") <= width
                page.picture(Path(f"page-{width}.png"))
            assert page.look("document.getElementById('step').textContent") == "hold"
            assert page.look("document.getElementById('windings').rows.length") == 2
            assert page.look("document.getElementById('state').textContent") == "live"
            page.press("Tab", 9)
            assert page.look("document.activeElement.id") == "stop"
            page.press("Enter", 13)
            page.until("document.getElementById('stop').textContent === 'ENDED'")
            out, errors = run.communicate()
            assert page.look("document.getElementById('notice').textContent") == STOP_CAUSE
            assert json.loads(out)["run"] in page.look("document.getElementById('state').textContent")
            assert page.look("document.getElementById('values').rows.length") > 10
            page.picture(Path("page-ended.png"))
            assert page.console == []
            look_at_scripts(page)
            lose_the_connection(page)
    finally:
        run.kill()
        run.communicate()
    answer = json.loads(out)
    assert (run.returncode, answer["status"], answer["reason"]) == (4, "stopped", STOP_CAUSE)
    assert f"leactl: {STOP_CAUSE}\n" in errors
    assert all(device["confirmed"] for device in answer["safe"].values())
    with h5py.File(answer["run"]) as file:
        assert file.attrs["status_reason"] == STOP_CAUSE
