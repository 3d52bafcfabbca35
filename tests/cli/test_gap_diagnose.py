"""`leactl gap diagnose`: the JSON that other tools read, the exit statuses, and the files it writes."""

import json
import os
import signal
import subprocess
from types import SimpleNamespace

import pytest
import yaml

from leactl.model.nominal import read_model
from leactl.quantities import ROLES, SETUPS, UNITS
from leactl.vocabulary.effect import effect_definition, effect_names
from tests.cli.terminal import COMMAND, leactl
from tests.gap.emulated_cases import emulated_cases

OTHER_VARIABLES = {"direction": "1", "frequency": "Hz", "time": "s", "time_since_reversal": "s"}
NUMBER = (int, float)
PLACE = {"quantity": str, "role": str, "mechanical": str, "units": str}
WHERE = PLACE | {key: NUMBER for key in ("nominal_rms", "calibrated_rms", "floor_rms", "share")}
SHRINKAGE = PLACE | {key: NUMBER for key in ("nominal_rms", "calibrated_rms", "augmented_rms", "floor_rms")}
CALIBRATION = {"parameter": str, "nominal": NUMBER, "fitted": NUMBER, "std": NUMBER, "units": str}
CALIBRATION |= {"not_told_by_these_runs": bool}
CAUSE = {"effect": str, "family": str, "probability": NUMBER, "share": NUMBER}
CAUSE |= {"indistinguishable_from": list, "parameters": list}
PARAMETER = {"name": str, "value": NUMBER, "std": NUMBER, "units": str}
REGION = {"variable": str, "low": NUMBER, "high": NUMBER, "units": str, "within_turn": bool}
PICTURE = {"variable": str, "variable_units": str, "quantity": str, "role": str, "mechanical": str, "equation": str}
PICTURE |= {"units": str, "before_rms": NUMBER, "after_rms": NUMBER, "off_zero_before": int, "off_zero_after": int}
PICTURE |= {"bins": list}
MEANS = tuple(f"{model}{end}" for model in ("before", "after") for end in ("", "_low", "_high"))
DOCUMENT = {
    "format": str,
    "format_version": int,
    "verdict": str,
    "unexplained_probability": NUMBER,
    **{key: list for key in ("where", "calibration", "causes", "shrinkage", "notes")},
}


@pytest.fixture(scope="session")
def case(tmp_path_factory):
    """A bench whose torque constant falls at high current, strongly."""
    runs = emulated_cases(tmp_path_factory, "saturated").cases / "case-001"
    fitted, held_out = ([str(path) for path in sorted(runs.glob(f"*-{side}.h5"))] for side in "ab")
    return SimpleNamespace(folder=runs, fitted=fitted, held_out=held_out, nominal=str(runs / "nominal.yaml"))


@pytest.fixture(scope="session")
def diagnosed(case, tmp_path_factory):
    """The whole case diagnosed once, with everything written."""
    folder = tmp_path_factory.mktemp("answers")
    held_out = [word for path in case.held_out for word in ("--held-out", path)]
    files = ["--json", "-", "--html", folder / "page.html", "--write-model", folder / "augmented.yaml"]
    done = leactl("gap", "diagnose", *case.fitted, "--model", case.nominal, *held_out, *files)
    assert done.returncode == 0, done.stderr
    return SimpleNamespace(done=done, folder=folder, json=json.loads(done.stdout, parse_constant=pytest.fail))


def fits(found, keys, optional=()):
    """Whether a mapping has these keys of these types, and no other; optional ones may be null."""
    assert set(found) == set(keys) | set(optional)
    for key, kind in keys.items():
        assert isinstance(found[key], kind), (key, found[key])
        assert isinstance(found[key], bool) == (kind is bool)


def test_the_document_has_the_keys_of_the_format_and_no_other(diagnosed):
    answer = diagnosed.json
    fits(answer, DOCUMENT, ("unexplained",))
    assert (answer["format"], answer["format_version"]) == ("leactl-gap", 1)
    assert 0 <= answer["unexplained_probability"] <= 1
    assert all(isinstance(note, str) for note in answer["notes"])
    for item in answer["where"]:
        fits(item, WHERE, ("region",))
        if item["region"] is not None:
            fits(item["region"], REGION)
    for item in answer["calibration"]:
        fits(item, CALIBRATION)
    for item in answer["causes"]:
        fits(item, CAUSE, ("separating_experiment", "change", "picture"))
        if item["picture"] is not None:
            fits(item["picture"], PICTURE, ("periods", "along", "refitted"))
            for stretch in item["picture"]["bins"]:
                fits(stretch, {"low": NUMBER, "high": NUMBER, "count": int}, MEANS)
        assert item["separating_experiment"] is None or isinstance(item["separating_experiment"], str)
        for parameter in item["parameters"]:
            fits(parameter, PARAMETER)
    for item in answer["shrinkage"]:
        fits(item, SHRINKAGE, ("closed", "closed_low", "closed_high"))


