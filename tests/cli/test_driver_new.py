"""`leactl driver new`, by its guide: a package whose driver passes once two functions are filled in."""

import importlib
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from leactl.driver import conformance, scaffold
from leactl.quantities import UNITS
from tests.cli.terminal import leactl

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs" / "how-to" / "own-driver.md").read_text(encoding="utf-8")
LINES, BINARY = GUIDE.split("## Binary protocols over serial\n")
EMPTY = re.compile(r"^def \w+_of\(.*?(?=^class )", re.MULTILINE | re.DOTALL)  # the one function that is to be filled in
FUNCTIONS = {
    "serial": dict(
        zip(("driver.py", "emulator.py"), re.findall(r"```python\n(def .*?)```", LINES, re.DOTALL), strict=True)
    ),
    "i2c": {
        "driver.py": "def value_of(register):\n    return ((register ^ 0x8000) - 0x8000) * 0.0078125\n",
        "emulator.py": "def register_of(value):\n    return round(value / 0.0078125) & 0xFFFF\n",
    },
}


def installed(package):
    """A folder for sys.path as pip leaves it."""
    project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    information = package / f"{project['name'].replace('-', '_')}-0.1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 0.1\n")
    [(name, place)] = project["entry-points"]["leactl.drivers"].items()
    (information / "entry_points.txt").write_text(f"[leactl.drivers]\n{name} = {place}\n")
    return package


