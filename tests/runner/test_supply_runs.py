"""Runs that heat through two leads, whole: what is recorded, what is refused before, and how they end."""

import json
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from leactl.bench import benchfile
from leactl.bench.bench import Bench
from leactl.bench.benchfile import load
from leactl.bench.wiring import MachineWiring
from leactl.errors import DeviceError, DeviceFault, InputError
from leactl.protocol import protocolfile
from leactl.runfile.read.reader import Run
from leactl.runner.thermal_admission import Windings
from leactl.runner.thermal_memory import Recalled
from leactl.runner.unattended_supply import endings, supplies_left_on
from tests.cli.terminal import leactl
from tests.latches import trip_of
from tests.runner.test_pause import GO_ON, PAUSE

HEAT = """
name: heat
setup: heated
attended: true
rate_Hz: 30
parameters: {current_A: 9, voltage_V: 8, heat_s: 20}
steps:
  - hold: {name: rest, duration_s: 1}
  - supply: {test: {voltage_V: $voltage_V, current_A: $current_A}}
  - hold: {name: heating, duration_s: $heat_s}
  - supply: {test: off}
  - hold: {name: cooling, duration_s: 3}
"""
DEAD_MAN = Path(__file__).parents[2] / "docs" / "explanation" / "dead-man.md"
OFF = (True, "output off, 0.00 V and 0.00 A")


@pytest.fixture
def heat(spin):
    """Run `heat` on the shipped bench of heated leads, with parameters set."""

    def run(text=HEAT, *, at=(), bench="emulated-heated", **sets):
        return spin(text, at=at, bench=bench, sets=[f"{k}={v}" for k, v in sets.items()], condition="")

    return run


def told(path):
    with Run.open(path) as run:
        return [event.message for event in run.events]


def test_a_run_heats_the_winding_and_records_voltage_and_current_at_thirty_hertz(heat):
    outcome, bench = heat()
    assert outcome.status == "complete"
    assert outcome.safe["supply"] == OFF
    assert bench.rig.line_current == 0.0
    with Run.open(outcome.path) as run:
        assert run.mechanical == "heated"
        steps = {step.name: step for step in run.steps}
        current, voltage = run.channel("line_current", role="test"), run.channel("line_voltage", role="test")
        heating = (current.time > steps["heating"].start + 0.1) & (current.time < steps["heating"].stop)
        assert np.sum(heating) > 28 * 20
        assert current.values[heating] == pytest.approx(9.0)
        resistance = voltage.values[heating] / current.values[heating]
        # two phases take 21.4 W each and 7 % more when warm, over 16.8 || 0.9 K/W to air and housing: 95 % of 19.6 K
        # after 20 s, and 43 W x 20 s into the housing's 469 J/K, half of it late; 0.4 % a kelvin
        assert resistance[:30].mean() == pytest.approx(0.528, rel=0.01)
        assert resistance[-30:].mean() == pytest.approx(0.528 * (1 + 0.004 * 20), rel=0.005)
        cooling = current.time > steps["cooling"].start + 0.1
        assert not current.values[cooling].any()
    events = told(outcome.path)
    assert "supply test 8 V, 9 A" in events
    assert "supply test off" in events
    assert any(text.startswith("constant current: ") for text in events)


def test_a_supply_at_its_voltage_says_so_and_gives_what_it_can(heat):
    outcome, _bench = heat(voltage_V=4, heat_s=3)
    assert outcome.status == "complete"
    assert any(text.startswith("constant voltage: 4.000 V, 7.5") for text in told(outcome.path))


@pytest.mark.parametrize(
    ("sets", "complaint"),
    [
        ({"current_A": 10.1}, "asks 10.1 A of the supply of test; it is good for 10 A on bench 'emulated-heated'"),
        ({"voltage_V": 10.1}, "asks 10.1 V of the supply of test; it is good for 10 V"),
        ({"current_A": 10.2}, "test line_current: 10.2 A is above the bench limit of 10.1116 A"),
    ],
)
def test_what_cannot_go_well_is_refused_before_anything_is_touched(heat, sets, complaint):
    with pytest.raises(InputError, match=complaint):
        heat(**sets)


def test_a_bench_without_a_supply_is_refused(heat):
    with pytest.raises(InputError, match="supplies the leads of test; bench 'emulated' has no supply there"):
        heat(bench="emulated")


