"""`leactl bench reset` and `leactl bench serve` as a shell sees them."""

import json
import shlex
import signal
import subprocess
from pathlib import Path

import pytest

from leactl.bench.benchfile import SHIPPED
from leactl.runner.latch import Latch
from leactl.runner.state_folder import state_directory
from tests.cli.terminal import COMMAND, leactl
from tests.latches import latch_of, trip_of
from tests.runner.conftest import SPIN


@pytest.fixture(autouse=True)
def own_state(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))


@pytest.fixture
def tripped(tmp_path):
    cause = "test current of 31.2 A passed the limit of 30 A"
    latch_of("emulated").set(cause, tmp_path / "runs" / "a.h5")


@pytest.mark.parametrize("answer", ["n\n", "\n", ""])
def test_reset_states_the_cause_and_releases_nothing_unconfirmed(tripped, answer):
    done = leactl("bench", "reset", "emulated", input=answer)
    assert (done.returncode, done.stdout) == (4, "")
    assert "test current of 31.2 A passed the limit of 30 A (run " in done.stderr
    assert "leactl: not confirmed; 'emulated' stays tripped" in done.stderr
    assert trip_of("emulated")


def test_reset_releases_once_confirmed(tripped):
    done = leactl("bench", "reset", "emulated", input="y\n")
    assert (done.returncode, done.stdout) == (0, "emulated: released\n")
    assert not trip_of("emulated")


def test_reset_answers_in_json_and_tells_what_it_released(tripped):
    answer = json.loads(leactl("bench", "reset", "emulated", "--yes", "--json").stdout)
    assert answer["released"]["cause"] == "test current of 31.2 A passed the limit of 30 A"
    again = leactl("bench", "reset", "emulated", "--json")
    assert (again.returncode, json.loads(again.stdout)) == (0, {"bench": "emulated", "tripped": False})


LOST = {"bench": "emulated", "file": "emulated.yaml", "protocol": "heat", "process": 1, "real": True, "run": "r.h5"}


def lose_a_run():
    """Leave what a run on real buses leaves whose process and watchdog were killed."""
    runs = state_directory() / "runs"
    runs.mkdir(parents=True, exist_ok=True)
    (runs / "emulated.1.0.run").write_bytes(b"--" + json.dumps(LOST).encode() + b"\n")


@pytest.mark.parametrize("word", ["emulated", str(SHIPPED / "emulated.yaml")])
def test_reset_of_a_rehearsal_tells_of_a_lost_run_of_its_name_before_it_asks(tripped, word):
    lose_a_run()
    refused = leactl("bench", "reset", word, input="n\n")
    assert refused.returncode == 4
    lost = "process 1 of the run heat ended without a word, and its watchdog too (run r.h5)"
    assert "test current of 31.2 A passed" in refused.stderr
    assert lost in refused.stderr
    again = leactl("bench", "reset", word, "--yes", "--json")
    causes = [released["cause"] for released in json.loads(again.stdout)["all_released"]]
    assert sorted(causes) == [lost.removesuffix(" (run r.h5)"), "test current of 31.2 A passed the limit of 30 A"]
    assert leactl("bench", "reset", word).stdout == "emulated: not tripped\n"


def test_a_latch_that_the_watchdog_of_the_lost_run_has_set_stays_as_it_is():
    latch = Latch("emulated", "emulated", (str(state_directory() / "emulated.trip.json"),))
    latch.set("process 1 of the run ended without making the bench safe", Path("r.h5"))
    before = latch.trip()
    lose_a_run()
    output = leactl("bench", "reset", "emulated", input="n\n").stderr
    assert "and its watchdog too" not in output
    assert latch.trip() == before


def test_a_latch_that_is_there_gets_the_lost_run_beside_its_cause():
    place = state_directory()
    Latch("emulated", "emulated", (str(place / "emulated.trip.json"),)).set("test winding of 131 degC", Path("a.h5"))
    lose_a_run()
    output = leactl("bench", "reset", "emulated", input="n\n").stderr
    assert "test winding of 131 degC; process 1 of the run heat ended without a word" in output


