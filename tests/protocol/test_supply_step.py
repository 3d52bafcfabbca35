"""The step that has leads supplied: what it becomes, and what is refused with its place."""

import pytest

from leactl.errors import InputError
from leactl.protocol.plan import SetSupply
from tests.protocol.writing import read

HEAD = "name: trial\nsetup: {setup}\nrate_Hz: 30\nparameters: {{amperes: 9}}\nsteps:\n"
ON = "supply: {test: {voltage_V: 8, current_A: $amperes}}"


def protocol(*steps, setup="heated"):
    return HEAD.format(setup=setup) + "".join(f"  - {step}\n" for step in steps)


def test_levels_and_off_in_order():
    result = read(protocol(ON, "hold: {duration_s: 5}", "supply: {test: off}"))
    assert result.actions[0] == SetSupply({"test": (8.0, 9.0)})
    assert result.actions[2] == SetSupply({"test": None})
    assert result.peaks() == {("test", "line_current"): 9.0}
    assert [row.setpoints for row in result.timeline()] == ["test 8 V, 9 A", "", "test off"]


def test_the_largest_current_is_the_peak():
    steps = ["supply: {test: {voltage_V: 8, current_A: 3}}", ON, "supply: {test: {voltage_V: 2, current_A: 5}}"]
    assert read(protocol(*steps)).peaks() == {("test", "line_current"): 9.0}


@pytest.mark.parametrize(
    ("step", "line"),
    [
        ("supply: {}", "6:13  steps[0].supply: an output for test, load or both was expected"),
        ("supply: {test: on}", "6:20  steps[0].supply.test: 'on': a mapping with keys of voltage_V, current_A"),
        ("supply: {test: {current_A: 9}}", "6:20  steps[0].supply.test.voltage_V: is required and missing"),
        (
            "supply: {test: {voltage_mV: 8000, current_A: 9}}",
            "6:33  steps[0].supply.test.voltage_mV: 8000: unknown key; voltage_V was expected",
        ),
        (
            "supply: {test: {voltage_V: 8, current_A: 0}}",
            "6:46  steps[0].supply.test.current_A: 0: more than 0 was expected",
        ),
        (
            "supply: {test: {voltage_V: .inf, current_A: 9}}",
            "6:32  steps[0].supply.test.voltage_V: .inf: a finite number was expected",
        ),
        ("supply: {bench: off}", "6:21  steps[0].supply.bench: 'off': unknown key; one of test, load was expected"),
        (
            "mode: {test: current}",
            "6:18  steps[0].mode.test: 'current': in set-up heated a supply feeds the leads; off was expected",
        ),
    ],
)
def test_faults(step, line):
    with pytest.raises(InputError) as caught:
        read(protocol(step))
    assert len(caught.value.faults) == 1
    assert line in caught.value.faults[0]


@pytest.mark.parametrize("setup", ["free", "locked", "coupled"])
def test_leads_are_supplied_in_their_own_set_up_alone(setup):
    with pytest.raises(InputError, match=f"a supply feeds leads in set-up heated alone; setup is {setup}"):
        read(protocol(ON, setup=setup))


def test_a_quantity_that_nobody_knows_is_not_wanted():
    with pytest.raises(
        InputError, match=r"wants\[0\]: .*'temperature' is not in the vocabulary; known: ambient_temperature"
    ):
        read("wants: [temperature]\n" + protocol(ON))


@pytest.mark.parametrize("said", ["1", "'true'", "[true]", "maybe"])
def test_attended_is_true_or_false(said):
    with pytest.raises(InputError, match=r":\d+:\d+  attended: "):
        read(protocol(ON) + f"attended: {said}\n")


@pytest.mark.parametrize(("said", "attended"), [("attended: true\n", True), ("attended: false\n", False), ("", False)])
def test_a_run_is_attended_where_its_protocol_says_so(said, attended):
    assert read(protocol(ON) + said).attended is attended