def test_a_level_between_two_steps_of_the_supply_ends_the_run_before_anything_flows(heat):
    outcome, bench = heat(current_A=8.95)
    assert isinstance(outcome.error, InputError)
    assert "8.95 A asked of a supply with steps of 0.1 A" in outcome.reason
    assert bench.rig.lead_resistance == pytest.approx(0.528)


def absent(bench):
    bench.serial_wires["supply0"].gone = True


def silent(bench):
    bench.serial_wires["supply0"].cut = True


@pytest.mark.parametrize(
    ("fault", "said"),
    [(absent, "supply: bus 'supply0': no such device"), (silent, "supply: no answer to SOUT1")],
)
def test_a_supply_that_is_not_there_is_told_before_the_run(heat, fault, said):
    with pytest.raises(DeviceError, match=said):
        heat(at=[(0.0, fault)])


def test_a_supply_that_falls_silent_while_it_heats_ends_the_run_and_is_told(heat):
    outcome, bench = heat(at=[(6.0, silent)])
    assert outcome.status == "failed"
    assert "supply: no answer to" in outcome.reason
    assert "NOT CONFIRMED SAFE, switch off the supply" in "".join(outcome.error.__notes__)
    assert bench.rig.line_current == 9.0  # nothing that is sent arrives, which is what was told


def stuck(bench):
    bench.far_ends["supply"].stuck_on()


def test_a_supply_that_is_stuck_on_fails_the_run_at_the_step_that_ends_the_heat(heat):
    outcome, bench = heat(at=[(5.0, stuck)])
    assert outcome.status == "failed"
    assert isinstance(outcome.error, DeviceFault)
    assert "supply: the output does not switch off" in outcome.reason
    assert not outcome.safe["supply"].safe
    assert "the output is still on, 1." in outcome.safe["supply"].detail  # turned down, for it obeys in that
    assert bench.rig.line_current < 4.0


def test_a_pause_waits_until_the_supply_is_off(heat):
    outcome, _bench = heat(at=[(5.0, PAUSE), (40.0, GO_ON)])
    assert outcome.status == "complete"
    with Run.open(outcome.path) as run:
        pause = next(step for step in run.steps if step.name == "pause")
        current = run.channel("line_current", role="test")
    inside = (current.time > pause.start + 0.5) & (current.time < pause.stop)
    assert np.sum(inside) > 28 * 10
    assert not current.values[inside].any()


def test_a_supply_out_of_regulation_trips(heat):
    outcome, bench = heat(at=[(5.0, lambda bench: bench.far_ends["supply"].lose_regulation(0.5))])
    assert outcome.status == "tripped"
    assert "supply: out of regulation" in outcome.reason
    assert outcome.safe["supply"] == OFF
    assert trip_of("emulated-heated")
    assert bench.rig.line_current == 0.0


def test_a_person_who_stops_the_run_finds_the_supply_off(spin):
    hot = iter(range(400))
    outcome, bench = spin(
        HEAT, bench="emulated-heated", sets=(), condition="", stops=[lambda: "enough" if next(hot) > 300 else ""]
    )
    assert (outcome.status, outcome.reason) == ("stopped", "enough")
    assert outcome.safe["supply"] == OFF
    assert bench.rig.line_current == 0.0


# -- the protocol that ships -----------------------------------------------------------------------------------------


def test_thermal_on_a_bench_without_a_camera_says_what_has_to_come_from_elsewhere(heat, tmp_path):
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated-heated.yaml").read_text())
    del bench["devices"]["camera"]
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench))
    text = (protocolfile.locate("thermal")).read_text()
    outcome, _bench = heat(text, bench=str(tmp_path / "bench.yaml"), rest_s=2, heating_s=3, cooling_s=2)
    assert outcome.status == "complete"
    events = told(outcome.path)
    for quantity in ("winding_temperature", "housing_temperature", "ambient_temperature"):
        assert f"no device measures {quantity}: its record has to come from elsewhere" in events
    assert not any("line_voltage" in text for text in events if text.startswith("no device"))


def forecast(tmp_path, current, part=None):
    """Peak of the hottest phase at the most, and where the limit would be passed, until the end of heating."""
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated-heated.yaml").read_text())
    if part is not None:
        motor = yaml.safe_load(leactl("motor", "show", "lea").stdout)
        motor["tolerances"] = {name: value * part for name, value in motor["tolerances"].items()}
        (tmp_path / "narrow.yaml").write_text(yaml.safe_dump(motor))
        bench["motors"] = {"test": str(tmp_path / "narrow.yaml")}
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench))
    file, devices, _document = load(str(tmp_path / "bench.yaml"))
    windings = Windings(file, devices, emulated_here=True)
    return windings.forecast(protocolfile.load("thermal", {"current_A": str(current), "cooling_s": "1"}))


