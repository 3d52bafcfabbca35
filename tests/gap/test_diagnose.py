"""The whole diagnosis on benches of the emulated plant, whose effects the library shares no equation with."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from leactl.emulation.blind.make import make
from leactl.emulation.plant.effects_outside_library import unlisted_effects
from leactl.errors import InputError
from leactl.gap.diagnose import Case, diagnose, hold_out_runs, read_case
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.ringing import highest_lines
from leactl.gap.signals.record import build_record
from leactl.gap.verdict.notes import reading_notes
from leactl.runfile.read.reader import Channel
from leactl.vocabulary.effect import effect_definition
from tests.gap.emulated_cases import EVERY, OFTEN, SEED, emulated_cases

DEPENDS = {  # of what no effect explains and acts at all times, on what it is seen to depend
    "current_eddy_drag": {"velocity", "q_axis_current"},
    "speed_weakened_torque": {"velocity", "q_axis_current"},
    "friction_bursts": set(),
    "loose_terminal": set(),
}
PRACTICE = Path(__file__).parents[3] / "shared" / "gap-cases" / "practice"


def drawn(folder, kind, seed, count, effects=None):
    made = SimpleNamespace(cases=folder / "cases", key=folder / "key")
    make(count, made.cases, made.key, seed, (kind,), effects, strengths=("plain",), prefix=kind)
    return made


@pytest.fixture(scope="session")
def benches(tmp_path_factory):
    return emulated_cases(tmp_path_factory, "unknown")


@pytest.fixture(scope="session")
def every_unlisted(tmp_path_factory):
    return keyed(drawn(tmp_path_factory.mktemp("unlisted"), "unknown", SEED, len(unlisted_effects())), "unlisted")


def answer(folder):
    runs = sorted(folder.glob("*.h5"))
    return diagnose(read_case([r for r in runs if "-a" in r.name], [r for r in runs if "-b" in r.name], model(folder)))


def model(folder):
    return folder / "nominal.yaml"


def folders(made):
    return sorted(path for path in made.cases.iterdir() if path.is_dir())


def test_nothing_but_wrong_parameters_is_called_calibration(sound_bench):
    result = answer(sound_bench)
    assert result.verdict == "calibration"
    assert not result.causes
    assert result.unexplained_probability < 0.2


TOO_FEW = pytest.mark.xfail(
    strict=True, reason="its picture: three held-out stretches at either sense, whose interval holds zero in every bin"
)
HIDDEN = ("backlash", "emissivity_bias")
"""What a replay hardly shows: a shaft in its play, and a camera whose fraction calibration has taken already."""


def entries(made):
    return json.loads((made.key / "key.json").read_text(encoding="utf-8"))["cases"]


def keyed(made, field):
    """The case of each effect."""
    return {entry[field][0]: made.cases / name for name, entry in entries(made).items()}


@pytest.fixture(scope="session")
def with_effect(tmp_path_factory):
    return keyed(emulated_cases(tmp_path_factory, "single"), "effects")


@pytest.fixture(scope="session")
def with_every_effect(tmp_path_factory):
    return keyed(drawn(tmp_path_factory.mktemp("every"), "single", 13, len(EVERY), EVERY), "effects")


@pytest.mark.parametrize("name", OFTEN)
def test_an_effect_of_the_emulated_bench_is_named_first_and_its_gap_closed(with_effect, name):
    is_named_first(with_effect[name], name)


@pytest.mark.long
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=TOO_FEW if name == "power_foldback" else ()) for name in EVERY]
)
def test_each_effect_of_the_emulated_bench_is_named_first_and_its_gap_closed(with_every_effect, name):
    is_named_first(with_every_effect[name], name)


def is_named_first(folder, name):
    result = answer(folder)
    first = result.causes[0]
    assert result.verdict == "effect"
    assert name in (first.effect, *first.indistinguishable_from)
    assert first.probability > 0.5
    for cause in result.causes:
        if cause.probability > 0.5:  # what cannot be told from the first has a picture of its own
            pictures_what_it_explains(cause)
    if name not in HIDDEN:
        assert max(line.closed for line in result.shrinkage if line.closed is not None) > 0.5


def pictures_what_it_explains(cause):
    """Over a variable of its own declaration, what is left on held-out runs is far less with it than without."""
    seen = cause.picture
    assert seen.variable in effect_definition(cause.effect).acts_over
    assert seen.after_rms < 0.4 * seen.before_rms
    assert seen.off_zero_before >= 2
    drawn = [item for item in seen.bins if item.before is not None and np.isfinite(item.before)]
    assert len(drawn) >= 2
    assert all(case.low < case.high for case in drawn)


@pytest.mark.long
def test_what_no_effect_explains_is_owned_up_to(benches):
    is_owned_up_to(folders(benches)[0])


@pytest.mark.long
@pytest.mark.parametrize("name", unlisted_effects())
def test_each_of_what_no_effect_explains_is_owned_up_to(every_unlisted, name):
    is_owned_up_to(every_unlisted[name], name)


def is_owned_up_to(folder, name=""):
    result = answer(folder)
    assert result.verdict == "unknown"
    assert all(cause.probability < 0.5 for cause in result.causes)
    assert any(note.startswith("unexplained: ") for note in result.notes)
    rest = result.unexplained
    assert not {near.effect for near in rest.nearest} & {c.effect for c in result.causes if c.probability >= 0.5}
    assert all(near.refused_because for near in rest.nearest)
    if name in DEPENDS:
        assert set(rest.depends_on) == DEPENDS[name]
        state = DEPENDS[name] - {"time"}
        assert (rest.closable > 0.5) is bool(state)
        assert {shape.variable for shape in rest.shapes} == state


@pytest.mark.long
def test_what_rings_on_the_bench_is_told_with_its_frequency(benches):
    folder = keyed(benches, "unlisted")["hanging_resonator"]
    held_still = entries(benches)[folder.name]["parameters"]["hanging_resonator"]["frequency"]
    case = read_case(sorted(folder.glob("*.h5")), [], model(folder))
    evidence = Evidence(case.fitted, case.model)
    lines = highest_lines(evidence, evidence.settle([]), [True] * len(evidence.stack.rows))
    highest = max(lines.values(), key=lambda line: line.height)
    assert highest.height > 1.3
    # a free rotor swings against the part that hangs on it, faster than the part alone by half at most
    assert 0.9 * held_still < highest.frequency < 1.5 * held_still


@pytest.mark.long
def test_the_answer_does_not_depend_on_file_names_or_order(with_effect, tmp_path):
    folder = with_effect["torque_ripple"]
    runs = sorted(folder.glob("*-a.h5"))
    renamed = []
    for k, run in enumerate(reversed(runs)):
        renamed.append(tmp_path / f"x{k}.h5")
        renamed[-1].write_bytes(run.read_bytes())
    first, second = (diagnose(read_case(group, [], model(folder))) for group in (runs, renamed))
    assert [c.effect for c in first.causes if c.probability > 0.5] == [
        c.effect for c in second.causes if c.probability > 0.5
    ]


def test_a_run_on_both_sides_is_refused(sound_bench):
    folder = sound_bench
    run = next(iter(folder.glob("*-a.h5")))
    with pytest.raises(InputError, match="on one side only"):
        read_case([run], [run], model(folder))


def test_kinds_that_occur_twice_are_held_out(sound_bench):
    folder = sound_bench
    records = read_case(sorted(folder.glob("*.h5")), [], model(folder))
    fitted, held = hold_out_runs([*records.fitted, *records.held_out])
    assert {r.kind for r in fitted} == {r.kind for r in held}
    assert isinstance(records, Case)


def test_free_runs_alone_say_what_they_cannot_show(sound_bench):
    folder = sound_bench
    diagnosis = diagnose(read_case(sorted(folder.glob("free*.h5")), [], model(folder)))
    hidden = next(note for note in diagnosis.notes if note.startswith("invisible"))
    for effect in ("torque_sensor_gain", "backlash", "load_dependent_friction"):
        assert effect in hidden
    assert any("torque sensor" in note for note in diagnosis.notes)


@pytest.mark.long
@pytest.mark.skipif(not PRACTICE.is_dir(), reason="the practice cases are not beside this checkout")
def test_a_bench_of_another_simulator_with_wrong_parameters_only_gets_no_cause():
    result = answer(PRACTICE / "practice-1")
    assert result.verdict == "calibration"
    assert not [cause for cause in result.causes if cause.probability >= 0.5]


def channel(quantity, values, role="test"):
    time = np.arange(200) * 1e-3
    return Channel(time, np.asarray(values, float), quantity, role, "", "", "", "", "instant", "loop")


def test_what_is_noted_of_several_runs_alike_is_said_once_and_what_may_rest_is_not_noted():
    angle, still, absent = np.arange(200) * 0.01, np.zeros(200), np.full(200, np.nan)
    channels = [
        channel("angle", angle),
        channel("angle", still, "load"),
        channel("bus_voltage", still + 30.0),
        channel("velocity_reference", absent),
        channel("q_axis_voltage", absent),
    ]
    records = [build_record(Path(f"{name}.h5"), "spin", "free", channels, {}) for name in ("a", "b", "c", "a")]
    assert reading_notes(records) == (
        "a.h5 and 2 more: bus_voltage of test never changes; is the channel alive?",
        "a.h5 and 2 more: q_axis_voltage of test has 0 samples; left out",
    )


def test_where_no_kind_of_run_occurs_twice_stretches_are_held_out():
    def run(name, **setup):
        channels = [channel("angle", np.arange(200) * 0.01), channel("q_axis_current", np.arange(200) * 0.02)]
        return build_record(Path(f"{name}.h5"), "spin", "free", channels, setup)

    kept, taken = hold_out_runs([run("a", drive_gain=1.0), run("b", drive_gain=2.0)])
    assert [record.name for record in kept] == [record.name for record in taken] == ["a", "b"]
    for one, other in zip(kept, taken, strict=True):
        left, right = (record.fast.all_valid(("angle", "test")) for record in (one, other))
        assert np.all(left ^ right)
        assert right.sum() == 25
        assert np.count_nonzero(np.diff(right.astype(int)) == 1) == 2
    assert [record.name for record in hold_out_runs([run("a", drive_gain=1.0), run("b", drive_gain=1.0)])[1]] == ["b"]


@pytest.mark.long
def test_a_bench_with_one_run_of_each_kind_is_diagnosed_all_the_same(sound_bench):
    folder = sound_bench
    runs = sorted({path.name.rsplit("-", 1)[0]: path for path in folder.glob("*.h5")}.values())
    diagnosis = diagnose(read_case(runs, [], model(folder)))
    assert not [cause for cause in diagnosis.causes if cause.probability >= 0.5]
    assert any("held out are two sixteenths" in note for note in diagnosis.notes)
    turning = [line for line in diagnosis.shrinkage if line.mechanical == "free"]
    assert len(turning) >= 3
    for line in turning:
        assert line.calibrated_rms < 1.5 * line.floor_rms, line
