"""Back-EMF on the emulated bench from protocol to result, and a converter that goes wrong on the way."""

import math
from importlib import resources

import numpy as np
import pytest

from leactl.analysis.analyze import analyze_runs
from leactl.bench import benchfile
from leactl.errors import DeviceError, InputError
from leactl.protocol import protocolfile
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runner.request import prepare

KB = 0.49
SHORT = ("seed=5", "hold_s=2.0")


@pytest.fixture
def protocol():
    return (resources.files("leactl_protocols") / "back-emf.yaml").read_text()


@pytest.fixture
def bench(tmp_path):
    """A copy of the shipped bench under a name of its own, changed at one place."""

    def write(*changes):
        text = (benchfile.SHIPPED / "emulated.yaml").read_text().replace("name: emulated", "name: mine", 1)
        for before, after in changes:
            assert before in text
            text = text.replace(before, after, 1)
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        return str(path)

    return write


def noted(result, text):
    return [note for note in result.notes if text in note]


def test_the_constant_comes_back_with_its_harmonics_and_the_true_pole_count(spin, protocol, bench):
    changed = bench(
        ("emulated:\n  seed: 1\n", "emulated:\n  seed: 1\n  test: {pole_pairs: 20}\n  back_emf_harmonics:\n"
         "    - {order: 3, share: 0.2}\n    - {order: 5, share: 0.03, phase_rad: 0.5}\n"),
    )  # fmt: skip
    outcome, made = spin(protocol, bench=changed, sets=SHORT)
    assert outcome.status == "complete", outcome.reason
    assert verify(outcome.path) == []
    result = analyze_runs([outcome.path])
    output = result.find("back_emf_constant")
    assert output.value == pytest.approx(KB, rel=0.005)
    assert output.value == pytest.approx(KB * made.far_ends["daq"].scale, rel=3e-5)
    assert output.low <= KB <= output.high
    assert result.find("pole_pairs").value == pytest.approx(20, abs=0.02)
    assert noted(result, "the model has 41 pole pairs; 20 were counted")
    assert result.find("harmonic_5").value == pytest.approx(0.03, abs=2e-4)
    assert math.remainder(result.find("harmonic_5_phase").value - 0.5 - math.pi, 2 * math.pi) == pytest.approx(
        0, abs=0.02
    )
    assert result.find("harmonic_3").value < 5e-4  # a wye's leads do not show it
    with Run.open(outcome.path) as run:
        channel = run.channel("phase_voltage_bc")
        assert run.channel("phase_voltage_ab").time[0] + 14e-6 == pytest.approx(channel.time[0], abs=1e-9)
        assert channel.scale_std == pytest.approx(150e-6)
        np.testing.assert_allclose(np.diff(channel.time), 1e-4, rtol=1e-6)
        codes = channel.values / (10.0 / 32768)
        assert np.abs(codes - np.round(codes)).max() < 1e-3
        assert any("samples at 10000 Hz, 10000 Hz were asked for" in event.message for event in run.events)


def test_a_converter_that_goes_in_mid_run_fails_it_and_leaves_the_bench_safe(spin, protocol):
    outcome, made = spin(protocol, sets=SHORT, at=[(0.9, lambda bench: bench.far_ends["daq"].unplug())])
    assert (outcome.status, type(outcome.error)) == ("failed", DeviceError)
    assert "daq: NI-DAQmx -201003 (DEV_CANNOT_BE_ACCESSED): the device is gone" in outcome.reason
    assert [made.far_ends[name].state for name in ("drive_test", "drive_load")] == ["disabled", "disabled"]
    with Run.open(outcome.path) as run:
        assert 0.8 < run.time("daq")[-1] <= 0.9


def test_an_acquisition_that_ends_before_the_run_trips_nothing(spin, protocol, bench):
    changed = bench(("library: emulated\n", "library: emulated\n      duration_s: 0.5\n"))
    outcome, _ = spin(protocol, bench=changed, sets=("seed=5", "hold_s=2.2"))
    assert outcome.status == "complete", outcome.reason
    with Run.open(outcome.path) as run:
        assert len(run.time("daq")) == 5000
        assert any("the acquisition of 5000 samples is complete" in event.message for event in run.events)


def test_a_fault_of_one_lead_s_sensor_shows_in_its_pair(spin, protocol, bench):
    fault = "{fault: scaled_sensor, at_s: 0, device: daq, quantity: phase_voltage_bc, gain: -1.1}"
    changed = bench(("  seed: 1\n", f"  seed: 1\n  faults: [{fault}]\n"))
    result = analyze_runs([spin(protocol, bench=changed, sets=("seed=5", "hold_s=1.1"))[0].path])
    assert noted(result, "pair bc has its two leads swapped")
    assert noted(result, "and not zero")
    assert result.find("unevenness").value == pytest.approx(0.1 / (3.1 / 3), rel=0.02)


def test_devices_on_demand_are_opened_by_protocols_that_need_them_alone(tmp_path, spin, protocol, bench):
    def devices(name, path="emulated"):
        request = prepare(name, path, [], "", "", "", tmp_path, False)
        return [device.name for device in request.devices]

    assert "daq" in devices("back-emf")
    assert "daq" not in devices("friction")
    without = bench(("library: emulated", "library: nidaqmx"))
    with pytest.raises(InputError, match="library 'nidaqmx' on a bench that is emulated; emulated was expected"):
        spin(protocol, bench=without)


def test_a_bench_without_a_converter_is_refused_before_anything_moves(tmp_path, spin, protocol):
    text = (benchfile.SHIPPED / "emulated.yaml").read_text()
    start, stop = text.index("  daq:\n"), text.index("limits:\n")
    path = tmp_path / "none.yaml"
    path.write_text(text[:start] + text[stop:])
    with pytest.raises(
        InputError, match=r"protocol 'back-emf' needs phase_voltage_ab, .*no device of bench 'emulated'"
    ):
        spin(protocol, bench=str(path))
    assert not (tmp_path / "runs").exists()


def test_a_protocol_may_need_only_what_the_vocabulary_has(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\nsetup: free\nrate_Hz: 50\nneeds: [phase_voltage]\nsteps: [tare: {samples: 1}]\n")
    with pytest.raises(InputError, match="quantity 'phase_voltage' is not in the vocabulary"):
        protocolfile.load(str(path))