def said(package, folder, *words):
    """What a program of the environment with the package says."""
    path = os.pathsep.join([str(package), str(ROOT), os.environ.get("PYTHONPATH", "")])
    surroundings = os.environ | {"PYTHONPATH": path, "LEACTL_STATE": str(folder / "state")}
    command = [sys.executable, "-m", *map(str, words)]
    return subprocess.run(command, env=surroundings, cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture(params=scaffold.BUSES)
def package(request, tmp_path):
    folder = scaffold.write_package("room_meter", request.param, "ambient_temperature", tmp_path)
    return request.param, installed(folder)


QUESTION = re.search(r"```python\n(QUESTION = .*?)```", LINES, re.DOTALL)[1]
ASKED = re.compile(r"^QUESTION = .*\nLINE_END = .*\n", re.MULTILINE)


def fill_in(bus, package):
    for name, function in FUNCTIONS[bus].items():
        path = package / "leactl_room_meter" / name
        text, count = EMPTY.subn(lambda _: function + "\n\n", path.read_text())  # noqa: B023 (called at once)
        assert count == 1
        if bus == "serial" and name == "driver.py":
            text, count = ASKED.subn(lambda _: QUESTION, text)
            assert count == 1
        path.write_text(text)


def make_binary(package):
    """Change the package for a serial line as the guide says for Modbus RTU."""
    question, answer, receive = re.findall(r"```python\n(.*?)```", BINARY.split("\n## ")[0], re.DOTALL)
    imports = re.findall(r"`(from leactl.*?)`", BINARY)
    path = package / "leactl_room_meter" / "driver.py"
    asked = re.compile(r"^QUESTION = .*?(?=^class )", re.MULTILINE | re.DOTALL)
    text, count = asked.subn(lambda _: f"{question}\n\n", path.read_text())
    text = text.replace("from leactl.driver.serial_port import SerialPort", imports[0])
    for old, new in re.findall(r"^\| `(.*)` \| `(.*)` \|$", BINARY, re.MULTILINE):
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    path = package / "leactl_room_meter" / "emulator.py"
    text, filled = EMPTY.subn(lambda _: f"{answer}\n\n", path.read_text())
    text, received = re.subn(r"^    def receive.*?(?=^    def )", lambda _: f"{receive}\n", text, flags=re.M | re.S)
    path.write_text(text.replace("Callable\n", f"Callable\n\n{imports[1]}\n", 1))
    assert (count, filled, received) == (1, 1, 1)


def put_on_bench(folder, bus=None):
    """The emulated bench with the lines of the guide, as mine.yaml."""
    line, device = re.findall(r"```yaml\n(.*?)```", GUIDE, re.DOTALL)
    bench = leactl("bench", "show", "emulated").stdout
    bench = bench.replace("buses:\n", f"buses:\n{bus or line}", 1).replace("devices:\n", f"devices:\n{device}", 1)
    (folder / "mine.yaml").write_text(bench)


def test_what_is_not_filled_in_is_named(package, tmp_path):
    bus, folder = package
    done = said(folder, tmp_path, "leactl", "driver", "check", "room_meter")
    assert done.returncode == 2
    function = "answer_of" if bus == "serial" else "register_of"
    assert f"{function} in emulator.py is to be filled in" in done.stderr


def test_it_passes_its_check_and_its_tests_once_two_functions_are_filled_in(package, tmp_path):
    bus, folder = package
    fill_in(bus, folder)
    done = said(folder, tmp_path, "leactl", "driver", "check", "room_meter")
    assert done.stdout.startswith("room_meter: keeps the driver contract, in 7 trials"), done.stderr
    done = said(folder, folder, "pytest", "-q", "-p", "no:cacheprovider")
    assert done.returncode == 0, done.stdout


PACE = """
from types import SimpleNamespace

from leactl_room_meter.driver import RoomMeter, RoomMeterSettings

CYCLE_S, PERIOD_S = 0.03, 0.05
clock = SimpleNamespace(time=0.0)
clock.now = lambda: clock.time
port = SimpleNamespace(write=lambda data: None, discard=lambda: None, take_line=lambda: b"+23.412", read=lambda *_: 0)
meter = RoomMeter("room", "test", RoomMeterSettings(period_s=PERIOD_S), port, clock)
times = []
for cycle in range(1000):
    clock.time = cycle * CYCLE_S
    if 500 <= cycle < 600:  # a pause of three seconds: what was missed is not asked for afterwards
        continue
    times += [row.time for row in meter.take()]
assert abs(len(times) - (1000 - 100) * CYCLE_S / PERIOD_S) <= 2, len(times)
"""


def test_its_period_is_kept_by_a_loop_whose_cycles_do_not_divide_it(package, tmp_path):
    bus, folder = package
    fill_in(bus, folder)
    (tmp_path / "pace.py").write_text(PACE)
    done = said(folder, tmp_path, "pace")
    assert done.returncode == 0, done.stderr


MANUAL = """
from leactl_room_meter import driver
from leactl_room_meter.emulator import RoomMeterEmulator, answer_of

assert driver.value_of(b"+23.412") == 23.412
assert answer_of(-5.2) == b"-05.200"
assert answer_of(110.0) == b"+110.00"
for noise in (b"", b"+23.41", b"23.4120", b"+23.41x", b"\\xb5"):
    try:
        raise AssertionError(driver.value_of(noise))
    except ValueError:
        pass
far = RoomMeterEmulator(lambda: 23.412, driver.QUESTION, driver.LINE_END)
far.receive(b"CRDG? 1\\r\\n", 0.0)
assert far.tick(0.0) == b"+23.412\\r\\n"
"""


def test_the_instrument_of_the_guide_says_what_its_manual_says(tmp_path):
    """Lake Shore Model 218 Temperature Monitor User's Manual, pages 6-9 and 6-22."""
    folder = installed(scaffold.write_package("room_meter", "serial", "ambient_temperature", tmp_path))
    fill_in("serial", folder)
    (tmp_path / "manual.py").write_text(MANUAL)
    done = said(folder, tmp_path, "manual")
    assert done.returncode == 0, done.stderr


SOUND = {
    "a voltage between two leads": ("phase_voltage_ab", "+.4f", 0.05),
    "torque in steps of 0.1 N*m": ("torque", "+.1f", 0.05),
    "a reading every two seconds": ("ambient_temperature", "+.2f", 2.0),
    "a flag that is 0 or 1": ("drive_enabled", ".0f", 0.05),
    "a flag that is told every two seconds": ("drive_enabled", ".0f", 2.0),
}


@pytest.mark.parametrize(("quantity", "form", "period_s"), SOUND.values(), ids=SOUND)
def test_the_check_passes_what_is_coarse_or_slow_or_swings(tmp_path, quantity, form, period_s):
    folder = installed(scaffold.write_package("room_meter", "serial", quantity, tmp_path))
    driver, emulator = (folder / "leactl_room_meter" / name for name in ("driver.py", "emulator.py"))
    read, told = "def value_of(answer):\n    return float(answer)", f"return f'{{value:{form}}}'.encode()"
    driver.write_text(
        EMPTY.sub(f"{read}\n\n\n", driver.read_text()).replace('{"period_s": 0.05}', f'{{"period_s": {period_s}}}')
    )
    emulator.write_text(EMPTY.sub(f"def answer_of(value):\n    {told}\n\n\n", emulator.read_text()))
    done = said(folder, tmp_path, "leactl", "driver", "check", "room_meter")
    assert done.returncode == 0, done.stderr
    if quantity == "drive_enabled":
        done = said(folder, folder, "pytest", "-q", "-p", "no:cacheprovider")
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    "wrong",
    ["1.0 - float(answer)", "0.0", "1.0", "0.4 + float(answer)"],
    ids=["the other sense", "always off", "always on", "no flag"],
)
def test_the_check_finds_a_flag_that_is_wrong(tmp_path, wrong):
    folder = installed(scaffold.write_package("room_meter", "serial", "drive_enabled", tmp_path))
    driver, emulator = (folder / "leactl_room_meter" / name for name in ("driver.py", "emulator.py"))
    driver.write_text(EMPTY.sub(f"def value_of(answer):\n    return {wrong}\n\n\n", driver.read_text()))
    emulator.write_text(
        EMPTY.sub("def answer_of(value):\n    return f'{value:.0f}'.encode()\n\n\n", emulator.read_text())
    )
    done = said(folder, tmp_path, "leactl", "driver", "check", "room_meter")
    assert done.returncode == 2
    assert "measures true values: drive_enabled reads" in done.stderr


