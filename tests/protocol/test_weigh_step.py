"""Dead weights in a protocol: what the operator is asked for, and what the holds tell."""

import pytest

from leactl.errors import InputError
from leactl.protocol.plan import Hang, Segment

from .writing import plan


def test_weights_rise_and_fall_with_none_at_both_ends():
    result = plan(
        "weigh: {masses_kg: [2, 1], arm_m: 0.5, hold_s: 5, settle_s: 2, repeats: 2, sign: -1}", mode="{test: off}"
    )
    hung = [action for action in result.actions if isinstance(action, Hang)]
    holds = [action for action in result.actions if isinstance(action, Segment)]
    assert [hold.parameters["mass_kg"] for hold in holds] == [0, 1, 2, 1, 0] * 2
    assert [hold.parameters["direction"] for hold in holds[:5]] == ["rising"] * 3 + ["falling"] * 2
    assert [hold.parameters["repeat"] for hold in holds] == [1] * 5 + [2] * 5
    assert [action.torque for action in hung[:5]] == pytest.approx([0, -4.903325, -9.80665, -4.903325, 0])
    assert all(hold.parameters["weight_Nm"] == action.torque for hold, action in zip(holds, hung, strict=True))
    assert "2 kg at 0.5 m, pulling in the negative sense" in hung[2].text
    assert hung[0].text == "Take all weights off the arm"
    assert {(hold.duration_s, hold.settle_s) for hold in holds} == {(5, 2)}
    assert result.timeline()[1].name == "weigh"


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (["weigh: {masses_kg: [1, 0], arm_m: 0.5, hold_s: 5}"], "masses_kg"),
        (["weigh: {masses_kg: [], arm_m: 0.5, hold_s: 5}"], "a list of 1 or more was expected"),
        (["weigh: {masses_kg: [1], arm_m: -0.5, hold_s: 5}"], "arm_m"),
        (["weigh: {masses_kg: [1], arm_m: 0.5, hold_s: 5, settle_s: 5}"], "leaves nothing of 5 s"),
        (
            ["mode: {test: current}", "weigh: {masses_kg: [1], arm_m: 0.5, hold_s: 5}"],
            "test engaged while a person is at the shaft; off was expected",
        ),
    ],
)
def test_weights_that_cannot_be_hung_are_refused(steps, words):
    with pytest.raises(InputError, match=words):
        plan(*steps, mode="{test: off}")