def test_the_first_cause_is_pictured_over_the_variable_that_it_acts_in(diagnosed):
    seen = diagnosed.json["causes"][0]["picture"]
    assert (seen["variable"], seen["variable_units"], seen["periods"]) == ("q_axis_current", "A", None)
    assert seen["refitted"] is True
    assert seen["after_rms"] < 0.1 * seen["before_rms"]
    assert seen["off_zero_before"] > 0.5 * len(seen["bins"])
    edges = [(stretch["low"], stretch["high"]) for stretch in seen["bins"]]
    assert edges == sorted(edges)
    page = (diagnosed.folder / "page.html").read_text(encoding="utf-8")
    assert "What each effect explains" in page


def test_channels_are_named_by_the_vocabulary(diagnosed):
    for item in [*diagnosed.json["where"], *diagnosed.json["shrinkage"]]:
        assert item["units"] == UNITS[item["quantity"]]
        assert item["role"] in ROLES
        assert item["mechanical"] in SETUPS
    keys = [
        [(i["quantity"], i["role"], i["mechanical"]) for i in diagnosed.json[key]] for key in ("where", "shrinkage")
    ]
    assert len(set(keys[0])) == len(keys[0])
    assert set(keys[0]) == set(keys[1])


def test_where_is_sorted_and_its_regions_hold_a_share(diagnosed):
    said = diagnosed.json["where"]
    ratios = [(item["calibrated_rms"] / item["floor_rms"]) ** 2 for item in said]
    assert ratios == sorted(ratios, reverse=True)
    for item in said:
        assert 0 <= item["share"] <= 1
        region = item["region"]
        if region is not None:
            assert region["low"] <= region["high"]
            assert region["units"] == (UNITS | OTHER_VARIABLES)[region["variable"]]
            assert item["share"] > 0


def test_causes_are_sorted_and_known(diagnosed):
    answer = diagnosed.json
    chances = [cause["probability"] for cause in answer["causes"]]
    assert chances == sorted(chances, reverse=True)
    assert all(0.01 <= chance <= 1 for chance in chances)
    assert (answer["verdict"] == "effect") == any(chance >= 0.5 for chance in chances)
    assert len({cause["effect"] for cause in answer["causes"]}) == len(answer["causes"])
    for cause in answer["causes"]:
        definition = effect_definition(cause["effect"]).parameters
        assert {p["name"]: p["units"] for p in cause["parameters"]}.items() <= {
            name: one.units for name, one in definition.items()
        }.items()
        assert cause["effect"] not in cause["indistinguishable_from"]
        assert set(cause["indistinguishable_from"]) <= set(effect_names())
        assert all(p["std"] >= 0 for p in cause["parameters"])


def test_closed_is_what_its_numbers_say(diagnosed):
    for item in diagnosed.json["shrinkage"]:
        calibrated, augmented, floor = (item[f"{key}_rms"] for key in ("calibrated", "augmented", "floor"))
        if calibrated < 1.1 * floor:
            assert item["closed"] is item["closed_low"] is item["closed_high"] is None
        else:
            assert item["closed"] == pytest.approx((calibrated - augmented) / (calibrated - floor))
            assert item["closed_low"] <= item["closed_high"]


def test_a_strong_effect_is_found(diagnosed):
    assert diagnosed.json["verdict"] == "effect"
    first = diagnosed.json["causes"][0]
    assert "saturation" in (first["effect"], *first["indistinguishable_from"])


