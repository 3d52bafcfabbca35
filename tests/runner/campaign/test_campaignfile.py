"""Campaign files: every fault with its place, variants, and the order of the runs."""

from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.analysis.heating.resistance import SHORTEST_BIN_S, shortest_on_time
from leactl.errors import InputError
from leactl.protocol.protocolfile import locate as protocol
from leactl.protocol.shipped import names as protocols
from leactl.runner.campaign.campaignfile import COMMANDS, load, names
from leactl.runner.campaign.entries import EntryOptions, entries_of, previews
from leactl.runner.campaign.order import DEFAULT_ORDER, Cell, arranged

HEAD = "name: small\nbench: emulated\nconditions: [a, b]\nactuators: [x, y]\n"
ONE = "steps:\n  - {name: one, protocol: friction}\n"


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "small.yaml"
        path.write_text(text)
        return str(path)

    return write


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ":1:1  a mapping with keys of name, title"),
        (HEAD, ":1:1  steps: is required and missing"),
        (HEAD + "steps: []\n", "5:8  steps: a list of 1 or more was expected"),
        (HEAD + ONE + "  - {name: one}\n", "7:12  steps[1].name: 'one' is the name of the step in line 6 too"),
        (HEAD + ONE.replace("friction", "friction, repeats: -2"), "steps[0].repeats: -2: "),
        (HEAD + ONE.replace("friction", "friction, repeats: 0"), "steps[0].repeats: 0: "),
        (HEAD + ONE.replace("friction", "friction, repeats: 1.5"), "steps[0].repeats: 1.5: a whole number"),
        (HEAD + ONE.replace("friction", "friction, repeat: 2"), "unknown key; repeats was expected"),
        (HEAD + ONE.replace("friction", "friction, set: {seed: 2}"), "steps[0].set.seed: the campaign has its own"),
        (HEAD + ONE.replace("friction", "friction, set: {a: {b: 1}}"), "steps[0].set.a: a number, a text or a list"),
        (HEAD.replace("[a, b]", "[a, b, a]") + ONE, "3:20  conditions[2]: 'a' stands twice"),
        (HEAD.replace("[x, y]", "[x/y]") + ONE, "actuators[0]: 'x/y': "),
        (HEAD + "order: [steps, repeats]\n" + ONE, "order: each of actuators, conditions, steps, repeats"),
        (HEAD + "shuffle: [days]\n" + ONE, "shuffle[0]: 'days': "),
        (HEAD + "seed: -1\n" + ONE, "seed: -1: "),
        (HEAD + ONE + "variants: {v: {two: {repeats: 2}}}\n", "variants.v.two: there is no such step; there are: one"),
        (HEAD + ONE.replace("friction", "friction, repeats: 1000").replace("}", ", conditions: [%s]}")
         % ", ".join(f"c{n}" for n in range(30)), "60000 runs; at most 10000 were expected"),
    ],
)  # fmt: skip
def test_a_fault_is_told_with_its_place(written, text, words):
    with pytest.raises(InputError) as refused:
        load(written(text))
    assert words in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


def test_unknown_campaigns_and_variants_are_answered_with_the_known_ones(written):
    with pytest.raises(
        InputError, match=r"campaign 'papr' is not known; known: laboratory, paper, or a path to a \.yaml"
    ):
        load("papr")
    with pytest.raises(InputError, match="variant 'long' is not known; known: short"):
        load("paper", "long")