def test_eight_amperes_are_good_for_every_actuator_in_the_tolerances_and_nine_are_not(tmp_path):
    """`worst` is the corner of the box in closed form: a network of resistances with two phases at half each."""
    allowed = forecast(tmp_path, 8)
    assert allowed.passing is None
    assert worst(8.0) - 1.0 < allowed.peaks["test"] < 130.0  # 75 min are 99 % of the way
    refused = forecast(tmp_path, 9)
    assert (refused.passing.step, refused.passing.role) == ("heating", "test")
    assert refused.passing.time_s < 1100
    assert worst(9.0) > 160.0


def test_nine_amperes_are_good_for_tolerances_of_a_fifth(tmp_path):
    assert forecast(tmp_path, 9, part=0.2).passing is None


def worst(current, ambient=28.0):
    """Hottest phase in the end [degC] of the actuator that is furthest off, by its balance of heat."""
    phase = 0.264 * 1.1
    alpha, rwa, rwh, rha = 0.0044, 5.6 * 1.1, 0.3 * 1.1, 1.7 * 1.1
    square = (current * 1.02) ** 2
    # unknown: rises of the two phases that carry it, of the third, of the housing; a phase has thrice the resistances
    to_air, across = 1 / (3 * rwa), 1 / (3 * rwh)
    balance = np.array(
        [
            [to_air + across - phase * square * alpha, 0.0, -across],
            [0.0, to_air + across, -across],
            [-2 * across, -across, 3 * across + 1 / rha],
        ]
    )
    heat = np.array([phase * square * (1 + alpha * (ambient - 25.0)), 0.0, 0.0])
    return ambient + np.linalg.solve(balance, heat)[0]


def test_a_plan_is_told_at_the_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = leactl("protocol", "plan", "thermal", "--bench", "emulated-heated", "--json", **os.environ)
    assert done.returncode == 0, done.stderr
    plan = json.loads(done.stdout)
    [peak] = plan["peaks"]
    low, high = peak.pop("limits")
    assert low < -8.0 < 8.0 < high
    assert peak == {"role": "test", "quantity": "line_current", "value": 8.0, "unit": "A"}
    assert [row["setpoints"] for row in plan["timeline"] if row["name"] == "supply"] == ["test 8 V, 8 A", "test off"]
    assert plan["duration_s"] == 9060.0


# -- if nobody switches it off ---------------------------------------------------------------------------------------

UNATTENDED = HEAT.replace("attended: true\n", "")
SCPI = {
    "driver": "scpi_supply",
    "bus": "supply0",
    "role": "test",
    "settings": {
        "dialect": "e36xx",
        "model": "E3633A",
        "feeds": "leads",
        "voltage_limit_V": 8,
        "current_limit_A": 10,
        "period_s": 0.3,
    },
}


def protected(tmp_path, supply=SCPI, **changed):
    """The shipped bench of heated leads with a supply that has an over-voltage protection."""
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated-heated.yaml").read_text())
    del bench["devices"]["camera"]
    bench["devices"]["supply"] = supply
    bench["limits"] |= changed
    path = tmp_path / "protected.yaml"
    path.write_text(yaml.safe_dump(bench))
    return str(path)


def test_a_current_that_nothing_would_end_is_refused_with_what_helps(heat):
    with pytest.raises(InputError) as refused:
        heat(UNATTENDED)
    assert str(refused.value) == (
        "protocol 'heat': nothing switches off the supply of test if this machine fails, and 8 V, 9 A left on may bring"
        " its winding to 168 degC, above its limit of 130 degC; what helps: voltage_V of 5.7 at the most, where the"
        " supply itself takes the current back, or current_A of 8 at the most, or a supply whose own protection ends"
        " the current in time, or a person who stays by the bench: `attended: true` in the protocol, or --attended"
    )


@pytest.mark.parametrize("sets", [{"voltage_V": 5.7}, {"current_A": 8.0}])
def test_what_is_said_to_help_does(heat, sets):
    outcome, _bench = heat(UNATTENDED, **sets)
    assert outcome.status == "complete"
    assert any(text.endswith("which it outlives") for text in told(outcome.path))