def test_the_written_model_loads_again_with_its_effects_and_its_calibration(case, diagnosed):
    model, _ = read_model(diagnosed.folder / "augmented.yaml")
    named = {
        cause["effect"]: {p["name"]: p["value"] for p in cause["parameters"]}
        for cause in diagnosed.json["causes"]
        if cause["probability"] >= 0.5
    }
    assert model.effects
    for entry in model.effects:
        assert entry.parameters == pytest.approx(named[entry.effect])
    nominal = read_model(case.folder / "nominal.yaml")[0]
    fitted = {item["parameter"]: item["fitted"] for item in diagnosed.json["calibration"]}
    assert model.phase_resistance == pytest.approx(fitted["phase_resistance"])
    assert model.thermal.winding_capacitance == pytest.approx(fitted["thermal.winding_capacitance"])
    assert (model.name, model.pole_pairs, model.limits) == (nominal.name, nominal.pole_pairs, nominal.limits)


def test_steps_and_time_stand_on_stderr_alone(diagnosed):
    lines = diagnosed.done.stderr.splitlines()
    assert len(lines) >= 3
    assert all(line.endswith(" ...") for line in lines[:-1])
    assert lines[-1].startswith("done in ")
    assert "\x1b" not in diagnosed.done.stderr


def test_the_page_is_written_whole(diagnosed):
    text = (diagnosed.folder / "page.html").read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>")
    assert text.endswith("</html>\n")
    assert sorted(path.name for path in diagnosed.folder.iterdir()) == ["augmented.yaml", "page.html"]
    for cause in diagnosed.json["causes"]:
        assert cause["effect"] in text


@pytest.mark.long
def test_an_effect_that_the_model_has_already_is_kept(case, tmp_path):
    has = {"effect": "third_thermal_node", "parameters": {"capacitance": 100.0, "resistance": 2.0}}
    document = yaml.safe_load((case.folder / "nominal.yaml").read_text()) | {"effects": [has]}
    (tmp_path / "has.yaml").write_text(yaml.safe_dump(document))
    locked = [path for path in case.fitted if "locked" in path]
    done = leactl(
        "gap",
        "diagnose",
        *locked,
        "--model",
        tmp_path / "has.yaml",
        "--write-model",
        tmp_path / "m.yaml",
        PYTHONIOENCODING="ascii",
    )
    assert done.returncode == 0, done.stderr
    assert has in yaml.safe_load((tmp_path / "m.yaml").read_text())["effects"]
    assert done.stdout.isascii()
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert done.stdout.startswith("verdict: ")
    assert "held out are two sixteenths of each run" in " ".join(done.stdout.split())


def test_all_faults_are_told_at_once(case, tmp_path):
    (tmp_path / "text.h5").write_text("no run")
    on_both_sides = os.path.relpath(case.fitted[0])
    done = leactl(
        "gap",
        "diagnose",
        case.fitted[0],
        tmp_path / "text.h5",
        tmp_path / "absent.h5",
        "--held-out",
        on_both_sides,
        "--model",
        tmp_path / "absent.yaml",
    )
    assert done.returncode == 2
    assert done.stdout == ""
    faults = [line for line in done.stderr.splitlines() if line.startswith("leactl: ")]
    for what in ("is both fitted and held out", "absent.yaml", "text.h5", "absent.h5"):
        assert sum(what in fault for fault in faults) == 1, (what, faults)
    assert len(faults) == 4


def test_files_are_refused_before_anything_is_computed(case, tmp_path):
    kept = tmp_path / "kept"
    kept.write_text("mine")
    done = leactl(
        "gap", "diagnose", *case.fitted, "--model", case.nominal,
        "--json", kept, "--html", tmp_path / "no" / "page.html", "--write-model", case.nominal,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stdout == ""
    assert [line for line in done.stderr.splitlines() if not line.startswith("leactl: ")] == []
    assert f"{case.nominal}: is an input" in done.stderr
    assert "no folder" in done.stderr
    assert kept.read_text() == "mine"


def test_without_a_model_the_command_line_is_wrong(case):
    assert leactl("gap", "diagnose", *case.fitted).returncode == 2


def test_ctrl_c_ends_in_order(case, tmp_path):
    command = [
        *COMMAND,
        "gap",
        "diagnose",
        *case.fitted,
        "--model",
        case.nominal,
        "--html",
        str(tmp_path / "page.html"),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr.readline().endswith(" ...\n")
        running.send_signal(signal.SIGINT)
        out, error = running.communicate(timeout=60)
    assert running.returncode == 4
    assert out == ""
    assert error.splitlines()[-1] == "leactl: stopped"
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []
