"""The twist of a shaft: its stiffness does not depend on what the torque that twists it is worked out from."""

import json

import pytest

from leactl.gap.diagnose import read_case
from leactl.gap.null import measure, set_floors
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.parameters import calibrated_parameters

STIFFNESS = "bench.shaft_stiffness"


@pytest.fixture(scope="module")
def case(sound_bench):
    return read_case(
        sorted(sound_bench.glob("*-a.h5")), sorted(sound_bench.glob("*-b.h5")), sound_bench / "nominal.yaml"
    )


def fitted(records, model):
    evidence = Evidence(records, model, only=[])
    return {item.parameter: item for item in calibrated_parameters(evidence, evidence.settle([]))}


def off_by(model, **factors):
    return model.model_copy(update={name: getattr(model, name) * factor for name, factor in factors.items()})


@pytest.mark.parametrize("run", ["coupled", "locked"])
def test_a_nominal_torque_constant_that_is_off_is_no_softer_shaft(case, run):
    records = [record for record in case.fitted if record.mechanical in (run, "free")]
    right = fitted(records, case.model)
    wrong = fitted(records, off_by(case.model, torque_constant=1.08, back_emf_constant=1.08))
    assert wrong["torque_constant"].fitted == pytest.approx(right["torque_constant"].fitted, rel=1e-3)
    assert wrong[STIFFNESS].fitted == pytest.approx(right[STIFFNESS].fitted, rel=0.01)


def test_a_nominal_inertia_that_is_off_is_no_other_shaft(case):
    records = [record for record in case.fitted if record.mechanical in ("coupled", "free")]
    right, wrong = (fitted(records, model) for model in (case.model, off_by(case.model, rotor_inertia=1.5)))
    assert wrong[STIFFNESS].fitted == pytest.approx(right[STIFFNESS].fitted, rel=0.01)


@pytest.mark.long
def test_what_is_told_of_a_bench_lies_within_its_errors(case, sound_cases):
    """Also where simulated sound machines correct the fit: they must err as the bench does."""
    evidence = Evidence(case.fitted, case.model)
    set_floors(evidence, measure(case.fitted, case.model))
    (entry,) = json.loads((sound_cases.key / "key.json").read_text())["cases"].values()
    truth = entry["true_base"]
    for item in calibrated_parameters(evidence, evidence.settle([])):
        if item.parameter in truth:
            assert abs(item.fitted - truth[item.parameter]) < 3.0 * item.std, item.parameter