def more_than_set(at_s, mended_s=math.inf):
    """Far ends that give 8.2 A where 8 A are set, which their drivers call well regulated."""
    return [
        (at_s, lambda bench: bench.far_ends["supply"].lose_regulation(1.025)),
        *([] if math.isinf(mended_s) else [(mended_s, lambda bench: bench.far_ends["supply"].mend())]),
    ]


def test_a_supply_that_gives_more_than_its_winding_outlives_is_switched_off(heat):
    outcome, bench = heat(UNATTENDED, current_A=8.0, heat_s=30, at=more_than_set(6.0))
    assert outcome.status == "tripped"
    [most] = re.findall(r"than the winding outlives: ([\d.]+) A beside 8 V", DEAD_MAN.read_text())
    assert f"test supply gives 8.2 A, and its winding outlives {most}" in outcome.reason
    assert bench.rig.line_current == 0.0


@pytest.mark.parametrize(("text", "mended_s"), [(UNATTENDED, 12.0), (HEAT, math.inf)])
def test_more_than_is_outlived_may_flow_for_a_moment_or_where_somebody_attends(heat, text, mended_s):
    outcome, _bench = heat(text, current_A=8.0, heat_s=30, at=more_than_set(6.0, mended_s))
    assert outcome.status == "complete", outcome.reason


def test_an_attended_run_says_so_in_its_file(heat):
    outcome, _bench = heat()
    assert "test supply left on at 8 V, 9 A: winding 168 degC; the run is attended" in told(outcome.path)


def test_a_hot_housing_outlives_no_supply_and_a_rest_is_what_helps(tmp_path):
    file, devices, _document = load("emulated-heated")
    windings = Windings(file, devices, emulated_here=True)
    windings.recalled["test"] = Recalled(np.array([120.0, 115.0, 108.0]), "made up")
    bench = Bench(file, devices, MachineWiring())
    plan = protocolfile.load("thermal", {"current_A": "2"})
    with pytest.raises(InputError) as refused:
        endings(plan, windings, supplies_left_on(plan, windings, bench))
    assert str(refused.value) == (
        "protocol 'thermal': nothing switches off the supply of test if this machine fails, and 8 V, 2 A left on are"
        " not known to keep its winding below its limit of 130 degC from where it may begin, winding 120 and housing"
        " 108 degC; what helps: a rest before the run, in which it cools, or a supply whose own protection ends the"
        " current in time, or a person who stays by the bench: `attended: true` in the protocol, or --attended"
    )
    plan = protocolfile.load("thermal", {"current_A": "9"})
    with pytest.raises(
        InputError, match="what helps: a rest before the run, in which it cools, and lower levels, or a"
    ):
        endings(plan, windings, supplies_left_on(plan, windings, bench))


def test_the_refusal_of_a_delta_winding_names_no_levels_that_are_refused_as_well(tmp_path):
    file, devices, _document = load("emulated-heated")
    windings = Windings(file, devices, emulated_here=True)
    windings.motors["test"] = windings.motors["test"].model_copy(update={"winding": "delta"})
    bench = Bench(file, devices, MachineWiring())
    plan = protocolfile.load("thermal", {"current_A": "2"})
    with pytest.raises(InputError) as refused:
        endings(plan, windings, supplies_left_on(plan, windings, bench))
    assert str(refused.value) == (
        "protocol 'thermal': nothing switches off the supply of test if this machine fails, and the heating of a delta"
        " winding through two leads is not bounded here; a person has to stay by the bench: `attended: true` in the"
        " protocol, or --attended"
    )


def test_a_supply_with_a_protection_has_it_armed_while_it_heats_and_put_back(heat, tmp_path):
    levels = []

    def look(bench):
        far = bench.far_ends["supply"]
        levels.append((far.fed.on, far.fed.over_voltage.level, far.fed.over_voltage.armed))

    outcome, bench = heat(UNATTENDED, bench=protected(tmp_path), heat_s=10, at=[(0.0, look), (6.0, look)])
    assert outcome.status == "complete", outcome.reason
    [said] = [text for text in told(outcome.path) if text.startswith("test supply left on")]
    assert said == "test supply left on at 8 V, 9 A: winding 168 degC, but for the supply's own protection at 5.16 V"
    assert levels[1] == (True, pytest.approx(5.16, abs=0.005), True)
    look(bench)
    assert levels[2] == (False, levels[0][1], levels[0][2])


