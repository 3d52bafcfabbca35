"""What holds for every protocol: setpoints stay within what the file says, and nothing but an InputError comes out."""

import itertools
import math
from pathlib import Path

import pytest
import yaml as pyyaml
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl import yamlfile
from leactl.errors import InputError
from leactl.protocol.plan import Plan, Ramp, Samples, Segment
from leactl.protocol.protocolfile import expand_document
from leactl.protocol.signals import SIGNALS
from leactl.protocol.steps import KINDS
from tests.protocol.writing import plan, read, segments, text

numbers = st.floats(-50, 50).map(lambda value: round(value, 3))
lists = st.lists(numbers, min_size=1, max_size=6)


@st.composite
def sweeps(draw):
    return {
        "role": "test",
        "levels_A": draw(lists),
        "hold_s": draw(st.floats(0.5, 20)),
        "visit": draw(st.sampled_from(["up", "down", "both", "as_given"])),
        "repeats": draw(st.integers(1, 4)),
        "sign": draw(st.sampled_from([1, -1])),
        **draw(
            st.fixed_dictionaries(
                {},
                optional={
                    "overshoot_A": st.floats(0, 5),
                    "rate_A_s": st.floats(0.5, 100),
                    "pause_s": st.floats(0, 100),
                    "settle_s": st.floats(0, 0.4),
                },
            )
        ),
    }


def written(step):
    return pyyaml.safe_dump(step, default_flow_style=True, width=1_000_000).strip()


@given(sweeps(), numbers)
def test_a_sweep_stays_within_its_levels_and_overshoot(sweep, start):
    result = plan(f"set: {{role: test, current_A: {start}}}", f"sweep: {written(sweep)}")
    overshoot = sweep.get("overshoot_A", 0.0)
    meant = [level * sweep["sign"] for level in sweep["levels_A"]]
    low, high = min(*meant, start, 0.0) - overshoot, max(*meant, start, 0.0) + overshoot
    for segment in segments(result):
        profile = segment.setpoints["test"]
        assert low <= profile.low <= profile.high <= high
        if segment.name == "hold":
            assert profile.low in meant
            assert segment.parameters["current_A"] == profile.low
            assert segment.duration_s == sweep["hold_s"]
    assert result.peaks()["test", "q_axis_current_reference"] <= max(abs(low), abs(high))


@given(sweeps())
def test_every_level_is_held_in_every_repeat(sweep):
    result = plan(f"sweep: {written(sweep)}")
    held = [s.setpoints["test"].low for s in segments(result) if s.name == "hold"]
    passes = 2 if sweep["visit"] == "both" else 1
    whole = sorted([level * sweep["sign"] for level in sweep["levels_A"]] * passes * sweep["repeats"])
    if passes == 2 and not sweep.get("overshoot_A"):
        for _ in range(sweep["repeats"]):
            whole.remove(max(sweep["levels_A"]) * sweep["sign"])
    assert sorted(held) == whole


@given(sweeps())
def test_setpoints_join_and_ramps_keep_their_rate(sweep):
    steps = [s for s in segments(plan(f"sweep: {written(sweep)}")) if s.name != "set"]
    before = 0.0
    for segment in steps:
        profile = segment.setpoints["test"]
        if isinstance(profile, Ramp):
            assert profile.start == before
            reached = sweep["rate_A_s"] * segment.duration_s * (1 + 1e-9)
            assert abs(profile.stop - profile.start) <= reached + 1e-300  # 5e-324 A take 0.0 s at any rate
        elif sweep.get("rate_A_s"):
            assert profile.low == before
        before = profile.at(segment.duration_s)


@given(sweeps())
def test_directions_are_those_of_the_setpoints(sweep):
    before = 0.0
    for segment in segments(plan(f"sweep: {written(sweep)}")):
        profile = segment.setpoints["test"]
        if segment.name == "hold" and not sweep.get("rate_A_s") and profile.low != before:
            assert segment.parameters["direction"] == ("rising" if profile.low > before else "falling")
        before = profile.at(segment.duration_s)


@given(st.lists(lists, min_size=2, max_size=2), st.integers(1, 3), st.floats(0, 5))
def test_a_grid_holds_every_combination_in_every_repeat(levels, repeats, rest):
    result = plan(
        f"grid: {{axes: [{{role: load, levels_rad_s: {levels[0]}}}, {{role: test, levels_A: {levels[1]}}}],"
        f" hold_s: 1, rest_s: {rest}, repeats: {repeats}}}"
    )
    held = [(s.setpoints["load"].low, s.setpoints["test"].low) for s in segments(result) if s.name == "hold"]
    assert held == list(itertools.product(*levels)) * repeats


@given(st.lists(sweeps(), min_size=1, max_size=3), st.integers(1, 3))
def test_the_timeline_has_no_gaps(several, times):
    inner = ", ".join(f"{{sweep: {written(sweep)}}}" for sweep in several)
    result = plan("tare: {samples: 3}", f"repeat: {{times: {times}, steps: [{inner}, {{prompt: Look}}]}}")
    rows = result.timeline()
    assert len(rows) == len(result.actions)
    assert rows[0].start_s == 0
    for row, following in itertools.pairwise(rows):
        assert following.start_s == pytest.approx(row.start_s + row.duration_s, abs=1e-9)
    assert rows[-1].start_s + rows[-1].duration_s == pytest.approx(result.duration_s)
    assert result.duration_s == pytest.approx(math.fsum(s.duration_s for s in segments(result)) + 3 / result.rate_Hz)


