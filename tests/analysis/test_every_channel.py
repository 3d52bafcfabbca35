"""No result without a note that names the channel: every experiment with each of its channels dead, hanging or misread.

A result counts as the sound run's where it lies in that one's interval, or within a hundredth of it: a regulated
current that hangs at the very number it is regulated to changes nothing, and no record tells it.
"""

import math
from importlib.resources import files

import pytest
import yaml

from leactl.analysis.analyze import analyze_runs
from leactl.analysis.registry import shipped_experiments
from leactl.errors import InputError
from leactl.runfile.read.reader import Run
from tests.analysis.corrupted import CORRUPTIONS, constant, frozen, gappy, rewritten, thousandfold, turned
from tests.analysis.heated import HeatedBench
from tests.analysis.short_runs import SETTINGS, short_run

ALIKE = 0.01
# Channels that show nothing but their noise about zero: no record tells by what factor or sign that is read.
IDLE = {"breakaway": ("loop/load_iq", "loop/load_omega", "torque_sensor/torque")}


def measured(path):
    """Place in the file and quantity of every channel that a sensor reads."""
    with Run.open(path) as run:
        return [
            (f"{stream}/{spec.name}", spec.quantity)
            for stream, specs in run.streams.items()
            for spec in specs
            if not spec.quantity.endswith("_reference") and spec.quantity != "drive_enabled"
        ]


def same(sound, other):
    """Whether two answers have the same results."""
    if [item.name for item in sound.results] != [item.name for item in other.results]:
        return False
    for item, found in zip(sound.results, other.results, strict=True):
        missing = math.isnan(item.value), math.isnan(found.value)
        if missing == (True, True):
            continue
        near = abs(found.value - item.value) <= ALIKE * abs(item.value) or item.low <= found.value <= item.high
        if any(missing) or not near:
            return False
    return True


def silent(path, sound, place, quantity, corruption, folder):
    """What is answered without a word about the channel; empty where a refusal or a new note names it."""
    spoiled = rewritten(path, folder / f"{place.replace('/', '-')}-{corruption.__name__}", place, corruption)
    try:
        answer = analyze_runs([spoiled])
    except InputError as refusal:
        text = str(refusal)
    else:
        if same(sound, answer):
            return ""
        known = {note.replace(str(path), "") for note in sound.notes}
        text = "\n".join(note for note in answer.notes if note.replace(str(spoiled), "") not in known)
    named = any(name in text for name in (quantity, quantity.removeprefix("q_axis_"), place.split("/")[1]))
    return "" if named else f"{place} {corruption.__name__}: {text or answer.results}"


def misses(path, folder, channels, corruptions=CORRUPTIONS):
    sound = analyze_runs([path])
    answers = [
        silent(path, sound, place, quantity, corruption, folder)
        for place, quantity in channels
        for corruption in corruptions
    ]
    return [answer for answer in answers if answer]


def test_every_shipped_protocol_and_experiment_has_a_short_form():
    protocols = [path for path in files("leactl_protocols").iterdir() if path.name.endswith(".yaml")]
    analyses = {path.name.removesuffix(".yaml"): yaml.safe_load(path.read_text()).get("analysis") for path in protocols}
    analysed = {name: analysis for name, analysis in analyses.items() if analysis}
    assert set(SETTINGS) == set(analysed)
    assert set(shipped_experiments()) == set(analysed.values())


@pytest.mark.long
@pytest.mark.parametrize("experiment", SETTINGS)
def test_every_channel_of_a_shipped_experiment(tmp_path, experiment):
    path = short_run(experiment, tmp_path / "run")
    channels = measured(path)
    idle = [pair for pair in channels if pair[0] in IDLE.get(experiment, ())]
    assert misses(path, tmp_path, [pair for pair in channels if pair not in idle]) == []
    assert misses(path, tmp_path, idle, (constant, frozen, gappy)) == []


@pytest.mark.long
def test_the_channels_of_a_heated_run(tmp_path):
    path = HeatedBench(tmp_path).run(
        rate_Hz=1.0, heat_s=900.0, cool_s=900.0, model="winding: wye\nphase_resistance: 0.264\n"
    )
    channels = [pair for pair in measured(path) if pair[0].endswith(("_1", "ambient", "line_current", "line_voltage"))]
    assert misses(path, tmp_path, channels, (constant, frozen, turned, thousandfold)) == []
