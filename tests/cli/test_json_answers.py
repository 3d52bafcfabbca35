"""What `--json` prints fits the page of JSON answers, and the page has nothing that no answer has."""

import dataclasses
import json
import re
import shlex
import shutil
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from leactl.gap.diagnosis import DiagnosisResult
from tests.cli.answers import SCHEMA, fits_the_page, sections, written
from tests.cli.terminal import leactl
from tests.cli.test_schema import PAGES
from tests.exchange.robots import SERVO, leg

ANSWERS = sections()
AUGMENTED = """\
name: knee
torque_constant: 1.8
phase_resistance: 5.4
coulomb_friction: 0.3
drive: {type: position_servo, gain: 45, voltage_limit: 24}
effects: [{effect: stribeck, parameters: {breakaway_ratio: 0.3, stribeck_velocity: 0.2}}]
"""
SELDOM = (
    r"welch\.|unexplained\.|causes\[\]|region\.|acceptance\[\]\.(result|bisect)|results\[\]\.(actuator|condition)$"
    r"|unreadable\[\]\.|^simulator"
)
ELSEWHERE = {  # answers of several lines, or that take minutes or a drive: the test that holds its own against the page
    "Readings of a bench": "tests/cli/test_bench_follow.py",
    "A closed loop": "tests/exchange/test_loop.py",
    "A trace, replayed": "tests/runner/test_wire_traces.py",
    "A recording of a drive": "tests/driver/test_elmo_serial_wire.py",
    "A scan of wires": "tests/cli/test_bench_scan.py",
}


def test_the_file_of_schemas_is_that_of_the_page():
    assert SCHEMA.read_text(encoding="utf-8") == written()
    assert len(ANSWERS) >= 16


def keys_of(kind):
    """Every key of a dataclass and of those within, as the page writes them."""
    for name, hint in get_type_hints(kind).items():
        inner = [part for part in (hint, *get_args(hint)) if dataclasses.is_dataclass(part)]
        several = "tuple" in str(hint)
        yield from (f"{name}{'[]' if several else ''}.{key}" for part in inner for key in keys_of(part))
        yield name


def test_the_page_has_every_key_of_a_diagnosis():
    page = {key.replace("[]", "") for key, _, _ in ANSWERS["A diagnosis"][1]}
    code = {key.replace("[]", "") for key in keys_of(DiagnosisResult) if not key.startswith("extra")}
    assert {key for key in code if not key.startswith("unexplained.shapes.")} | {"format", "format_version"} == page


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A folder with runs, protocols and a model."""
    folder = tmp_path_factory.mktemp("answers")
    state = {"LEACTL_STATE": str(folder / "state")}
    for text in re.findall(r"```yaml\n(name: .*?)```", PAGES["protocol"].read_text(), re.DOTALL):
        (folder / f"{re.match(r'name: (.*)', text)[1]}.yaml").write_text(text)
    (folder / "nominal.yaml").write_text(leactl("bench", "model", "emulated").stdout)
    friction = "friction", "--set", "trials=2", "--set", "hold_s=3", "--set", "settle_s=1"
    for condition in ("unloaded", "design"):
        for words in (friction, ("torque-constant", "--set", "trials=1")):
            words = *words, "--bench", "emulated", "--condition", condition, "--out", folder / "runs"
            assert leactl("run", *words, **state).returncode == 0
    for path in sorted((folder / "runs").glob("*.h5")):
        path.rename(path.with_name(re.sub(r"^.*?Z-", "", path.name)))
    shutil.copy(next((folder / "runs").glob("torque*.h5")), folder / "RUN.h5")
    leg(folder, SERVO.replace("/>", ' ctrlrange="-1 1"/>'))
    (folder / "augmented.yaml").write_text(AUGMENTED)
    return folder


def keys_in(answer, known, key=""):
    """The keys of the page that an answer has."""
    if key in known:
        yield key
    if isinstance(answer, dict):
        for name, value in answer.items():
            for part in (name, "*"):
                yield from keys_in(value, known, f"{key}.{part}" if key else part)
        if not answer:
            yield f"{key}.*"
    elif isinstance(answer, list):
        for item in answer:
            yield from keys_in(item, known, f"{key}[]")
        if not answer:
            yield f"{key}[]"


@pytest.mark.parametrize("title", ELSEWHERE)
def test_an_answer_that_is_not_printed_here_is_held_against_the_page(title):
    text = (Path(__file__).parents[2] / ELSEWHERE[title]).read_text(encoding="utf-8")
    assert f'fits_the_page("{title}", ' in text


@pytest.mark.parametrize("title", [title for title in ANSWERS if title not in ELSEWHERE])
def test_an_answer_fits_its_table(title, workshop, monkeypatch):
    monkeypatch.chdir(workshop)
    command, rows = ANSWERS[title]
    if "robot.xml" in command:
        pytest.importorskip("mujoco", reason="robots are read by leactl[mujoco]")
    words = [name for word in shlex.split(command) for name in (sorted(map(str, Path().glob(word))) or [word])]
    done = leactl(*words, LEACTL_STATE=str(workshop / "state"))
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    fits_the_page(title, answer)
    known = {key for key, _, _ in rows}
    assert not [key for key in known - set(keys_in(answer, known)) if not re.search(SELDOM, key)]
