"""The experiments a good laboratory adds, on the emulated bench from protocol to result: its truth comes back."""

from importlib import resources

import pytest

from leactl.analysis.analyze import analyze_runs
from leactl.bench import benchfile
from leactl.errors import InputError

F, B, KT, J = 0.208, 0.0238, 0.49, 0.0024  # the shipped bench's, design preload


def text_of(name):
    return (resources.files("leactl_protocols") / f"{name}.yaml").read_text()


@pytest.fixture
def bench_with(tmp_path):
    """A copy of the shipped bench with these lines in its `emulated:` block."""

    def write(*lines):
        text = (benchfile.SHIPPED / "emulated.yaml").read_text().replace("name: emulated", "name: mine", 1)
        path = tmp_path / "mine.yaml"
        path.write_text(text.replace("  seed: 1\n", "\n  ".join(["  seed: 1", *lines]) + "\n", 1))
        return str(path)

    return write


def answer(spin, name, *sets, **how):
    """The result of a run of a shipped protocol."""
    outcome, _ = spin(text_of(name), sets=("seed=7", *sets), **how)
    assert outcome.status == "complete", outcome.reason
    return analyze_runs([outcome.path])


def within(estimate, truth, relative):
    """Whether the truth lies in an interval that is no wider than this share of it on either side."""
    assert estimate.low <= truth <= estimate.high, estimate
    assert estimate.high - estimate.value <= relative * abs(truth), estimate
    return True


def test_no_load_loss(spin, bench_with):
    drag = 0.0008
    bench = bench_with(f"effects: [{{name: quadratic_drag, coefficient: {drag}}}]")
    result = answer(spin, "no-load-loss", "hold_s=0.7", "settle_s=0.3", "trials=1", bench=bench)
    assert within(result.find("coulomb_friction"), F, 0.03)
    assert within(result.find("viscous_damping"), B, 0.03)
    assert within(result.find("quadratic_drag"), drag, 0.03)
    assert within(result.find("no_load_loss"), 35 * (F + 35 * B + 35**2 * drag), 0.005)


def test_coast_down(spin):
    result = answer(spin, "coast-down", "hold_s=0.8", "trials=3")
    assert within(result.find("rotor_inertia"), J, 0.01)
    assert within(result.find("coulomb_friction"), F, 0.01)
    assert within(result.find("viscous_damping"), B, 0.03)
    assert within(result.find("damping_over_inertia"), B / J, 0.02)


@pytest.mark.long
def test_torque_pulses(spin, bench_with):
    loss = 0.1  # at 25 A
    bench = bench_with(f"effects: [{{name: saturation, loss: {loss}}}]")
    short = ("levels_A=[6, 12, 18, 24, 28]", "rest_s=0.3", "trials=1", "tare_samples=20")
    result = answer(spin, "torque-pulses", *short, bench=bench)
    kept = 1.0 / (1.0 + ((1.0 - loss) ** -2 - 1.0) * (28 / 25) ** 2) ** 0.5
    assert within(result.find("loss_at_peak"), 1.0 - kept, 0.15)
    assert within(result.find("torque_at_peak"), KT * 28 * kept, 0.01)
    assert within(result.find("torque_constant"), KT, 0.02)


def test_pulses_that_would_heat_a_phase_too_far_are_refused(spin):
    with pytest.raises(InputError, match=r"may take the test winding to its limit of 130 degC after"):
        answer(spin, "torque-pulses", "hold_s=8", "levels_A=[28]", "trials=1")


def test_back_drive(spin, bench_with):
    bench = bench_with("effects: [{name: cogging, amplitude: 0.03, order: 82}]")
    result = answer(spin, "back-drive", "trials=2", "hold_s=0.8", "settle_s=0.4", bench=bench)
    assert within(result.find("coulomb_friction"), F, 0.02)
    assert within(result.find("viscous_damping"), B, 0.03)
    assert result.find("cogging_order").value == 82
    assert within(result.find("cogging_amplitude"), 0.03, 0.05)
    assert result.find("breakaway_torque").value == pytest.approx(F, abs=0.03)  # cogging is added or taken off


def test_torque_sensor_calibration(spin, bench_with):
    bench = bench_with("effects: [{name: torque_sensor_gain, gain: 1.02}]")
    result = answer(spin, "torque-sensor-calibration", "hold_s=1", "settle_s=0.2", "repeats=2", bench=bench)
    assert within(result.find("sensitivity"), 1.02, 0.005)
    assert result.find("sensitivity").value == pytest.approx(1.02, rel=2e-4)  # the emulated gravity is the standard one
    assert any("multiply scale_per_V by 0.980" in note for note in result.notes)
    assert result.find("uncertainty_repeatability").value < 0.002


def test_torque_speed_envelope(spin):
    result = answer(spin, "torque-speed-envelope", "rest_s=2", "hold_s=0.5", "settle_s=0.2", "tare_samples=20")
    # |V|^2 = (R i + Kb w)^2 + (n L w i)^2 = (29.6 V)^2 / 2 at 28 A, winding at 25 degC, which the pulses warm by some K
    assert result.find("corner_speed").value == pytest.approx(26.86, rel=0.03)
    highest = result.find("highest_torque")
    assert highest.value == pytest.approx(KT * 28 - F - B * result.find("speed_of_highest_torque").value, rel=0.01)
