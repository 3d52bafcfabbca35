"""The registry and the conformance suite, over every registered driver and over a broken one."""

import json
import re
from pathlib import Path
from typing import Annotated

import leactl_plugins
import pytest
from pydantic import Field

from leactl.driver import conformance, registry
from leactl.driver.contract import Driver
from leactl.errors import InputError
from tests.cli.terminal import leactl

ROOT, PAGE = Path(__file__).parents[2], Path(leactl_plugins.__file__)


@pytest.mark.parametrize("name", registry.names())
def test_every_registered_driver_keeps_the_contract(name):
    assert conformance.faults_of(registry.load(name)) == []


@pytest.mark.parametrize("name", registry.names())
def test_every_page_says_what_was_proven_and_names_tests_that_exist(name):
    page = PAGE.parent.joinpath(name, "README.md").read_text(encoding="utf-8")
    _, _, proven = page.partition("## What was proven, and against what\n")
    section = proven.split("\n## ")[0]
    assert re.search(r"Only a \S+(\s\S+)? can show", section)
    named = re.findall(r"tests/\w+/\w+\.py", section)
    assert named
    assert [path for path in named if not (ROOT / path).exists()] == []


def test_a_driver_that_breaks_the_contract_is_told_how():
    class Settings(registry.load("ads1115").Settings):
        gain: float = 1.0
        weight: Annotated[float, Field(gt=0.0)] | None = None
        offsets: tuple[float, ...] = ()

    class Careless(Driver):
        transport = "telepathy"
        summary = "careless"

        def close(self): ...

        def safe_state(self, deadline_s): ...

    Careless.Settings = Settings
    faults = "; ".join(conformance.faults_of(Careless))
    for words in (
        "telepathy",
        "gain is a number",
        "weight is a number",
        "offsets is a number",
        "does not implement __init__, open",
        "Confirmation",
        "no docstring",
    ):
        assert words in faults


@pytest.mark.parametrize(("name", "further"), [("scpi_supply", ("can",)), ("ads1115", ("visa",))])
def test_a_driver_over_a_further_bus_that_gives_it_another_port_breaks_the_contract(name, further):
    driver = type("Elsewhere", (registry.load(name),), {"further_transports": further, "__doc__": "Elsewhere."})
    fault = "further_transports may only be ('visa',), and only if transport is 'serial'"
    assert conformance.faults_of(driver) == [fault]


def test_a_probe_for_another_wire_breaks_the_contract():
    probe = registry.load("ads1115").probe
    driver = type("Elsewhere", (registry.load("elmo_can"),), {"probe": probe, "__doc__": "Elsewhere."})
    fault = "probe is of class Ads1115Probe; a CanProbe was expected with transport 'can'"
    assert conformance.faults_of(driver) == [fault]


def test_a_supply_that_cannot_be_cut_at_once_breaks_the_contract():
    supply = registry.load("scpi_supply")

    class Slow(supply):
        """A supply that is switched off only when it is asked whether it is."""

        stop_now = Driver.stop_now

        def safe_state(self, deadline_s): ...

    assert any("must have a stop_now" in fault for fault in conformance.faults_of(Slow))


def test_an_unknown_driver_lists_the_known():
    with pytest.raises(InputError, match=r"known: .*ads1115, .*elmo_can"):
        registry.load("elmo")


@pytest.fixture
def broken_plugin(tmp_path):
    folder = tmp_path / "broken-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text("[leactl.drivers]\nbroken = broken_plugin:Driver\n")
    (tmp_path / "broken_plugin.py").write_text("raise RuntimeError('made for another world')\n")
    return tmp_path


def test_a_broken_plugin_is_reported_and_harms_nothing(broken_plugin):
    listed = leactl("driver", "list", "--json", PYTHONPATH=str(broken_plugin), PATH="/usr/bin:/bin")
    assert listed.returncode == 0
    rows = {row["name"]: row for row in json.loads(listed.stdout)["drivers"]}
    assert "made for another world" in rows["broken"]["error"]
    assert rows["elmo_can"]["error"] is None
    info = leactl("driver", "info", "broken", PYTHONPATH=str(broken_plugin), PATH="/usr/bin:/bin")
    assert info.returncode == 2
    assert info.stderr.startswith("leactl: driver 'broken' of broken 1.0 cannot be used")


def test_info_shows_units_defaults_and_ranges():
    shown = leactl("driver", "info", "elmo_can")
    assert shown.returncode == 0
    line = next(line for line in shown.stdout.splitlines() if "consumer_heartbeat_ms" in line)
    assert line.split() == ["consumer_heartbeat_ms", "integer", "default", "100", ">=", "10", "<=", "1000"]


def test_check_answers_in_json_and_by_exit_status():
    checked = leactl("driver", "check", "ads1115", "--json")
    assert (checked.returncode, json.loads(checked.stdout)["passed"]) == (0, True)
    assert leactl("driver", "check", "nothing").returncode == 2
