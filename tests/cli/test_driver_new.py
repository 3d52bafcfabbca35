"""`leactl driver new`, by its guide: a package whose driver passes once two functions are filled in."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from leactl.driver import scaffold
from tests.cli.terminal import leactl

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs" / "how-to" / "own-driver.md").read_text(encoding="utf-8")
EMPTY = re.compile(r"^def \w+_of\(.*?(?=^class )", re.MULTILINE | re.DOTALL)  # the one function that is to be filled in
FUNCTIONS = {
    "serial": dict(
        zip(("driver.py", "emulator.py"), re.findall(r"```python\n(def .*?)```", GUIDE, re.DOTALL), strict=True)
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


def fill_in(bus, package):
    for name, function in FUNCTIONS[bus].items():
        path = package / "leactl_room_meter" / name
        text, count = EMPTY.subn(lambda _: function + "\n\n", path.read_text())  # noqa: B023 (called at once)
        assert count == 1
        path.write_text(text)


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
    assert done.stdout.startswith("room_meter: keeps the driver contract, in 4 trials"), done.stderr
    done = said(folder, folder, "pytest", "-q", "-p", "no:cacheprovider")
    assert " passed" in done.stdout, done.stdout


def test_the_check_finds_a_unit_that_is_off_and_a_line_that_is_guessed(package, tmp_path):
    bus, folder = package
    fill_in(bus, folder)
    driver = folder / "leactl_room_meter" / "driver.py"
    driver.write_text(
        driver.read_text().replace("def value_of(", "def value_of(was):\n    return 1.8 * _of(was) + 32\n\n\ndef _of(")
    )
    done = said(folder, tmp_path, "leactl", "driver", "check", "room_meter")
    assert done.returncode == 2
    assert "measures what is there: ambient_temperature reads" in done.stderr


def test_the_channel_stands_on_an_emulated_bench_by_the_lines_of_the_guide(tmp_path):
    folder = installed(scaffold.write_package("room_meter", "serial", "ambient_temperature", tmp_path))
    fill_in("serial", folder)
    bus, device = re.findall(r"```yaml\n(.*?)```", GUIDE, re.DOTALL)
    bench = leactl("bench", "show", "emulated").stdout
    bench = bench.replace("buses:\n", f"buses:\n{bus}", 1).replace("devices:\n", f"devices:\n{device}", 1)
    (tmp_path / "mine.yaml").write_text(bench)
    done = said(folder, tmp_path, "leactl", "bench", "check", "mine.yaml")
    assert done.returncode == 0, done.stderr
    done = said(folder, tmp_path, "leactl", "bench", "read", "mine.yaml")
    assert re.search(r"ambient_temperature .* degC .* room", done.stdout), done.stdout + done.stderr


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