@pytest.mark.parametrize("bus", scaffold.BUSES)
@pytest.mark.parametrize("quantity", UNITS)
def test_a_package_is_made_for_every_quantity(tmp_path, monkeypatch, quantity, bus):
    """Its driver keeps the contract in words, and its one channel is of the vocabulary."""
    name = f"made_{quantity}_{bus}"
    monkeypatch.syspath_prepend(scaffold.write_package(name, bus, quantity, tmp_path))
    module = importlib.import_module(f"leactl_{name}.driver")
    driver = getattr(module, "".join(word.capitalize() for word in name.split("_")))
    assert conformance.faults_of(driver) == []
    made = driver("meter", "test", driver.Settings.model_validate(dict(driver.example)), None, None)
    [channel] = made.streams[0].channels
    assert (channel.name, channel.quantity, channel.unit) == (quantity, quantity, UNITS[quantity])
    assert UNITS[quantity] in (module.value_of.__doc__ or "")


def test_the_check_finds_a_unit_that_is_off_and_a_line_that_is_guessed(package, tmp_path):
    bus, folder = package
    fill_in(bus, folder)
    driver = folder / "leactl_room_meter" / "driver.py"
    driver.write_text(
        driver.read_text().replace("def value_of(", "def value_of(was):\n    return 1.8 * _of(was) + 32\n\n\ndef _of(")
    )
    done = said(folder, tmp_path, "leactl", "driver", "check", "room_meter")
    assert done.returncode == 2
    assert "measures true values: ambient_temperature reads" in done.stderr


def test_the_channel_stands_on_an_emulated_bench_by_the_lines_of_the_guide(tmp_path):
    folder = installed(scaffold.write_package("room_meter", "serial", "ambient_temperature", tmp_path))
    fill_in("serial", folder)
    put_on_bench(tmp_path)
    done = said(folder, tmp_path, "leactl", "bench", "check", "mine.yaml")
    assert done.returncode == 0, done.stderr
    done = said(folder, tmp_path, "leactl", "bench", "read", "mine.yaml")
    assert re.search(r"ambient_temperature .* degC .* room", done.stdout), done.stdout + done.stderr


