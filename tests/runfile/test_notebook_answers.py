"""What a run, a channel and the end of a run show of themselves in a notebook: a frame with all that counts."""

import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import leactl
from leactl.driver.contract import Confirmation
from leactl.interface import NotebookChannel
from leactl.runfile.read.reader import Run


def shown(answer):
    """The page inside the frame, with its tags."""
    frame = answer._repr_html_()
    assert re.fullmatch(r'<iframe srcdoc="[^"]*" sandbox="" width="100%" height="560"></iframe>', frame)
    return unescape(frame.partition('srcdoc="')[2].partition('" sandbox')[0])


def rows(page):
    cells = re.findall(r"<tr>(.*?)</tr>", page, re.DOTALL)
    return [[unescape(cell) for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row)] for row in cells]


def test_a_run_shows_its_channels_also_when_it_is_closed(complete):
    with leactl.open_run(complete) as run:
        open_page = shown(run)
    page = shown(run)
    assert page == open_page
    assert f"<h1>Run {complete.name}</h1>" in page
    assert "complete" in re.search(r'<p class="about">(.*?)</p>', page)[1]
    told = {row[0]: row[1:] for row in rows(page)[1:]}
    specs = {f"{stream}/{spec.name}": (stream, spec) for stream, specs in run.streams.items() for spec in specs}
    assert told.keys() == specs.keys()
    for name, (quantity, role, location, units, samples) in told.items():
        stream, spec = specs[name]
        assert (quantity.replace(" ", "_").lower(), role, location) == (spec.quantity, spec.role, spec.location)
        assert units.replace("·", "*").replace("°C", "degC") == ("" if spec.units == "1" else spec.units)
        assert int(samples) == run.rows[stream]


def test_a_run_from_python_is_that_of_the_reader_with_the_same_channels(complete):
    with leactl.open_run(complete) as run, Run.open(complete) as plain:
        assert isinstance(run, leactl.Run)
        channel = run["q_axis_current"]
        assert isinstance(channel, leactl.Channel)
        assert "<h1>q axis current of test</h1>" in shown(channel)
        np.testing.assert_array_equal(channel.values, plain["q_axis_current"].values)
        assert repr(run) == repr(plain)
        assert repr(channel) == repr(plain["q_axis_current"])


def channel(values, quantity="torque"):
    time = 0.001 * np.arange(len(values))
    return NotebookChannel(time, np.asarray(values, float), quantity, "test", "N*m", "sensor", "", "", "", "loop")


def test_a_channel_shows_its_curve_and_how_many_samples_stand_at_a_point():
    few, many = shown(channel(np.sin(np.arange(500)))), shown(channel(np.sin(np.arange(50_000))))
    for page, samples in ((few, 500), (many, 50_000)):
        assert "<h1>torque of test</h1>" in page
        assert f"sensor, {samples} samples" in page
        assert "torque [N·m]" in page
        assert page.count('class="curve reading"') == 1
    assert "the range of about 50 samples at each point" in many
    assert "at each point" not in few
    assert len(many) < 150_000
    assert 'class="curve setpoint"' in shown(channel([1.0, 2.0], "q_axis_current_reference"))


@pytest.mark.parametrize("values", [[], [1.0], [np.nan, np.nan], [np.nan, 2.0, np.inf]])
def test_a_channel_with_hardly_a_value_shows_itself_too(values):
    assert f"{len(values)} samples" in shown(channel(values))


def test_the_end_of_a_run_shows_limits_safe_state_and_notes():
    limits = (
        {"result": "r_squared", "value": 0.98765432, "units": "1", "met": False},
        {"channel": "velocity", "role": "test", "step": "hold", "statistic": "mean", "value": None, "units": "rad/s"}
        | {"met": True},
    )
    done = leactl.Performed(
        Path("runs/a.h5"),
        "tripped",
        "<b>too fast</b>",
        12.34,
        {"drive_test": Confirmation(True, "off"), "supply": Confirmation(False, "no answer")},
        limits,
        ("acceptance: r_squared is 0.988",),
    )
    page = shown(done)
    assert "<h1>Run a.h5</h1>" in page
    assert '<p class="about">tripped, &lt;b&gt;too fast&lt;/b&gt;, 12.3 s of bench time</p>' in page
    assert rows(page) == [
        ["limit on", "value", "units", "met"],
        ["r squared", "0.987654", "", "no"],
        ["mean velocity test hold", "", "rad/s", "yes"],
        ["device", "confirmed", "what it answered"],
        ["drive_test", "yes", "off"],
        ["supply", "no", "no answer"],
    ]
    assert "<li>acceptance: r_squared is 0.988</li>" in page


def test_a_run_that_was_performed_is_opened_as_one_that_shows_itself(complete):
    done = leactl.Performed(complete, "complete", "", 1.0, {}, ())
    with done.open() as run:
        assert complete.name in shown(run)
    assert "<table>" not in shown(done)