def test_a_variant_goes_over_its_steps_key_by_key(written):
    text = HEAD + ONE.replace("friction", "friction, repeats: 3, set: {trials: 5, hold_s: 2}")
    text += "variants: {v: {one: {repeats: 1, conditions: [b], set: {trials: 1}}}}\n"
    step = load(written(text), "v").steps["one"]
    assert (step.repeats, tuple(step.conditions), step.actuators) == (1, ("b",), ("x", "y"))
    assert set(step.settings) == {"trials=1", "hold_s=2"}
    assert set(load(written(text)).steps["one"].settings) == {"trials=5", "hold_s=2"}


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (
            "  - {name: coast-down, set: {bogus: 4}}",
            "6:37  steps[0].set.bogus: no such parameter; known: speed_rad_s, ",
        ),
        (
            "  - {name: no-load-loss, set: {speeds_rad_s: [1, abc]}}",
            "6:46  steps[0].set.speeds_rad_s: [1, 'abc']: a list of finite numbers was expected, as in the default ",
        ),
        (
            "  - {name: friction, set: {hold_s: 20, trials: 1.5}}",
            "6:48  steps[0].set.trials: {}friction.yaml:26:14  steps[1].repeat.times: 1.5: a whole number was expected"
            " ($trials)",
        ),
        ("  - {name: friction}\n  - {name: nope}", "7:5  steps[1]: protocol 'nope' is not known; known: "),
        ("  - {name: friction, bench: nob}", "6:5  steps[0]: bench 'nob' is not known; known: "),
        (
            "  - {name: friction}\nvariants:\n  v: {friction: {set: {bogus: 3}}}",
            "8:31  variants.v.friction.set.bogus: no such parameter; known: ",
        ),
    ],
)
def test_a_fault_of_what_is_set_has_its_place_in_the_campaign(written, tmp_path, steps, words):
    text = HEAD.replace("[a, b]", "[design, loaded]") + "steps:\n" + steps + "\n"
    with pytest.raises(InputError) as refused:
        entries_of(load(written(text), "v" if "variants" in text else ""), EntryOptions(tmp_path / "out"))
    (fault,) = refused.value.faults
    folder = f"{protocol('friction').parent}/"
    assert fault.startswith(f"{tmp_path / 'small.yaml'}:{words.format(folder)}")
    assert "--set" not in fault


def test_a_fault_that_a_bench_finds_has_its_place_in_the_campaign(written, tmp_path, monkeypatch):
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path))
    text = HEAD.replace("[a, b]", "[design, desing]") + (
        "steps:\n"
        "  - {name: coast-down}\n"
        "  - {name: friction, conditions: [lodaed]}\n"
        "  - {name: torque-pulses, conditions: [design], set: {levels_A: [40]}}\n"
    )
    with pytest.raises(InputError) as refused:
        previews(entries_of(load(written(text)), EntryOptions(tmp_path / "out")))
    file = tmp_path / "small.yaml"
    known = "is not one of the emulated bench's: unloaded, design, loaded"
    assert sorted(refused.value.faults) == [
        f"{file}:3:22  conditions[1]: condition 'desing' {known}",
        f"{file}:7:35  steps[1].conditions[0]: condition 'lodaed' {known}",
        f"{file}:8:5  steps[2]: test q_axis_current_reference: 41.5 A is above the bench limit of 30 A",
    ]


def test_lists_and_texts_reach_a_protocol_as_they_are_written(written, tmp_path):
    (tmp_path / "own.yaml").write_text(
        "name: own\nsetup: free\nrate_Hz: 50\nparameters: {levels_A: [1], texts: ['a'], small: 0.5, count: 2}\n"
        "steps:\n  - hold: {duration_s: 1}\n"
    )
    text = HEAD.replace("[a, b]", "[design]") + (
        "steps:\n  - {name: one, protocol: own.yaml,"
        " set: {levels_A: [0.25, -1e-7], texts: ['b, c', \"it's\"], small: 1e-7, count: 3}}\n"
    )
    entries = entries_of(load(written(text)), EntryOptions(tmp_path / "out"))
    parameters = entries[0].request.plan.parameters
    assert parameters == {"levels_A": [0.25, -1e-7], "texts": ["b, c", "it's"], "small": 1e-7, "count": 3}


