"""Planning: what protocols can and cannot reveal, by the model alone, and whether separating ones separate."""

import json

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from leactl.cli.main import app
from leactl.errors import InputError
from leactl.gap.planning.advice import read_noise
from leactl.gap.planning.records import planned_record, usual_noise
from leactl.gap.planning.separating import separating_experiment
from leactl.gap.planning.visible_sizes import evidence_of, sights
from leactl.model.nominal import as_mapping
from leactl.protocol import protocolfile, shipped
from leactl.vocabulary.effect import effect_definition, effect_names
from tests.gap.synthetic import model

SEPARATING = [name for name in shipped.names() if protocolfile.load(name).separates]
SLOW = "separate-heat"  # eleven seconds; the others take one to two


def seen_in(name, noise=None):
    plan, nominal = protocolfile.load(name), model()
    record = planned_record(plan, nominal, usual_noise() | (noise or {}))
    return {sight.effect: sight for sight in sights(evidence_of([record], nominal), [record.name])}


@pytest.fixture(scope="module")
def model_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "nominal.yaml"
    path.write_text(yaml.safe_dump(as_mapping(model())))
    return path


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long) if name == SLOW else name for name in SEPARATING]
)
def test_a_separating_protocol_tells_apart_what_it_says(name):
    found, named = seen_in(name), protocolfile.load(name).separates
    assert len(named) > 1
    for one in named:
        assert not set(found[one].alike) & set(named)
    # one that shows is told from one that does not, but two that do not show are not told apart
    assert sum(found[cause].smallest is None for cause in named) <= 1


def test_a_class_gets_the_protocol_that_separates_most_of_it():
    assert separating_experiment("time_skew", ["torque_sensor_lag"]) == "separate-sensor-timing"
    assert separating_experiment("third_thermal_node", ["ambient_drift"]) == "separate-heat"
    assert separating_experiment("stribeck", ["presliding", "friction_run_in"]) == "separate-slow-friction"
    assert separating_experiment("cogging", []) is None


def test_gains_that_only_a_reference_tells_apart_get_no_protocol():
    assert separating_experiment("torque_sensor_gain", ["current_sensor_gain"]) is None


def test_a_protocol_that_separates_an_unknown_effect_is_refused(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\nsetup: free\nrate_Hz: 50\nseparates: [gremlins]\nsteps: [{hold: {duration_s: 1}}]\n")
    with pytest.raises(InputError, match=r"mine.yaml:4:\d+ .*gremlins"):
        protocolfile.load(str(path))


def test_free_turning_hides_what_needs_a_shaft_that_carries_torque():
    result = seen_in("friction")
    assert result["torque_sensor_gain"].smallest is None
    assert result["load_dependent_friction"].smallest is None
    assert result["unbalance"].seen
    assert "current_sensor_offset" in result["asymmetric_friction"].alike


def test_a_locked_shaft_shows_no_drag_but_a_late_torque():
    result = seen_in("separate-sensor-timing")
    assert result["quadratic_drag"].smallest is None
    assert result["time_skew"].smallest is not None


@pytest.mark.long
def test_more_noise_hides_more():
    quiet, loud = (seen_in("friction", {"q_axis_current": noise}) for noise in (0.02, 2.0))
    assert loud["unbalance"].smallest > 3 * quiet["unbalance"].smallest
    assert quiet["unbalance"].seen
    assert not loud["unbalance"].seen


def test_a_quiet_sensor_does_not_show_what_sticking_friction_hides():
    """What the friction of a locked rotor leaves over has nothing to do with the sensor's noise."""
    usual, quiet = (seen_in("separate-sensor-timing", {"torque": noise}) for noise in (0.008, 0.0001))
    assert quiet["torque_sensor_hysteresis"].smallest > 0.5 * usual["torque_sensor_hysteresis"].smallest


def test_a_planned_record_moves_as_the_model_does():
    plan, nominal = protocolfile.load("friction"), model()
    record = planned_record(plan, nominal, {})
    clock = record.fast
    held = clock.time > 1.0
    current, speed = clock.values["q_axis_current_reference", "test"], clock.values["velocity", "test"]
    steady = held & (np.abs(np.gradient(speed, clock.interval)) < 1e-6) & (np.abs(speed) > 1.0)
    assert steady.any()
    expected = (0.49 * np.abs(current[steady]) - 0.208) / 0.0238
    np.testing.assert_allclose(np.abs(speed[steady]), expected, rtol=1e-3)


@pytest.fixture(scope="module")
def advised(model_file):
    """What the command says of two protocols beside every shipped one."""
    named = ["--protocol", "friction", "--protocol", "separate-drive-timing"]
    completed = CliRunner().invoke(app, ["gap", "plan", "--model", str(model_file), *named, "--json"])
    assert completed.exit_code == 0, completed.output
    return json.loads(completed.stdout)


@pytest.mark.long
def test_advice_names_what_stays_dark_and_what_would_help(advised):
    assert advised["format"] == "leactl-gap-plan"
    shown = {line["effect"] for line in advised["effects"] if line["shown"]}
    further = advised["experiments"]
    assert "unbalance" in shown
    assert not {"friction", "separate-drive-timing"} & {line["protocol"] for line in further}
    assert [line["gain_per_s"] for line in further] == sorted((line["gain_per_s"] for line in further), reverse=True)
    assert "torque_sensor_gain" in shown  # by the locked steps, of which the free run's voltage tells the torque
    assert any("load_dependent_friction" in line["shows"] for line in further)
    assert not [line["protocol"] for line in further if set(line["shows"]) & shown]
    helped = {effect for line in further for effect in line["shows"]}
    others = {name for name in effect_names() if "bench" in effect_definition(name).shown_on}
    others -= {"resistance_temperature", "gravity_load", "position_spring"}  # the model has the first, and no arm
    assert set(advised["not_shown"]) == others - shown - helped


@pytest.mark.long
def test_the_timing_of_drives_is_told_to_show_a_delay_worth_knowing(advised):
    delay = next(line for line in advised["effects"] if line["effect"] == "transport_delay")
    assert delay["shown"] is True
    assert delay["found_from"] <= delay["worth_knowing"]


def test_the_command_s_text_says_what_to_run(model_file, monkeypatch):
    monkeypatch.setattr(
        shipped, "names", lambda: ["friction", "separate-drive-timing"]
    )  # the others take half a minute
    text = CliRunner().invoke(app, ["gap", "plan", "--model", str(model_file), "--protocol", "friction"])
    assert text.exit_code == 0, text.output
    assert "leactl run separate-drive-timing" in text.stdout


def test_wrong_noise_is_told_by_item():
    with pytest.raises(InputError) as caught:
        read_noise(["tork=1", "torque=loud", "torque=-1", "torque=0.1"])
    assert len(caught.value.faults) == 3
    assert read_noise(["torque=0.1"]) == {"torque": 0.1}