UNASKED = """
import math

from leactl.driver.serial_port import SerialPort
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.wires.serial import EmulatedSerialLine, SerialWire
from leactl_room_meter import driver
from leactl_room_meter.driver import RoomMeter


class Instrument:
    '''Tells ten times the time, 20 ms after it is asked, and one line unasked at 0.52 s.'''

    answers, unasked_at = [], 0.52

    @property
    def due(self):
        return min([self.unasked_at, *(moment for moment, _ in self.answers)])

    def receive(self, data, now):
        self.answers += [(now + 0.02, f"{10 * now:.2f}".encode() + driver.LINE_END)] * data.count(driver.LINE_END[-1:])

    def tick(self, now):
        sent = b"".join(answer for moment, answer in self.answers if moment <= now)
        self.answers = [answer for answer in self.answers if answer[0] > now]
        if now >= self.unasked_at:
            self.unasked_at, sent = math.inf, sent + b"OVERLOAD" + driver.LINE_END
        return sent


driver.value_of = float
clock = EmulatedClock()
wire = SerialWire(clock, 11 / 9600)
wire.device = Instrument()
settings = RoomMeter.Settings(period_s=0.1)
room = RoomMeter("room", "test", settings, SerialPort(lambda: EmulatedSerialLine(wire), clock), clock)
room.open()
rows = []
while clock.now() < 2.0:
    rows += room.take()
    clock.sleep_until(clock.now() + 0.002)
assert wire.device.unasked_at == math.inf and len(rows) >= 18
assert all(abs(row.values[0] - 10 * row.time) < 0.1 for row in rows if not row.fault), rows
assert sum(bool(row.fault) for row in rows) <= 1, rows
"""


@pytest.mark.parametrize("unasked_at", [0.52, 0.57])
def test_a_line_that_came_unasked_puts_no_later_row_off(tmp_path, unasked_at):
    folder = installed(scaffold.write_package("room_meter", "serial", "ambient_temperature", tmp_path))
    fill_in("serial", folder)
    (tmp_path / "unasked.py").write_text(UNASKED.replace("0.52", str(unasked_at)))
    done = said(folder, tmp_path, "unasked")
    assert done.returncode == 0, done.stderr


@pytest.fixture
def binary(tmp_path):
    folder = installed(scaffold.write_package("room_meter", "serial", "ambient_temperature", tmp_path))
    make_binary(folder)
    return folder


def test_a_thermometer_that_speaks_modbus_passes_by_the_guide(binary, tmp_path):
    done = said(binary, tmp_path, "leactl", "driver", "check", "room_meter")
    assert done.stdout.startswith("room_meter: keeps the driver contract, in 7 trials"), done.stderr
    done = said(binary, binary, "pytest", "-q", "-p", "no:cacheprovider")
    assert done.returncode == 0, done.stdout


FRAMES = """
from leactl.driver.serial_port import FrameCut
from leactl_room_meter.driver import QUESTION, crc, framing, value_of

answer = bytes.fromhex("01 04 02 FF FF B8 80")
assert crc(QUESTION) == crc(answer) == 0
assert value_of(answer) == -0.01
assert framing(answer) == framing(answer[:4]) == FrameCut(0, 7)
assert framing(bytes.fromhex("01 84 02 C2 C1")) == FrameCut(0, 5)
for noise in (answer[:-1] + b"x", QUESTION, b"x", bytes.fromhex("01 84 02 C2 C0")):
    assert framing(noise) == FrameCut(1, 0)
"""


def test_the_framing_of_the_guide_finds_answers_with_a_right_checksum(binary, tmp_path):
    (tmp_path / "frames.py").write_text(FRAMES)
    done = said(binary, tmp_path, "frames")
    assert done.returncode == 0, done.stderr


RAW_SOCKET = '  room_line: {kind: visa, resource: "TCPIP::192.168.0.6::4001::SOCKET"}\n'
STILL = """
name: still
setup: free
rate_Hz: 50
steps:
  - mode: {test: current}
  - hold: {role: test, current_A: 0.5, duration_s: 2}
  - mode: {test: "off"}
"""