def test_reset_of_a_damaged_latch_says_so_and_asks_too(tmp_path):
    (tmp_path / "state").mkdir()
    Path(latch_of("emulated").paths[0]).write_text("{")
    done = leactl("bench", "reset", "emulated", input="n\n")
    assert done.returncode == 4
    assert "cannot be read" in done.stderr
    assert leactl("bench", "reset", "emulated", "--yes").returncode == 0


TRIPPING = ("run", "spin.yaml", "--set", "current_A=2.5", "--set", "hold_s=2", "--bench")


def test_the_command_that_a_trip_tells_releases_the_bench_and_holds_no_other_of_its_name(tmp_path):
    (tmp_path / "spin.yaml").write_text(SPIN)
    (tmp_path / "a bench").mkdir()
    mine, other = "a bench/mine.yaml", "other.yaml"
    for name in (mine, other):
        (tmp_path / name).write_text((SHIPPED / "emulated.yaml").read_text().replace("name: emulated", "name: mybench"))
    assert leactl(*TRIPPING, mine).stderr.startswith("leactl: test velocity of ")
    (tmp_path / "link.yaml").symlink_to(tmp_path / mine)
    for again in (mine, "link.yaml"):
        refused = leactl("run", "spin.yaml", "--bench", again)
        assert (refused.returncode, refused.stdout) == (3, "")
    assert leactl("run", "spin.yaml", "--bench", other).returncode == 0
    told = shlex.split(refused.stderr.partition("; see: ")[2])
    assert told[:3] == ["leactl", "bench", "reset"]
    done = leactl(*told[1:], "--yes")
    assert (done.returncode, done.stdout) == (0, "mybench: released\n")
    assert leactl("run", "spin.yaml", "--bench", mine).returncode == 0


def test_reset_by_name_releases_a_bench_whose_file_has_gone(tmp_path):
    (tmp_path / "spin.yaml").write_text(SPIN)
    mine = tmp_path / "mine.yaml"
    mine.write_text((SHIPPED / "emulated.yaml").read_text().replace("name: emulated", "name: mybench"))
    assert leactl(*TRIPPING, mine).returncode == 3
    mine.rename(tmp_path / "moved.yaml")
    done = leactl("bench", "reset", "mybench", "--yes")
    assert (done.returncode, done.stdout) == (0, "mybench: released\n")
    assert leactl("bench", "reset", "mybench").returncode == 2


def test_reset_of_an_unknown_bench_is_status_2():
    done = leactl("bench", "reset", "no-such")
    assert done.returncode == 2
    assert (
        done.stderr
        == "leactl: bench 'no-such' is not known; known: emulated, emulated-heated, testbed, or a path to a .yaml\n"
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_serve_says_where_and_ends_in_order_by_a_signal(number):
    process = subprocess.Popen(
        [*COMMAND, "bench", "serve", "emulated", "--bus", "can0=pty"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline().startswith("can0: slcan on /dev/pts/")
    assert process.stdout.readline() == "serving; Ctrl-C ends it\n"
    process.send_signal(number)
    out, err = process.communicate(timeout=20)
    assert (process.returncode, out) == (0, "")
    assert err == "i2c1: is not served; I2C needs the kernel's i2c-stub at that number\n"


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        ([], 2, "interface 'emulated' ends with this process; put it elsewhere, as with --bus can0="),
        (["--bus", "can1=pty"], 2, "--bus can1=pty: NAME=INTERFACE:CHANNEL was expected, with a CAN bus"),
        (["--bus", "can0=pty", "--condition", "icy"], 2, "condition 'icy'"),
        (["--bus", "can0=udp_multicast:10.0.0.1"], 5, "bus 'can0': "),
    ],
)
def test_serve_refuses_in_one_line(arguments, status, words):
    done = leactl("bench", "serve", "emulated", *arguments)
    assert (done.returncode, done.stdout) == (status, "")
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1
