"""An ambient that is logged warmer or colder than it is: told by calibration, and in the model that comes of it."""

from dataclasses import replace

import numpy as np
import pytest

from leactl.gap.diagnosis import CalibratedParameter
from leactl.gap.replay import replay
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.parameters import calibrated_parameters, is_at_bound, with_calibration
from leactl.model.nominal import LARGEST_AMBIENT_OFFSET
from tests.gap.synthetic import model, record

OFFSET = -2.0  # K
WARM = ("winding_temperature", "housing_temperature")


@pytest.fixture(scope="module")
def heated():
    """A winding that is heated and cools, at an ambient that is colder than the logged one, and a camera's noise."""
    current = np.where(np.arange(2000) < 1000, 5.0, 0.0)
    slow = {("line_current", "test"): current, ("line_voltage", "test"): 0.0}
    run = record("heated", seconds=4000.0, camera_s=2.0, slow=slow)
    job = replay(run, model(ambient_offset=OFFSET))
    noise = np.random.default_rng(1)
    values = run.slow.values | {("line_voltage", "test"): job.slow["line_voltage", "test"]}
    for name in WARM:
        values[name, "test"] = job.slow[name, "test"] + 0.05 * noise.standard_normal(2000)
    return replace(run, slow=replace(run.slow, values=values))


def told(run, nominal):
    evidence = Evidence([run], nominal, only=[])
    parameters = calibrated_parameters(evidence, evidence.settle([]))
    return next(item for item in parameters if item.parameter == "ambient_offset"), parameters


@pytest.mark.parametrize("believed", [0.0, OFFSET])
def test_calibration_tells_the_offset_whatever_the_model_has(heated, believed):
    offset, _ = told(heated, model(ambient_offset=believed))
    assert offset.nominal == believed
    assert offset.fitted == pytest.approx(OFFSET, abs=0.05)


def test_the_calibrated_model_has_the_offset_and_follows_the_run(heated):
    _, parameters = told(heated, model())
    after = with_calibration(model(), parameters)
    assert after.ambient_offset == pytest.approx(OFFSET, abs=0.05)

    def distance(whose):
        return max(np.std(heated.slow.values[name, "test"] - replay(heated, whose).slow[name, "test"]) for name in WARM)

    assert distance(after) < 0.1 < 0.3 < distance(model())


def test_an_offset_that_no_ambient_has_is_at_its_bound(heated):
    farther = {("ambient_temperature", "bench"): heated.slow.values["ambient_temperature", "bench"] + 60.0}
    away = replace(heated, slow=replace(heated.slow, values=heated.slow.values | farther))
    offset, parameters = told(away, model())
    assert offset.fitted == -LARGEST_AMBIENT_OFFSET
    assert is_at_bound(offset)
    assert with_calibration(model(), parameters).ambient_offset == -LARGEST_AMBIENT_OFFSET
    assert not is_at_bound(CalibratedParameter("ambient_offset", 0.0, OFFSET, 0.1, "K"))
