"""Protocols on an emulated bench of two ODrives: the contract of a drive is not one family's alone."""

from importlib import resources

import pytest
import yaml

from leactl.analysis.analyze import analyze_runs
from leactl.bench import benchfile
from leactl.errors import InputError
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runner.drill.emulated import EmulatedDrill


def odrive(role, node):
    settings = {"node": node, "endpoints": "emulated", "watchdog_ms": 200}
    return {"driver": "odrive_can", "bus": "can0", "role": role, "settings": settings}


@pytest.fixture
def bench(tmp_path):
    """The shipped emulated bench with some of its drives replaced."""

    def write(**drives):
        data = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
        data["name"] = "odrives"
        data["devices"] |= drives
        path = tmp_path / "odrives.yaml"
        path.write_text(yaml.safe_dump(data, sort_keys=False))
        return str(path)

    return write


@pytest.fixture
def odrives(bench):
    return bench(drive_test=odrive("test", 1), drive_load=odrive("load", 2))


def protocol(name):
    return (resources.files("leactl_protocols") / f"{name}.yaml").read_text()


def frames_of(at, seen):
    """Keep the identifiers of what passes on the bus from this second on."""

    def listen(bench):
        bench.wires["can0"].disturb(lambda frame, _source: seen.append(frame.identifier) or 0.0)

    return [(at, listen)]


def test_the_torque_constant_is_measured_with_current_and_angle_held_by_odrives(spin, odrives):
    outcome, _made = spin(protocol("torque-constant"), bench=odrives, sets=("seed=4", "trials=1"))
    assert outcome.status == "complete", outcome.reason
    assert verify(outcome.path) == []
    constant = analyze_runs([outcome.path]).find("torque_constant")
    assert constant.value == pytest.approx(0.49, rel=0.002)
    with Run.open(outcome.path) as run:
        assert run.instruments["drive_test"]["model"] == "ODrive 5.2.0"


@pytest.mark.long
def test_a_velocity_and_an_angle_are_followed_one_after_the_other(spin, odrives):
    outcome, _made = spin(protocol("position-step"), bench=odrives, sets=("seed=4",))
    assert outcome.status == "complete", outcome.reason


def test_no_sync_is_sent_where_no_device_listens_for_it(spin, odrives, bench):
    seen = []
    spin(bench=odrives, at=frames_of(0.1, seen))
    assert 0x080 not in seen
    assert {0x02E, 0x029} <= set(seen)  # a torque and a question for the encoder, of node 1
    seen.clear()
    spin(bench=bench(), at=frames_of(0.1, seen))
    assert 0x080 in seen


@pytest.mark.long
def test_every_fault_of_the_catalogue_ends_a_run_of_odrives(odrives, tmp_path):
    drilled = EmulatedDrill(odrives, (), tmp_path, lambda *_: None).run()
    assert [finding.faults for finding in drilled.findings if not finding.held] == []
    assert len(drilled.findings) >= 37


def test_two_protocols_share_a_bus_where_their_identifiers_lie_apart(spin, bench):
    mixed = bench(drive_load=odrive("load", 2))
    outcome, _made = spin(protocol("torque-constant"), bench=mixed, sets=("seed=4", "trials=1"))
    assert outcome.status == "complete", outcome.reason


def test_a_node_within_the_range_of_another_protocol_is_refused(bench):
    message = (
        r"devices.drive_load.settings: uses the identifiers 0x080, 0x081 of drive_test on bus 'can0'; another node"
    )
    with pytest.raises(InputError, match=message):
        benchfile.load(bench(drive_load=odrive("load", 4)))
