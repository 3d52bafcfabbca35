"""Protocols on an emulated bench of two Elmo drives on serial lines."""

from importlib import resources

import numpy as np
import pytest
import yaml

from leactl.analysis.analyze import analyze_runs
from leactl.bench import benchfile
from leactl.emulation.faults import find_fault
from leactl.emulation.faults.contract import PlannedBench
from leactl.errors import InputError
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runner.drill.emulated import EmulatedDrill


@pytest.fixture
def bench(tmp_path):
    """The shipped emulated bench with its drives on lines of their own."""

    def write(baudrate=115200, **settings):
        data = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
        data["name"] = "serials"
        del data["buses"]["can0"]
        for role in ("test", "load"):
            data["buses"][f"line_{role}"] = {"kind": "serial", "baudrate": baudrate}
            own = {"counts_per_turn": 40000, **settings}
            data["devices"][f"drive_{role}"] |= {"driver": "elmo_serial", "bus": f"line_{role}", "settings": own}
        path = tmp_path / "serials.yaml"
        path.write_text(yaml.safe_dump(data, sort_keys=False))
        return str(path)

    return write


def protocol(name):
    return (resources.files("leactl_protocols") / f"{name}.yaml").read_text()


def test_the_torque_constant_is_measured_with_current_and_angle_held_over_serial_lines(spin, bench):
    outcome, _made = spin(protocol("torque-constant"), bench=bench(), sets=("seed=4", "trials=1"))
    assert outcome.status == "complete", outcome.reason
    assert verify(outcome.path) == []
    constant = analyze_runs([outcome.path]).find("torque_constant")
    assert constant.value == pytest.approx(0.49, rel=0.002)
    with Run.open(outcome.path) as run:
        assert run.instruments["drive_test"]["model"] == "Elmo Whistle"
        told = [event.message for event in run.events if event.source == "drive_test"]
        current = run.channel("q_axis_current", role="test").values
    assert any("a row's readings are taken one after another" in message for message in told)
    assert np.count_nonzero(np.isnan(current)) == 0


def test_a_slow_line_is_refused_for_a_plan_that_it_does_not_carry(spin, bench):
    outcome, _made = spin(bench=bench(baudrate=19200))
    assert outcome.status == "failed"
    assert "at 100 Hz leaves 5.5 ms: 20 Hz at the most" in outcome.reason


def test_a_bench_may_not_let_a_drive_go_on_for_longer_than_a_second(bench):
    with pytest.raises(InputError, match=r"devices.drive_test.settings.dead_man_ms"):
        benchfile.load(bench(dead_man_ms=1500))


def test_a_drive_whose_program_has_ended_ends_the_run(spin, bench):
    def end(made):
        made.far_ends["drive_test"].program_running = False

    outcome, made = spin(bench=bench(), at=[(1.1, end)])
    assert outcome.status == "failed"
    assert "no program running" in outcome.reason
    assert not made.far_ends["drive_test"].on


@pytest.mark.long
def test_a_drives_faults_end_a_run_over_serial_lines(bench, tmp_path):
    faults = ("cut_line", "drive_fault", "frozen_drive", "stuck_sensor")
    drilled = EmulatedDrill(bench(), faults, tmp_path, lambda *_: None).run()
    assert [finding.faults for finding in drilled.findings if not finding.held] == []
    assert len(drilled.findings) == 14
    cut = next(finding for finding in drilled.findings if finding.name == "cut_line" and finding.on == "line_test")
    assert next((end.confirmed, end.without_power) for end in cut.devices.values()) == (False, True)
    assert cut.zero_torque_s <= 0.3


def test_a_line_that_is_none_cannot_be_cut(bench):
    file, devices, _document = benchfile.load(bench())
    standing = PlannedBench(file, {device.name: device for device in devices})
    fault = find_fault("cut_line").model_validate({"fault": "cut_line", "at_s": 1, "bus": "i2c1"})
    assert fault.misfits(standing) == {
        "bus": "'i2c1' is no serial line or raw socket of the bench; it has line_test, line_load"
    }
