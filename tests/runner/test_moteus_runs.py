"""Protocols on an emulated bench of two moteus controllers, alone and with every fault of the catalogue."""

from importlib import resources

import pytest
import yaml

from leactl.analysis.analyze import analyze_runs
from leactl.bench import benchfile
from leactl.driver.far_end import FdFrame
from leactl.errors import DeviceError, InputError
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runner.drill.emulated import EmulatedDrill


def moteus(role, node, **more):
    settings = {"node": node, "watchdog_ms": 200, "torque_constant_Nm_per_A": 0.6} | more
    return {"driver": "moteus_can", "bus": "can0", "role": role, "settings": settings}


@pytest.fixture
def bench(tmp_path):
    """The shipped emulated bench with some of its drives replaced."""

    def write(**drives):
        data = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
        data["name"] = "moteuses"
        data["devices"] |= drives
        data["interlocks"] = data.get("interlocks", {}) | {"drive_temperature": {"trip_degC": 70}}
        path = tmp_path / "moteuses.yaml"
        path.write_text(yaml.safe_dump(data, sort_keys=False))
        return str(path)

    return write


@pytest.fixture
def moteuses(bench):
    return bench(drive_test=moteus("test", 1), drive_load=moteus("load", 9))


def protocol(name):
    return (resources.files("leactl_protocols") / f"{name}.yaml").read_text()


def test_the_torque_constant_is_measured_with_current_and_angle_held_by_two_controllers(spin, moteuses):
    outcome, made = spin(protocol("torque-constant"), bench=moteuses, sets=("seed=4", "trials=1"))
    assert outcome.status == "complete", outcome.reason
    assert verify(outcome.path) == []
    constant = analyze_runs([outcome.path]).find("torque_constant")
    assert constant.value == pytest.approx(0.49, rel=0.002)
    with Run.open(outcome.path) as run:
        told = run.instruments["drive_test"]
        assert (told["model"], told["firmware"]) == ("moteus, model 0x0120", "1.1.14")
        assert told["serial"] == made.far_ends["drive_test"].serial_number
        assert run.channel("drive_temperature", role="test").values.mean() == pytest.approx(32.0)


STEPS = """
name: steps
setup: coupled
rate_Hz: 100
steps:
  - mode: {test: velocity, load: current}
  - hold: {role: test, velocity_rad_s: 3.0, duration_s: 0.5}
  - mode: {test: "off"}
  - mode: {test: angle}
  - hold: {role: test, angle_rad: 0.4, duration_s: 0.5}
  - mode: {test: "off", load: "off"}
"""


def test_a_velocity_and_an_angle_are_followed_one_after_the_other(spin, moteuses):
    outcome, _made = spin(STEPS, bench=moteuses, sets=("seed=4",))
    assert outcome.status == "complete", outcome.reason
    with Run.open(outcome.path) as run:
        velocity, angle = (run.channel(quantity, role="test").values for quantity in ("velocity", "angle"))
    assert velocity.max() == pytest.approx(3.0, abs=0.2)
    assert angle[-20:].mean() == pytest.approx(0.4, abs=0.02)


def test_every_frame_is_can_fd_and_no_sync_is_sent(spin, moteuses):
    seen = []

    def listen(bench):
        bench.wires["can0"].disturb(lambda frame, _source: seen.append(frame) or 0.0)

    spin(bench=moteuses, at=[(0.1, listen)])
    assert {frame.identifier for frame in seen} == {0x8001, 0x8009, 0x0001, 0x0009, 0x0100, 0x0900}
    assert all(isinstance(frame, FdFrame) for frame in seen)


@pytest.mark.long
def test_every_fault_of_the_catalogue_ends_a_run_of_two_controllers(moteuses, tmp_path):
    drilled = EmulatedDrill(moteuses, (), tmp_path, lambda *_: None).run()
    assert [finding.faults for finding in drilled.findings if not finding.held] == []
    assert len(drilled.findings) >= 33


def test_the_bench_file_of_its_page_runs(spin, tmp_path):
    page = (resources.files("leactl_plugins.moteus_can") / "README.md").read_text()
    path = tmp_path / "two-moteus.yaml"
    path.write_text(page.partition("```yaml\n")[2].partition("```")[0])
    outcome, _made = spin(bench=str(path))
    assert outcome.status == "complete", outcome.reason


def test_a_serial_number_of_the_bench_file_is_held_against_the_controller(spin, bench):
    known = moteus("load", 9) | {"serial": "bench1moteus4711"}
    with pytest.raises(DeviceError, match=r"drive_test: serial number .* answers, the bench file says another: mend"):
        spin(bench=bench(drive_test=moteus("test", 1) | {"serial": "another"}, drive_load=known))


def test_a_number_that_two_drives_have_is_refused_in_the_bench_file(bench):
    with pytest.raises(InputError, match="address 1 on bus 'can0' is that of drive_test"):
        benchfile.load(bench(drive_test=moteus("test", 1), drive_load=moteus("load", 1)))


def test_a_node_whose_answers_are_those_of_another_protocol_is_refused(bench):
    message = "drive_load.settings: uses the identifiers 0x200 of drive_test on bus 'can0'"
    elmo = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())["devices"]["drive_test"]
    assert 0x200 + elmo["settings"]["node"] != 0x200
    path = bench(
        drive_test={
            "driver": "odrive_can",
            "bus": "can0",
            "role": "test",
            "settings": {"node": 16, "endpoints": "emulated"},
        },
        drive_load=moteus("load", 2),
    )
    with pytest.raises(InputError, match=message):
        benchfile.load(path)
