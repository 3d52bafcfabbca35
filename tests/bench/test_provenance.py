"""Serial numbers, firmware and calibration: what the bench file says, what devices tell, what is refused and told."""

import json
from datetime import date

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.bench import benchfile
from leactl.bench.bench import Bench
from leactl.bench.provenance import Provenance, overdue
from leactl.driver.contract import Identity
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.errors import DeviceError
from leactl.runfile.instruments import Instrument
from leactl.runfile.read.reader import Run
from tests.cli.terminal import leactl
from tests.runner.conftest import SPIN

SHIPPED = (benchfile.SHIPPED / "emulated.yaml").read_text()


def bench_with(folder, **facts):
    """The emulated bench, with something said of its instruments."""
    text = SHIPPED
    for device, words in facts.items():
        text = text.replace(f"  {device}:\n", f"  {device}:\n    {words}\n")
    path = folder / "bench.yaml"
    path.write_text(text)
    return path


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    (tmp_path / "spin.yaml").write_text(SPIN)
    return tmp_path


def test_a_run_records_what_devices_tell_over_what_the_bench_file_says(here):
    bench = bench_with(
        here,
        drive_test='serial: "0042"\n    firmware: Whistle 01.01.15.00',
        torque_sensor='model: TRD605\n    serial: "815"\n    calibrated: 2024-05-02\n    calibration_due: 2025-05-02',
    )
    done = leactl("run", "spin.yaml", "--bench", bench, "--json")
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    late = [line for line in lines if "calibration" in line]
    assert len(late) == 1
    assert late[0].startswith("leactl: warning: torque_sensor: calibration was due 2025-05-02, ")
    assert lines.index(late[0]) == 0
    firmware = "firmware Whistle 01.01.16.00 08Mar2018G answers, the bench file says Whistle 01.01.15.00"
    assert f"leactl: warning: drive_test: {firmware}" in lines
    with Run.open(json.loads(done.stdout)["run"]) as run:
        assert run.instruments == {
            "drive_test": {
                "model": "Gold DC Whistle, hardware 1.0",
                "serial": "42",
                "firmware": "Whistle 01.01.16.00 08Mar2018G",
            },
            "drive_load": {
                "model": "Gold DC Whistle, hardware 1.0",
                "serial": "2",
                "firmware": "Whistle 01.01.16.00 08Mar2018G",
            },
            "torque_sensor": {
                "model": "TRD605",
                "serial": "815",
                "calibrated": "2024-05-02",
                "calibration_due": "2025-05-02",
            },
        }
        warned = {event.source: event.message for event in run.events if event.level == "warning"}
    assert warned["torque_sensor"].startswith("calibration was due 2025-05-02, ")
    assert warned["drive_test"] == firmware


def test_another_serial_number_is_refused_and_every_drive_is_left_safe(tmp_path):
    file, devices, _ = benchfile.load(str(bench_with(tmp_path, drive_load='serial: "77"')))
    wiring = EmulatedBench(file, devices, "free", "unloaded")
    wiring.far_ends["drive_load"].serial_number = "78"
    bench = Bench(file, devices, wiring)
    with pytest.raises(DeviceError) as refusal:
        bench.open()
    assert str(refusal.value) == (
        "drive_load: serial number 78 answers, the bench file says 77: mend the wiring, or the file"
    )
    assert [wiring.far_ends[name].state for name in ("drive_test", "drive_load")] == ["disabled", "disabled"]


@pytest.mark.parametrize(("told", "written"), [("42", "00042"), ("1A2B3C4", "01a2b3c4"), ("1A2B3C4", "0x1A2B3C4")])
def test_a_number_is_the_same_as_its_label_writes_it(told, written):
    known = Provenance(Instrument(serial=written))
    known.take(Identity(serial=told))
    assert known.facts == {"serial": told}


def test_what_a_device_tells_reaches_no_terminal_as_a_command():
    known = Provenance(Instrument())
    known.take(Identity(model="a\x1b[31m", firmware="1\n2"))
    assert known.facts == {"model": "a\\x1b[31m", "firmware": "1\\n2"}


days = st.dates(date(1990, 1, 1), date(2200, 1, 1))


@given(today=days, due=days)
def test_calibration_is_overdue_from_the_day_after_it_was_due(today, due):
    _, devices, _ = benchfile.load("emulated")
    entry = devices[0].entry.model_copy(update={"calibration_due": due})
    device = devices[0].model_copy(update={"entry": entry})
    assert bool(overdue([device, *devices[1:]], today)) == (due < today)


def test_bench_check_tells_what_is_overdue(here):
    bench = bench_with(here, daq='serial: "1A2B3C4"\n    calibration_due: 2020-01-31')
    done = leactl("bench", "check", bench)
    assert done.returncode == 0
    assert done.stderr.startswith("leactl: warning: daq: calibration was due 2020-01-31, ")
    assert "serial                   1A2B3C4" in done.stdout
    answer = json.loads(leactl("bench", "check", bench, "--json").stdout)
    assert answer["overdue"].keys() == {"daq"}
    assert {"serial": "1A2B3C4", "calibration_due": "2020-01-31"}.items() <= answer["devices"][3].items()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("calibrated: yesterday", "devices.daq.calibrated: 'yesterday': a date as 2026-01-31 was expected"),
        ("serial: 4711", 'devices.daq.serial: 4711: a text was expected: put it in quotes, "4711"'),
        (
            "calibrated: 2026-02-01\n    calibration_due: 2026-01-31",
            "devices.daq: calibration_due 2026-01-31 is before calibrated 2026-02-01",
        ),
    ],
)
def test_what_is_no_date_is_refused_where_it_stands(here, words, message):
    done = leactl("bench", "check", bench_with(here, daq=words))
    assert (done.returncode, done.stdout) == (2, "")
    assert message in done.stderr
    assert done.stderr.startswith(f"leactl: {here / 'bench.yaml'}:")