@pytest.mark.parametrize("bus", [None, RAW_SOCKET], ids=["serial", "raw socket"])
def test_its_frames_are_traced_and_replayed(binary, tmp_path, bus):
    driver = binary / "leactl_room_meter" / "driver.py"
    transport = '    transport = "serial"\n'
    assert transport in driver.read_text()
    further = re.search(r"`(further_transports = .*?)`", BINARY)[1]
    driver.write_text(driver.read_text().replace(transport, f"{transport}    {further}\n"))
    put_on_bench(tmp_path, bus)
    (tmp_path / "still.yaml").write_text(STILL)
    words = ("run", "still.yaml", "--bench", "mine.yaml", "--out", tmp_path, "--trace", "run.trace")
    done = said(binary, tmp_path, "leactl", *words)
    assert done.returncode == 0, done.stderr
    wire = [line.split() for line in (tmp_path / "run.trace").read_text().splitlines() if " room_line " in line]
    assert {text for _, _, kind, text in wire if kind == ">"} == {"01040000000131ca"}
    assert "".join(text for _, _, kind, text in wire if kind == "<").startswith("010402")
    done = said(binary, tmp_path, "leactl", "driver", "replay", "run.trace", "--bench", "mine.yaml", "--json")
    assert done.returncode == 0, done.stderr
    replayed = json.loads(done.stdout)
    assert (replayed["difference"], replayed["raised"]) == (None, [])


def test_the_code_of_the_guide_for_binary_protocols_is_checked_as_leactl_s_own_is(binary, tmp_path):
    for words in (("ruff", "check"), ("ruff", "format", "--check")):
        done = said(binary, tmp_path, *words, "--config", ROOT / "pyproject.toml", binary / "leactl_room_meter")
        assert done.returncode == 0, done.stdout


def test_the_code_is_checked_as_leactl_s_own_is(package, tmp_path):
    bus, folder = package
    fill_in(bus, folder)
    for words in (("ruff", "check", "--extend-ignore", "ANN,D103"), ("ruff", "format", "--check")):
        command = (*words, "--config", ROOT / "pyproject.toml", folder / "leactl_room_meter")
        done = said(folder, tmp_path, *command)
        assert done.returncode == 0, done.stdout


def test_the_files_are_told_and_nothing_is_overwritten(tmp_path):
    words = ("driver", "new", "scale", "--quantity", "torque", "--into", tmp_path)
    answer = json.loads(leactl(*words, "--json").stdout)
    assert {Path(file).name for file in answer["files"]} == {
        "__init__.py", "driver.py", "emulator.py", "pyproject.toml", "test_scale.py"
    }  # fmt: skip
    assert all(Path(file).is_file() for file in answer["files"])
    done = leactl(*words)
    assert done.returncode == 2
    assert "leactl-scale is there already; nothing was written" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["leactl-scale"]


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (("Scale", "--quantity", "torque"), "'Scale': small letters"),
        (("../scale", "--quantity", "torque"), "'../scale': small letters"),
        (("ads1115", "--quantity", "torque"), "driver 'ads1115' is registered already"),
        (("scale", "--quantity", "torques"), "quantity 'torques' is not known; known: "),
        (("none", "--quantity", "torque"), "'none': its class would be None"),
        (("row", "--quantity", "torque"), "'row': its class would be Row"),
        (("stream_spec", "--quantity", "torque", "--bus", "i2c"), "'stream_spec': its class would be StreamSpec"),
        (("scale", "--quantity", "torque", "--bus", "usb"), "bus 'usb' has no template; serial or i2c"),
        (("scale", "--quantity", "torque", "--into", "nowhere"), "cannot be written: No such file"),
    ],
)
def test_what_cannot_be_made_is_refused_in_a_line(tmp_path, monkeypatch, words, fault):
    monkeypatch.chdir(tmp_path)
    done = leactl("driver", "new", *words)
    assert done.returncode == 2
    assert fault in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