def test_the_protection_ends_the_current_where_every_process_is_dead(heat, tmp_path):
    """Nobody says a word to the supply any more, and the plant goes on."""
    hottest = []

    def die(bench):
        bench.serial_wires["supply0"].cut = True
        while bench.rig.line_current:
            bench.time.sleep_until(bench.time.now() + 0.5)
            hottest.append(bench.rig.lead_resistance)

    outcome, bench = heat(UNATTENDED, bench=protected(tmp_path), heat_s=200, at=[(8.0, die)])
    assert outcome.status == "tripped"  # the loop wakes up long after, if it does
    assert bench.far_ends["supply"].fed.over_voltage.tripped
    assert 0.57 < max(hottest) < 0.528 * (1 + 0.004 * (130 - 25))


# -- one output of several -------------------------------------------------------------------------------------------

SECOND_OF_THREE = SCPI | {
    "settings": SCPI["settings"] | {"dialect": "dp800", "model": "DP832", "output": 2, "current_limit_A": 3}
}


@pytest.mark.parametrize(
    ("mishap", "status"),
    [
        (lambda _bench: None, "complete"),
        (lambda bench: bench.far_ends["supply"].lose_regulation(0.5), "tripped"),
        (stuck, "failed"),
    ],
    ids=["whole", "out of regulation", "stuck"],
)
def test_a_run_heats_by_one_output_and_leaves_the_others_as_they_are(heat, tmp_path, mishap, status):
    others = []

    def look(bench):
        far = bench.far_ends["supply"]
        assert far.fed.number == 2
        protections = ("over_voltage", "over_current")
        others.append(
            [vars(each) | {name: dict(vars(getattr(each, name))) for name in protections} for each in far.outputs[::2]]
        )

    def use(bench):
        for output in bench.far_ends["supply"].outputs[::2]:
            output.set_volts, output.set_amperes, output.on = 3.3, 0.5, True
            output.regulate()
        look(bench)

    bench = protected(tmp_path, SECOND_OF_THREE)
    outcome, emulated = heat(bench=bench, current_A=2.5, heat_s=6, at=[(0.0, use), (4.0, look), (4.5, mishap)])
    assert outcome.status == status, outcome.reason
    look(emulated)
    assert others[0] == others[1] == others[2]
    assert [output["on"] for output in others[2]] == [True, True]
    assert emulated.far_ends["supply"].fed.stuck or emulated.rig.line_current == 0.0


def test_a_bench_file_without_the_output_is_refused_with_its_place(tmp_path):
    settings = {key: value for key, value in SECOND_OF_THREE["settings"].items() if key != "output"}
    path = protected(tmp_path, SECOND_OF_THREE | {"settings": settings})
    done = leactl("bench", "check", path)
    assert done.returncode == 2
    [line] = done.stderr.splitlines()
    assert line.endswith("output is missing: DP832 has several, 1 to 3 was expected")
    assert "protected.yaml" in line


def test_the_page_tells_what_stays_on(tmp_path):
    """Each row of the table, for either supply: what is reached, and what ends it."""
    rows = re.findall(
        r"^\| ([\d.]+) V, ([\d.]+) A \| (\d+) degC \| (.*) \| (.*) \|$", DEAD_MAN.read_text(), re.MULTILINE
    )
    assert len(rows) == 4
    for volts, amperes, hottest, *ends in rows:
        for bench, end in zip(("emulated-heated", protected(tmp_path)), ends, strict=True):
            words = ["--bench", bench, "--set", f"voltage_V={volts}", "--set", f"current_A={amperes}", "--json"]
            done = leactl("protocol", "plan", "winding-rise", *words)
            [told] = json.loads(done.stdout)["left_on"]
            assert f"at {volts} V, {amperes} A: winding {hottest} degC" in told
            said = {"outlived": "which it outlives", "refused, or attended": "nothing ends the current"}
            assert told.endswith(said.get(end, f"protection at {end.removeprefix('ended at ')}"))


def test_a_person_attends_by_a_word_at_the_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "heat.yaml").write_text(UNATTENDED)
    words = ["run", "heat.yaml", "--bench", "emulated-heated", "--dry-run"]
    refused = leactl(*words)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "nothing switches off the supply of test" in refused.stderr
    done = leactl(*words, "--attended")
    assert done.returncode == 0, done.stderr
    assert "test supply left on at 8 V, 9 A: winding 168 degC; the run is attended\n" in done.stdout
