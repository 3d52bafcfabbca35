"""What is left beside an effect decides whether it may be named; what bridges a gap in a record is no measurement."""

import numpy as np
import pytest

from leactl.gap.diagnose import diagnose
from leactl.gap.signals.record import LONG_GAP, SMOOTHING_REACH, without_edges
from leactl.model.nominal import Model
from tests.gap.joints import Log, case, drawn_joint


def test_a_small_effect_beside_a_large_rest_is_not_named():
    """A model without Coulomb friction and without the drive's velocity filter: the filter's lag is a trifle."""
    random = np.random.default_rng(3)
    given = case(drawn_joint(random), Log(), random)
    poor = given.model.model_dump(exclude_none=True)
    del poor["coulomb_friction"], poor["bench"]["velocity_filter_bandwidth"]
    given.model = Model(**poor)
    diagnosis = diagnose(given)
    assert diagnosis.verdict == "unknown"
    assert [cause.effect for cause in diagnosis.causes if cause.probability >= 0.5] == []
    assert any("too much is left beside what it explains" in note for note in diagnosis.notes)


@pytest.mark.long
def test_a_dead_channel_is_the_answer_and_divides_nothing_by_zero():
    random = np.random.default_rng(4)
    given = case(drawn_joint(random), Log(), random)
    for record in [*given.fitted, *given.held_out]:
        record.fast.values["velocity", "test"][:] = 0.0
    assert [cause.effect for cause in diagnose(given).causes if cause.probability >= 0.5] == ["frozen_channel"]


def test_samples_beside_a_long_gap_are_left_out_and_those_beside_a_short_one_stay():
    valid = np.ones(200, bool)
    valid[50 : 50 + LONG_GAP] = valid[120 : 119 + LONG_GAP] = False
    kept = without_edges(valid)
    assert not kept[50 - SMOOTHING_REACH : 50 + LONG_GAP + SMOOTHING_REACH].any()
    assert kept[50 - SMOOTHING_REACH - 1] and kept[50 + LONG_GAP + SMOOTHING_REACH]
    assert kept[119] and kept[119 + LONG_GAP]
