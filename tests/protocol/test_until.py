"""Holds that end by a criterion: what is refused, and what the plan says of their bounds."""

import pytest
from typer.testing import CliRunner

from leactl.cli.main import app
from leactl.errors import InputError
from tests.protocol.writing import plan, segments, text

UNTIL = "{quantity: velocity, role: test, statistic: mean, window_s: 0.5, above: 2, unit: rad/s}"


def hold(until=UNTIL, duration=5):
    return f"hold: {{role: test, current_A: 1, duration_s: {duration}, settle_s: 0.2, until: {until}}}"


def test_the_plan_counts_the_longest():
    expanded = plan(hold(), "hold: {duration_s: 1}")
    assert expanded.duration_s == 6.0
    assert expanded.adaptive
    assert segments(expanded)[0].until.low == 2.0


def test_the_timeline_tells_bounds_and_criterion(tmp_path):
    path = tmp_path / "trial.yaml"
    path.write_text(text(hold()))
    shown = CliRunner().invoke(app, ["protocol", "plan", str(path)])
    assert "at most 5 s, until mean of test velocity over 0.5 s in 2 .. inf rad/s" in shown.output
    assert "duration at most" in shown.output


@pytest.mark.parametrize(
    ("step", "message"),
    [
        (hold(UNTIL.replace("rad/s}", "rpm}")), "until.unit: 'rpm': velocity is in rad/s"),
        (hold(UNTIL.replace("mean", "slope")), "until.unit: 'rad/s': velocity is in rad/s/s"),
        (hold(UNTIL.replace("above: 2, ", "")), "until.below: below, above or both were expected"),
        (hold(UNTIL.replace("velocity", "speed")), "until.quantity: 'speed': one of"),
        (hold(duration=0.6), "until.window_s: settle_s and a window of 0.5 s are longer than duration_s"),
        (hold(UNTIL.replace("above: 2", "above: 2, below: 1")), "until.below: no value is below 1 and above 2"),
    ],
)
def test_what_cannot_be_is_refused_at_its_key(step, message):
    with pytest.raises(InputError) as error:
        plan(step)
    assert message in str(error.value)
