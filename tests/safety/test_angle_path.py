"""Where the setpoints of angle mode have led: to what was asked for once the drive follows, to the shaft until then."""

import math

from hypothesis import given
from hypothesis import strategies as st

from leactl.safety.angle_path import AnglePath

ANGLES = st.floats(-100.0, 100.0)


def test_what_was_asked_for_before_the_drive_followed_has_led_nowhere():
    path = AnglePath(1.0, 0.0)
    path.ask(2.0, 0.1)
    path.update(1.05, engaged=True, now=0.2)
    assert (path.base_angle, path.base_time) == (1.0, 0.2)


def test_what_was_asked_for_while_the_drive_followed_counts_from_when_it_was():
    path = AnglePath(1.0, 0.0)
    path.update(1.0, engaged=True, now=0.1)
    path.ask(1.1, 0.15)
    path.ask(1.2, 0.16)
    path.update(1.0, engaged=True, now=0.2)
    assert (path.base_angle, path.base_time) == (1.2, 0.16)
    path.update(1.0, engaged=True, now=0.3)  # nothing was asked for since
    assert (path.base_angle, path.base_time) == (1.2, 0.3)


@given(ANGLES, ANGLES, ANGLES)
def test_a_drive_that_has_let_go_begins_again_where_the_shaft_is(asked, measured, again):
    path = AnglePath(0.0, 0.0)
    path.update(0.0, engaged=True, now=0.1)
    path.ask(asked, 0.15)
    path.update(measured, engaged=False, now=0.2)
    assert (path.base_angle, path.base_time) == (measured, 0.2)
    path.ask(again, 0.25)
    path.update(measured, engaged=True, now=0.3)  # it was not engaged when that was asked for
    assert (path.base_angle, path.base_time) == (measured, 0.3)


def test_an_angle_that_is_not_known_keeps_the_last_one_that_is():
    path = AnglePath(math.nan, 0.0)
    path.update(math.nan, engaged=True, now=0.1)
    assert math.isnan(path.base_angle)
    path.update(0.5, engaged=True, now=0.2)
    assert path.base_angle == 0.5
    path.update(math.nan, engaged=False, now=0.3)
    assert (path.base_angle, path.base_time) == (0.5, 0.3)
