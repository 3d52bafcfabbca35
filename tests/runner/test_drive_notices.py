"""What a drive does by itself in a run: it is in the file, or ends the run at once."""

from leactl.errors import DeviceFault, InputError
from leactl.runfile.read.reader import Run


def messages(outcome, level):
    with Run.open(outcome.path) as run:
        return [(event.source, event.message) for event in run.events if event.level == level]


def test_a_drive_that_limits_its_current_is_in_the_file_once_an_onset(spin):
    def limit(bench):
        drive = bench.far_ends["drive_test"]
        drive._values[0x6073, 0] = 30
        drive._follow()

    outcome, _bench = spin(at=[(0.4, limit)])
    assert outcome.status == "complete"
    results = [event for event in messages(outcome, "warning") if event[0] == "drive_test"]
    assert results == [("drive_test", "the drive limits its demand by itself (bit 11 of statusword 0x0E37)")]


def test_a_current_above_what_the_drive_lets_flow_ends_the_run_before_it_is_sent(spin):
    def limit(bench):
        bench.far_ends["drive_test"]._values[0x6072, 0] = 30

    outcome, bench = spin(at=[(0.0, limit)])
    assert isinstance(outcome.error, InputError)
    assert "above the 0.411 A that the drive lets flow" in str(outcome.error)
    assert bench.far_ends["drive_test"].state == "disabled"


def test_a_drive_that_reboots_ends_the_run_by_its_boot_up_message(spin):
    def reboot(bench):
        drive = bench.far_ends["drive_test"]
        drive._go("disabled")
        drive.nmt, drive._booted = 0x7F, False

    outcome, bench = spin(at=[(0.4, reboot)])
    assert isinstance(outcome.error, DeviceFault)
    assert "drive_test: node 1 rebooted or left the operational state (boot-up)" in str(outcome.error)
    assert outcome.duration_s < 0.5
    assert bench.far_ends["drive_load"].state == "disabled"
