"""The thermal network from runs of the emulated plant, which shares no equation with the fit."""

import json
from contextlib import ExitStack

import pytest

from leactl.errors import InputError
from leactl.gap.thermal_fit import FITTED_PARAMETERS, thermal_fit
from leactl.model.motor import load_motor
from leactl.report.thermal_fits import thermal_fits
from leactl.runfile.read.reader import Run
from tests.cli.terminal import leactl

LEA = load_motor("lea")[0]


def fit(paths):
    with ExitStack() as opened:
        return thermal_fit([opened.enter_context(Run.open(path)) for path in paths], LEA)


@pytest.fixture(scope="module")
def bench(sound_cases, sound_bench):
    key = json.loads((sound_cases.key / "key.json").read_text(encoding="utf-8"))
    return sorted(sound_bench.glob("*.h5")), key["cases"][sound_bench.name]["true_base"]


def test_the_network_comes_out_within_four_standard_errors(bench):
    runs, true = bench
    result = fit(runs)
    assert [parameter.parameter for parameter in result.parameters] == list(FITTED_PARAMETERS)
    for one in result.parameters:
        assert abs(one.fitted - true[one.parameter]) < 4.0 * one.std
        assert one.std < 0.03 * one.fitted


def test_tolerances_cover_the_truth_and_are_narrower_than_the_file_s(bench):
    runs, true = bench
    result = fit(runs)
    fitted = {parameter.parameter.removeprefix("thermal."): parameter.fitted for parameter in result.parameters}
    assert result.tolerances["temperature_rise"] == 0.02
    for name, tolerance in result.tolerances.items():
        if name == "temperature_rise":
            continue
        actual = true.get(f"thermal.{name}", true.get(name))
        assert abs(actual - fitted[name]) < tolerance * fitted[name]
        assert 0.01 <= tolerance < 0.1
    assert {
        "winding_housing_resistance",
        "housing_ambient_resistance",
        "housing_capacitance",
    } <= result.tolerances.keys()


def test_a_run_that_cannot_be_read_is_refused(bench):
    runs, _ = bench
    with pytest.raises(InputError, match=r"no-such\.h5"):
        thermal_fits([runs[0].with_name("no-such.h5")], LEA)


def test_the_command_prints_a_block_for_the_motor_file(bench, monkeypatch):
    monkeypatch.chdir(bench[0][0].parent)
    runs = [run.name for run in bench[0]]
    done = leactl("thermal", "fit", *map(str, runs))
    assert done.returncode == 0, done.stderr
    assert "tolerances:" in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80
    body = json.loads(leactl("thermal", "fit", *map(str, runs), "--json").stdout)
    assert len(body["correlation"]) == len(body["parameters"])
