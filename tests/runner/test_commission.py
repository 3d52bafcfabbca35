"""Commissioning heats step by step, each heat by what those before told, and ends with the protocol as asked for."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from leactl.analysis.heating.narrowing import Accuracy
from leactl.emulation.bench.emulated_block import actuator_of
from leactl.errors import AcceptanceFailed, InputError, Stopped
from leactl.model.motor import load_motor
from leactl.runner.commission import CommissionOptions, commission
from leactl.runner.outcome import Outcome
from leactl.runner.request import prepare
from tests.analysis.heated import HeatedBench, Plant

HOT = {"current_A": "9", "heating_s": "1500", "cooling_s": "1600"}  # by the shipped tolerances 130 degC after 1027 s


class Bench:
    """A bench whose runs an independent plant makes, of what their requests ask for."""

    def __init__(self, folder: Path, plant: Plant = Plant(), label: str = "LEA-1") -> None:  # noqa: B008
        self.bench = HeatedBench(folder, np.random.default_rng(3), plant)
        self.requests = []
        self.label = label

    def perform(self, request, heading):
        self.requests.append(request)
        own = request.plan.parameters
        path = self.bench.run(
            rate_Hz=2.0,
            lead_s=own["rest_s"],
            heat_s=own["heating_s"],
            cool_s=own["cooling_s"],
            current=own["current_A"],
            actuator=self.label,
            bench="emulated-heated",
        )
        return Outcome(path, "complete", "", None, {}, request.plan.duration_s, 0)


def manner_of(bench, asked=HOT, protocol="thermal", **how):
    def prepared(changed):
        words = [f"{name}={value}" for name, value in (asked | dict(changed)).items()]
        made = prepare(protocol, "emulated-heated", words, "LEA-1", "", "", Path("runs"), realtime=False)
        return replace(made, plan=replace(made.plan, attended=True))

    said = []
    return CommissionOptions(prepared, bench.perform, said.append, **({"most": 3} | how)), said


def test_one_short_heat_narrows_the_file_until_the_whole_protocol_is_admitted_and_run(tmp_path):
    bench, file = Bench(tmp_path), tmp_path / "LEA-1.yaml"
    manner, said = manner_of(bench)
    result = commission(manner, file)
    first, whole = bench.requests
    assert [heat.whole for heat in result.heats] == [False, True]
    assert 800.0 < first.plan.parameters["heating_s"] < 967.0
    assert first.bench.motors["test"] == "lea"
    assert whole.plan.parameters["heating_s"] == 1500
    assert whole.bench.motors == {"test": str(file), "load": "lea"}
    # what is emulated stays the actuator that was there, whatever the file tells of it
    assert actuator_of(whole.bench, "test", {}) == actuator_of(first.bench, "test", {})
    assert load_motor(str(file))[0] == result.motor
    assert result.motor.tolerances.housing_ambient_resistance < 0.02
    assert result.admitted
    assert "not admitted" in said[0]
    assert "admitted" in said[-1]
    text = file.read_text()
    assert bench.bench.directory.joinpath(result.heats[0].path.name).exists()
    assert result.heats[0].path.name in text


@pytest.mark.long
def test_no_heat_lasts_more_than_a_few_times_the_longest_before_it(tmp_path):
    """A body that warms for an hour shows nothing in a quarter of it, and the bound of the whole is none then."""
    bench = Bench(tmp_path)
    manner, said = manner_of(bench, HOT | {"heating_s": "4500"}, accuracy=Accuracy(0.005, 0.5))
    result = commission(manner, tmp_path / "LEA-1.yaml")
    first, second, whole = (heat.heating_s for heat in result.heats)
    assert 2.0 * first < second <= 3.0 * first + 1.0
    assert whole == 4500
    assert "admitted for heats of up to" in said[1]


def test_a_run_of_another_bench_is_refused(tmp_path):
    bench = Bench(tmp_path)
    other = bench.bench.run(rate_Hz=2.0, heat_s=800.0, cool_s=1600.0, actuator="LEA-1")
    with pytest.raises(InputError, match="of bench 'synthetic'; 'emulated-heated' was expected"):
        commission(manner_of(bench, given=[other])[0], tmp_path / "LEA-1.yaml")


def test_what_is_admitted_already_is_run_at_once_and_writes_no_file(tmp_path):
    bench, file = Bench(tmp_path), tmp_path / "LEA-1.yaml"
    result = commission(manner_of(bench, HOT | {"current_A": "6"})[0], file)
    assert [heat.whole for heat in result.heats] == [True]
    assert result.file is None
    assert not file.exists()


def test_a_rehearsal_says_how_long_the_first_heat_is_and_runs_nothing(tmp_path):
    bench = Bench(tmp_path)
    result = commission(manner_of(bench, dry_run=True)[0], tmp_path / "LEA-1.yaml")
    assert (bench.requests, result.admitted) == ([], False)
    assert 800.0 < result.next_heating_s < 967.0


def test_runs_that_are_there_already_count_and_are_not_made_again(tmp_path):
    bench, file = Bench(tmp_path), tmp_path / "LEA-1.yaml"
    before = bench.bench.run(rate_Hz=2.0, heat_s=800.0, cool_s=1600.0, actuator="LEA-1", bench="emulated-heated")
    result = commission(manner_of(bench, given=[before])[0], file)
    assert [heat.whole for heat in result.heats] == [True]
    assert before.name in file.read_text()


def test_what_is_not_admitted_after_the_last_run_is_refused_and_its_file_kept(tmp_path):
    bench, file = Bench(tmp_path), tmp_path / "LEA-1.yaml"
    with pytest.raises(InputError, match=r"not admitted after 1 heated runs, with 2 at most: by LEA-1\.yaml: up to"):
        commission(manner_of(bench, HOT | {"current_A": "11"}, most=2)[0], file)
    assert file.exists()


def test_another_actuator_than_the_one_of_the_motor_file_ends_it_and_writes_nothing(tmp_path):
    bench, file = Bench(tmp_path, Plant(Rha=2.3)), tmp_path / "LEA-1.yaml"
    with pytest.raises(AcceptanceFailed, match="housing_ambient_resistance"):
        commission(manner_of(bench)[0], file)
    assert (len(bench.requests), file.exists()) == (1, False)


def test_a_run_that_was_stopped_ends_it_with_its_cause(tmp_path):
    bench = Bench(tmp_path)
    manner, _said = manner_of(bench)

    def stopped(request, heading):
        return replace(bench.perform(request, heading), error=Stopped("SIGINT"))

    with pytest.raises(Stopped, match="SIGINT"):
        commission(replace(manner, perform=stopped), tmp_path / "LEA-1.yaml")


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ({"protocol": "friction", "asked": {}}, "a heated protocol was expected"),
        ({"asked": HOT | {"current_A": "500", "voltage_V": "8"}}, "current"),
    ],
)
def test_a_protocol_that_cannot_be_commissioned_is_refused_before_anything_moves(tmp_path, how, told):
    bench = Bench(tmp_path)
    with pytest.raises(InputError, match=told):
        commission(manner_of(bench, **how)[0], tmp_path / "LEA-1.yaml")
    assert bench.requests == []


def test_a_run_of_another_actuator_is_refused(tmp_path):
    bench = Bench(tmp_path)
    other = bench.bench.run(rate_Hz=2.0, heat_s=800.0, cool_s=1600.0, actuator="LEA-2", bench="emulated-heated")
    with pytest.raises(InputError, match="of actuator 'LEA-2'; 'LEA-1' was expected"):
        commission(manner_of(bench, given=[other])[0], tmp_path / "LEA-1.yaml")


def test_an_altered_run_narrows_nothing(tmp_path):
    bench, file = Bench(tmp_path), tmp_path / "LEA-1.yaml"
    path = bench.bench.run(rate_Hz=2.0, heat_s=800.0, cool_s=1600.0, actuator="LEA-1", bench="emulated-heated")
    with h5py.File(path, "r+") as opened:
        opened["streams/camera/housing_1"][10:] += 0.5
    with pytest.raises(InputError, match="checksum"):
        commission(manner_of(bench, given=[path])[0], file)
    assert not file.exists()


def test_an_emulated_run_does_not_narrow_the_file_of_a_real_bench(tmp_path):
    bench = Bench(tmp_path)
    run = bench.bench.run(rate_Hz=2.0, heat_s=800.0, cool_s=1600.0, actuator="LEA-1", bench="emulated-heated")
    manner, _said = manner_of(bench, given=[run])

    def prepared(changed):
        request = manner.prepare(changed)
        return replace(request, bench=request.bench.model_copy(update={"emulated": None}))

    with pytest.raises(InputError, match="simulated; a run of the real bench"):
        commission(replace(manner, prepare=prepared), tmp_path / "LEA-1.yaml")


def test_the_motor_file_of_the_bench_is_never_replaced(tmp_path):
    bench, own = Bench(tmp_path), tmp_path / "own.yaml"
    own.write_text(load_motor("lea")[1].text)
    manner, _said = manner_of(bench)

    def prepared(changed):
        request = manner.prepare(changed)
        return replace(request, bench=request.bench.model_copy(update={"motors": {"test": str(own)}}))

    with pytest.raises(InputError, match="is the motor file that the bench names"):
        commission(replace(manner, prepare=prepared), own)
    assert own.read_text() == load_motor("lea")[1].text