@given(lists, st.floats(0.5, 20), st.integers(1, 4), st.sampled_from(["up", "down", "both"]))
def test_an_override_equals_the_same_value_in_the_file(levels, hold, repeats, visit):
    step = "sweep: {role: test, levels_A: $levels_A, hold_s: $hold_s, repeats: $repeats, visit: $visit}"

    def source(values):
        return text(step, parameters=written(values))

    wanted = {"levels_A": levels, "hold_s": hold, "repeats": repeats, "visit": visit}
    over = read(source({"levels_A": [1.0], "hold_s": 1, "repeats": 1, "visit": "as_given"}), **{
        name: written(value).removesuffix("\n...") for name, value in wanted.items()
    })  # fmt: skip
    plain = read(source(wanted))
    assert (over.actions, over.parameters) == (plain.actions, plain.parameters)


@given(numbers, numbers, st.floats(0, 100), st.floats(-10, 200))
def test_a_ramp_stays_between_its_ends(start, stop, duration, time):
    ramp = Ramp(start, stop, duration)
    assert ramp.low <= ramp.at(time) <= ramp.high
    assert ramp.at(duration) == stop


keys = sorted({key for kind in (*KINDS.values(), *SIGNALS.values()) for key in getattr(kind._type, "model_fields", ())})
words = ["test", "load", "up", "both", "sine", "noise", "csv", "multisine", "chirp", "step", "log", "random", "current"]
words += ["angle", "velocity", "off", "rad/s", "$a", "$b", "$c", "trial.csv", "", "\n", "\u2028", "1e3"]
leaves = (
    st.sampled_from([0, 1, -1, 2, 3, 0.5, 10, 1e6, 1e9, 10**30, -0.0, True, None])
    | st.sampled_from(words)
    | st.text(max_size=4)
)
junk = st.recursive(
    leaves,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(keys), inner, max_size=6),
    max_leaves=8,
)
anything = st.dictionaries(st.sampled_from([*KINDS, "signal"]), junk, min_size=1, max_size=1)


FIT = {
    "test": "velocity", "load": "off", "role": "test", "kind": "", "name": "start", "visit": "both", "sign": -1,
    "axes": [{"role": "load", "levels_rad": [0, 1]}, {"role": "test", "levels_A": [1, 2]}],
    "quantity": "velocity", "unit": "rad/s", "below": 3, "above": -3, "timeout_s": 5, "samples": 3, "rate_Hz": 25,
    "times": 2, "steps": [{"hold": {"duration_s": 1}}], "repeats": 2, "count": 3, "order": 4, "seed": 1,
    "frequencies_Hz": [1, 2], "phases": "random", "spacing": "log", "path": "nowhere.csv", "column": "knee_current_A",
    "at_s": 0.5, "settle_s": 0.25,
}  # fmt: skip


@st.composite
def likely(draw):
    """A step that fits its kind but for a key or two, so that faults of every depth are met, and plans too."""
    kind = draw(st.sampled_from([*KINDS, "signal"]))
    signal = draw(st.sampled_from(sorted(SIGNALS)))
    fields = (SIGNALS[signal] if kind == "signal" else KINDS[kind])._type
    if not hasattr(fields, "model_fields"):
        return {kind: "Look"}
    content = {}
    for key, field in fields.model_fields.items():
        strange = key.endswith(("rad_s", "rad_s2", "_rad"))  # the test role is in current mode
        if field.is_required() or draw(st.integers(0, 9)) < (1 if strange else 5):
            content[key] = FIT.get(key, [1, 2, 4] if key.startswith("levels") else 1)
    if kind == "signal":
        content["kind"] = signal
    for key in draw(st.lists(st.sampled_from(sorted(content) or ["x"]), max_size=1)):
        content[key] = draw(junk)
    return {kind: content}


@settings(max_examples=400)
@given(
    st.lists(st.one_of(likely(), likely(), anything), max_size=4),
    st.one_of(
        st.just({"a": 1, "b": "test", "c": [1, 2]}),
        st.dictionaries(st.sampled_from(["a", "b", "A", ""]), leaves | st.lists(leaves, max_size=3), max_size=3),
        leaves,
    ),
    st.none() | st.just({"hot": {"a": 2}}) | st.dictionaries(st.sampled_from(["hot", ""]), junk, max_size=2) | leaves,
    st.dictionaries(
        st.sampled_from(["a", "b", "x"]), st.sampled_from(["1", "[1]", "[", "$a", "", "[[1]]", "x"]), max_size=2
    ),
)
def test_whatever_stands_in_a_file_is_a_plan_or_an_input_error(steps, parameters, conditions, overrides):
    head = {"name": "a", "setup": "free", "rate_Hz": 50, "parameters": parameters, "conditions": conditions}
    source = pyyaml.safe_dump({**head, "steps": [{"mode": {"test": "current", "load": "angle"}}, *steps]})
    try:
        result = expand_document(yamlfile.parse(source, "a.yaml"), Path("/nowhere"), overrides, "hot")
    except InputError as error:
        assert error.faults
        assert all(len(fault.splitlines()) == 1 for fault in error.faults)
        assert len(set(error.faults)) == len(error.faults)
    else:
        assert isinstance(result, Plan)
        for segment in segments(result):
            assert isinstance(segment, Segment)
            assert math.isfinite(segment.duration_s)
            assert segment.duration_s > segment.settle_s or segment.duration_s == segment.settle_s == 0
            for profile in segment.setpoints.values():
                assert math.isfinite(profile.low)
                assert math.isfinite(profile.high)
                assert not isinstance(profile, Samples) or profile.values.size


@settings(max_examples=200)
@given(st.text(max_size=200) | st.text("nam:e{}[]-$&*!|>\n 1", max_size=60))
def test_any_text_is_a_plan_or_an_input_error(source):
    try:
        read(source)
    except InputError as error:
        assert error.faults