def test_the_usual_order_changes_what_is_dear_to_change_least_often(written):
    text = HEAD + ONE.replace("friction", "friction, repeats: 2") + "  - {name: two, conditions: [b]}\n"
    keys = [cell.key for cell in load(written(text)).cells]
    assert keys == [
        *("one/x/a/1", "one/x/a/2", "one/x/b/1", "one/x/b/2", "two/x/b/1"),
        *("one/y/a/1", "one/y/a/2", "one/y/b/1", "one/y/b/2", "two/y/b/1"),
    ]
    outer = load(written(text + "order: [steps, repeats, conditions, actuators]\n")).cells
    assert [cell.key for cell in outer][:5] == ["one/x/a/1", "one/y/a/1", "one/x/b/1", "one/y/b/1", "one/x/a/2"]


CELLS = st.lists(
    st.builds(Cell, st.sampled_from("pqr"), st.sampled_from("xy"), st.sampled_from("abc"), st.integers(1, 3)),
    unique=True,
    min_size=1,
)
WRITTEN = {"steps": "pqr", "actuators": "xy", "conditions": "abc", "repeats": (1, 2, 3)}


@given(
    cells=CELLS,
    order=st.permutations(DEFAULT_ORDER),
    shuffled=st.sets(st.sampled_from(DEFAULT_ORDER)),
    seed=st.integers(0, 99),
)
@settings(max_examples=60)
def test_an_order_holds_every_run_once_and_its_outer_levels_together(cells, order, shuffled, seed):
    result = arranged(cells, order, WRITTEN, shuffled, seed)
    assert Counter(result) == Counter(cells)
    assert result == arranged(cells[::-1], order, WRITTEN, shuffled, seed)
    outermost = [cell.at(order[0]) for cell in result]
    assert len([a for a, b in pairwise(outermost) if a != b]) == len(set(outermost)) - 1


def test_a_shuffled_level_takes_every_order_and_each_block_its_own():
    cells = [Cell("p", actuator, condition, 1) for actuator in "xy" for condition in "abc"]
    drawn = Counter()
    alike = 0
    for seed in range(600):
        result = "".join(cell.condition for cell in arranged(cells, DEFAULT_ORDER, WRITTEN, {"conditions"}, seed))
        drawn[result[:3]] += 1
        alike += result[:3] == result[3:]
    assert len(drawn) == 6
    assert all(60 <= times <= 145 for times in drawn.values())  # 100 +- 9
    assert 60 <= alike <= 145


def test_adding_a_run_leaves_the_shuffled_order_of_the_others():
    cells = [Cell("p", "x", condition, 1) for condition in "abcdefg"]
    written = WRITTEN | {"conditions": "abcdefgh"}
    before = arranged(cells, DEFAULT_ORDER, written, {"conditions"}, 5)
    after = arranged([*cells, Cell("p", "x", "h", 1)], DEFAULT_ORDER, written, {"conditions"}, 5)
    assert [cell for cell in after if cell.condition != "h"] == before


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] if name == "paper" else []) for name in names()]
)
def test_a_shipped_campaign_is_whole_and_every_run_of_it_may_be_made(name, tmp_path, monkeypatch):
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path))
    assert name not in COMMANDS
    whole = load(name)
    assert {step.protocol for step in whole.steps.values()} <= set(protocols())
    for variant in ("", "short"):
        entries = entries_of(load(name, variant), EntryOptions(tmp_path / "out"))
        each = list({entry.cell.step: entry for entry in entries}.values())  # windings forget the preload
        assert len(previews(each)) == len(each)


@pytest.mark.parametrize("variant", ["", "short"])
def test_the_heated_record_of_the_paper_is_long_enough_to_tell_the_resistance(variant):
    told = dict(setting.split("=") for setting in load("paper", variant).steps["thermal"].settings)
    assert float(told.get("heating_s", "inf")) > 1.2 * shortest_on_time(SHORTEST_BIN_S)
