"""`leactl bench scan` as a person runs it, at emulated devices that another process serves."""

import json
import signal
import subprocess

import pytest
import yaml

from leactl.bench import benchfile
from leactl.bench.benchfile import SerialBus
from leactl.emulation.wires.pseudo_terminal import PseudoTerminal
from leactl.runner import locks
from tests.cli.answers import fits_the_page
from tests.cli.terminal import COMMAND, leactl, start

SUPPLY = {
    "driver": "scpi_supply",
    "bus": "lan0",
    "role": "bench",
    "settings": {
        "dialect": "dp800",
        "model": "DP832A",
        "serial_number": "DP8A0001",
        "output": 2,
        "feeds": "bus",
        "voltage_limit_V": 30.0,
        "current_limit_A": 3.0,
    },
}


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Where two drives, a supply on a serial line and another one on a socket are served: by bus, what `scan` takes."""
    folder = tmp_path_factory.mktemp("served")
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    heated = yaml.safe_load((benchfile.SHIPPED / "emulated-heated.yaml").read_text())
    bench["buses"] |= heated["buses"]
    bench["buses"]["lan0"] = {"kind": "visa", "resource": "TCPIP::127.0.0.1::5025::SOCKET"}
    bench["buses"]["can0"]["interface"] = "pty"
    bench["devices"] |= {"supply": heated["devices"]["supply"], "dc_supply": SUPPLY}
    (folder / "bench.yaml").write_text(yaml.safe_dump(bench))
    process = start("bench", "serve", str(folder / "bench.yaml"), "--setup", "free")
    places = {}
    while (line := process.stdout.readline()) != "serving; Ctrl-C ends it\n":
        assert line, process.communicate()
        name, _, place = line.strip().partition(": ")
        places[name] = place.split()[-1]
    _, host, port, _ = places["lan0"].split("::")
    yield {
        "can0": ("--can", f"slcan:{places['can0']}"),
        "supply0": ("--serial", places["supply0"]),
        "lan0": ("--lan", f"{host}:{port}"),
    }
    process.kill()
    process.communicate()


@pytest.fixture(scope="module")
def answer(served):
    for _ in range(4):  # other load on the machine may hold up the far ends
        done = leactl("bench", "scan", *(word for words in served.values() for word in words), "--json")
        assert done.returncode == 0, done.stderr
        assert "listens for 1.2 s ..." in done.stderr
        document = json.loads(done.stdout)
        if len(document["devices"]) == 4:
            break
    return document


def test_every_device_is_told_with_its_driver(answer):
    devices = [(each["driver"], each["address"], each["serial"]) for each in answer["devices"]]
    assert devices == [
        ("elmo_can", 1, "1"),
        ("elmo_can", 2, "2"),
        ("bk1688b", None, ""),
        ("scpi_supply", None, "DP8A0001"),
    ]
    assert [wire["fault"] for wire in answer["wires"]] == [None, None, None]
    fits_the_page("A scan of wires", answer)


def test_its_part_of_a_bench_file_is_taken_once_it_is_filled_in(answer, tmp_path):
    part = answer["bench_file"]
    shipped = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    head = yaml.safe_dump({"name": "mine", "motors": shipped["motors"], "limits": shipped["limits"]})
    file = tmp_path / "mine.yaml"
    file.write_text(head + part)
    unfilled = leactl("bench", "check", file)
    assert unfilled.returncode == 2
    assert "output: FILL_IN  # integer, at least 1, at most 9; leactl driver info scpi_supply" in part
    assert unfilled.stderr.count("FILL_IN") + unfilled.stderr.count("role") > 0
    known = {
        "counts_per_turn": 40000,
        "voltage_limit_V": 8.0,
        "current_limit_A": 5.0,
        "model": "1688B",
        "output": 2,
    }
    for key, value in known.items():
        part = part.replace(f"{key}: FILL_IN", f"{key}: {value}")
    for role in ("test", "load", "bench", "test"):
        part = part.replace("role: FILL_IN", f"role: {role}", 1)
    for fed in ("bus", "leads"):
        part = part.replace("feeds: FILL_IN", f"feeds: {fed}", 1)
    assert "FILL_IN" not in part.partition("\n")[2]
    file.write_text(head + part)
    filled = leactl("bench", "check", file)
    assert filled.returncode == 0, filled.stderr


def test_yaml_has_stdout_to_itself_and_the_lines_go_to_stderr(served):
    done = leactl("bench", "scan", *served["supply0"], "--yaml")
    assert done.returncode == 0
    assert yaml.safe_load(done.stdout)["devices"]["bk1688b"]["settings"]["model"] == "1688B"
    assert "BK Precision 1688B" in done.stderr


def test_a_wire_that_a_run_uses_is_refused_and_the_others_are_asked(served):
    bus = SerialBus(kind="serial", port=served["supply0"][1])
    with locks.bus_held(bus):
        done = leactl("bench", "scan", *served["supply0"], *served["lan0"])
    assert done.returncode == 5
    assert f"{bus.port} is driven by a run, process " in done.stderr
    assert "DP832A" in done.stdout


def test_what_was_seen_is_told_where_a_person_stops_it(served):
    silent = PseudoTerminal()
    words = ["bench", "scan", *served["supply0"], "--serial", silent.path]
    process = subprocess.Popen([*COMMAND, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while f"{silent.path}: asks" not in process.stderr.readline():
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    silent.close()
    assert process.returncode == 4
    assert "BK Precision 1688B" in out
    assert out.splitlines()[-1] == f"{silent.path}: the scan was stopped before its end"
    assert err.splitlines()[-1] == "leactl: stopped by SIGINT"


@pytest.mark.parametrize(
    ("words", "mend"),
    [
        (
            ("--can", "can97"),
            "can97: there is no such CAN interface; connect its adapter, then: sudo ip link set",
        ),
        (("--i2c", "97"), "no such bus; load i2c-dev"),
        (("--serial", "/dev/ttyUSB97"), "/dev/ttyUSB97: no such device"),
        (("--lan", "127.0.0.1:9"), "127.0.0.1 port 9: the connection is refused"),
    ],
)
def test_a_wire_that_is_not_there_is_a_line_with_what_mends_it(words, mend):
    done = leactl("bench", "scan", *words)
    assert (done.returncode, done.stdout) == (5, "")
    assert mend in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--lan", "bench.local"), "'bench.local' is not an IPv4 address"),
        (("--lan", "10.0.0.1:70000"), "port 70000; 1 to 65535 was expected"),
        (("--can", "sockettcan:can0"), "socketcan was expected"),
        (("--can", "slcan:"), "can0 was expected"),
        (("--i2c", "999"), "equal to 255, found '999'"),
        (("--json", "--yaml"), "one was expected"),
    ],
)
def test_a_word_that_names_no_wire_is_bad_input(words, expected):
    done = leactl("bench", "scan", *words)
    assert done.returncode == 2
    assert expected in done.stderr
