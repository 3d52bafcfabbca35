"""Back-EMF on voltages from closed forms: constants, harmonics, pole pairs, and what is wrong at the leads."""

import math

import numpy as np
import pytest

from leactl.analysis.experiments.back_emf import analyze
from leactl.analysis.voltage_waves.line_voltages import PAIRS
from leactl.errors import InputError, NotIdentifiable

from .open_leads import KB, SPEED, OpenLeads
from .synthetic import analyzed, covered

LINE = math.sqrt(2.0) * KB


@pytest.fixture
def leads(tmp_path):
    return OpenLeads(tmp_path)


def found(leads, **how):
    return analyzed(analyze, leads.run(**how))


def noted(result, text):
    return [note for note in result.notes if text in note]


def test_constants_of_the_q_axis_line_to_line_and_each_pair(leads):
    result = found(leads)
    assert result.find("back_emf_constant").value == pytest.approx(KB, rel=2e-5)
    for name in ("line_to_line_constant", *(f"line_to_line_constant_{pair}" for pair in PAIRS)):
        item = result.find(name)
        assert item.value == pytest.approx(LINE, rel=5e-5)
        assert covered(item, LINE)
        assert 2 * item.std < item.high - item.low < 8 * item.std
    assert result.find("pole_pairs").value == pytest.approx(41, abs=0.02)
    assert result.find("electrical_frequency").value == pytest.approx(41.0, rel=1e-5)
    assert result.find("torque_constant_ratio").value == pytest.approx(1.0, abs=1e-4)
    assert covered(result.find("unevenness"), 0.0)
    assert covered(result.find("total_harmonic_distortion"), 0.0)
    assert math.isnan(result.find("harmonic_5_phase").value)
    assert len(result.notes) == 2  # where Kt is from, and what the uncertainties hold


def test_the_scale_of_the_converter_is_in_the_uncertainty_and_not_between_pairs(leads):
    plain, scaled = found(leads, scale_std=0.0), found(leads, scale_std=1e-3)
    assert scaled.find("back_emf_constant").std == pytest.approx(1e-3 * KB, rel=0.01)
    assert plain.find("back_emf_constant").std < 1e-4 * KB
    assert scaled.find("unevenness").std == pytest.approx(plain.find("unevenness").std, rel=0.5)
    assert noted(plain, "the uncertainty of its scale is not known")


@pytest.mark.parametrize("speeds", [(SPEED,), (-SPEED,), (SPEED, -SPEED), (3.0, 15.0)])
def test_either_rotation_and_any_speed_give_the_same(leads, speeds):
    harmonics = [(5, 0.03, 0.7), (7, 0.01, -2.0)]
    result = found(leads, speeds=speeds, harmonics=harmonics)
    assert result.find("back_emf_constant").value == pytest.approx(KB, rel=5e-5)
    assert result.find("total_harmonic_distortion").value == pytest.approx(math.hypot(0.03, 0.01), rel=0.01)
    for order, share, phase in harmonics:
        assert result.find(f"harmonic_{order}").value == pytest.approx(share, abs=1e-4)
        assert result.find(f"harmonic_{order}_phase").value == pytest.approx(phase, abs=0.02)
        assert covered(result.find(f"harmonic_{order}_phase"), phase)
    assert not noted(result, "sense of rotation")


@pytest.mark.parametrize("sag", [0.02, 0.3])
def test_a_speed_that_drifts_within_a_wave_is_no_error(leads, sag):
    """At 0.3 a wave loses 0.4 % of its speed; the amplitude over the mean speed is not taken."""
    result = found(leads, sag=sag, harmonics=[(5, 0.05, 0.0)])
    assert result.find("back_emf_constant").value == pytest.approx(KB, rel=5e-5)
    assert result.find("harmonic_5").value == pytest.approx(0.05, abs=2e-4)
    assert not noted(result, "drift")


def test_a_ripple_of_the_speed_moves_pairs_and_is_in_their_uncertainty_not_in_the_mean(leads):
    result = found(leads, ripple=0.02)
    assert result.find("line_to_line_constant").value == pytest.approx(LINE, rel=1e-4)
    pairs = [result.find(f"line_to_line_constant_{pair}") for pair in PAIRS]
    assert max(abs(item.value / LINE - 1.0) for item in pairs) > 2e-3
    assert all(covered(item, LINE) for item in pairs)
    assert (
        covered(result.find("unevenness"), 0.0) or result.find("unevenness").value < 2.5 * result.find("unevenness").std
    )
    assert noted(result, "ripples by 2.0")


def test_uneven_pairs_are_compared(leads):
    result = found(leads, gains=(1.0, 1.02, 0.99))
    assert result.find("unevenness").value == pytest.approx(0.03 / (3.01 / 3), rel=0.01)
    assert result.find("line_to_line_constant_bc").value == pytest.approx(1.02 * LINE, rel=1e-4)
    assert noted(result, "the pairs differ by 2.9%")
    assert noted(result, "leave 2.6% of a pair, and not zero")


def one_pair(name, change):
    def edit(time, columns):
        columns[name] = change(time, columns[name])

    return edit


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda time, volts: 0.003 * np.sin(time), "pair bc from 0.50 s is dead"),
        (lambda time, volts: np.full_like(volts, np.nan), "pair bc has no samples"),
        (lambda time, volts: np.clip(volts, -3.5, 3.5), "pair bc from 0.50 s is clipped at 3.5"),
        (lambda time, volts: np.where(np.abs(volts) < 4.0, volts, np.nan), "lacks the crests of its waves, beyond 4"),
    ],
)
def test_a_pair_that_cannot_be_used_is_taken_from_the_other_two(leads, change, said):
    result = found(leads, edit=one_pair("bc", change))
    assert noted(result, said)
    assert noted(result, "pair bc is computed from the other two")
    assert result.find("back_emf_constant").value == pytest.approx(KB, rel=1e-4)
    with pytest.raises(InputError, match="has no result"):
        result.find("line_to_line_constant_bc")


def test_two_pairs_of_uneven_windings_give_the_mean_of_three(leads):
    def uneven(time, columns):
        columns["bc"] *= 1.04
        columns["ca"][:] = np.nan

    result = found(leads, edit=uneven, noise=0.0)
    third = math.sqrt(1.0 + 1.04**2 + 2 * 1.04 * math.cos(2 * math.pi / 3))
    assert result.find("line_to_line_constant").value == pytest.approx(LINE * (1.0 + 1.04 + third) / 3, rel=1e-4)


def test_one_pair_alone_says_what_it_cannot_know(leads):
    def edit(time, columns):
        columns["ab"][:] = columns["ca"][:] = np.nan

    result = found(leads, edit=edit)
    assert result.find("back_emf_constant").value == pytest.approx(KB, rel=1e-4)
    assert noted(result, "fewer than two pairs")


@pytest.mark.parametrize("name", PAIRS)
def test_swapped_leads_of_a_pair_are_named(leads, name):
    result = found(leads, edit=one_pair(name, lambda time, volts: -volts), harmonics=[(5, 0.03, 0.7)])
    assert noted(result, f"pair {name} has its two leads swapped")
    assert not noted(result, "sense of rotation")
    assert result.find("back_emf_constant").value == pytest.approx(KB, rel=1e-4)
    assert result.find("harmonic_5_phase").value == pytest.approx(0.7, abs=0.02)


def test_exchanged_and_doubled_pairs_are_named(leads):
    def exchange(time, columns):
        columns["bc"], columns["ca"] = columns["ca"], columns["bc"]

    assert noted(found(leads, edit=exchange), "against the sense of rotation")

    def double(time, columns):
        columns["bc"] = columns["ab"].copy()

    assert noted(found(leads, edit=double), "not thirds of a wave apart (bc ")


def test_a_pair_that_drifts_is_named_and_widens_its_interval(leads):
    plain = found(leads).find("line_to_line_constant_bc")
    result = found(leads, edit=one_pair("bc", lambda time, volts: volts * (1.0 + 0.004 * (time - 1.75))))
    assert noted(result, "pair bc by +0.9")
    assert noted(result, "others do not")
    item = result.find("line_to_line_constant_bc")
    assert item.std > 20 * plain.std
    assert covered(item, LINE)
    shifted = found(leads, edit=one_pair("ca", lambda time, volts: volts + 0.3))
    assert noted(shifted, "pair ca is offset by +0.3 V")
    assert shifted.find("line_to_line_constant_ca").value == pytest.approx(LINE, rel=1e-4)


@pytest.mark.parametrize(
    ("told", "said"), [(20, "the model has 20 pole pairs; 41 were counted"), (82, "is that of poles")]
)
def test_a_wrong_pole_count_of_the_model_is_named_and_changes_nothing(leads, told, said):
    result = found(leads, model=f"torque_constant: 0.49\npole_pairs: {told}\nwinding: wye\n")
    assert noted(result, said)
    assert result.find("back_emf_constant").value == pytest.approx(KB, rel=1e-4)


def test_a_count_that_is_no_whole_number_is_refused(leads):
    with pytest.raises(NotIdentifiable, match="waves a turn are no whole number of pole pairs"):
        found(leads, poles=40.5)


def test_a_velocity_serves_where_there_is_no_angle(leads):
    result = found(leads, with_angle=False)
    assert result.find("pole_pairs").value == pytest.approx(41, abs=0.05)
    assert result.find("back_emf_constant").value == pytest.approx(KB, rel=1e-4)


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (math.sqrt(1.5), "a phase amplitude taken for q-axis current"),
        (math.sqrt(2 / 3), "q-axis current taken for a phase amplitude"),
        (math.sqrt(3.0), "a phase rms taken for q-axis current"),
    ],
)
def test_ratios_of_wrong_current_conventions_are_named(leads, factor, said):
    result = analyzed(analyze, leads.run(), torque_constant=0.49 * factor, torque_constant_std=0.001)
    assert result.find("torque_constant_ratio").value == pytest.approx(factor, rel=1e-3)
    assert noted(result, said)
    assert not noted(analyzed(analyze, leads.run(), torque_constant=0.5), "convention")


@pytest.mark.parametrize(
    ("factor", "said"),
    [(math.sqrt(1 / 3), "from lead to star point"), (math.sqrt(3.0), "multiplied by sqrt(3)")],
)
def test_against_a_model_s_torque_constant_the_voltages_are_asked_and_no_current_that_none_measured(
    leads, factor, said
):
    result = found(leads, gains=(factor,) * 3)
    (note,) = noted(result, "times the back-EMF constant")
    assert said in note
    assert "current_convention" not in note


def test_pairs_that_contradict_each_other_are_all_in_the_interval_of_their_mean(leads):
    result = found(leads, gains=(1.0, 1.1, 1.0))
    mean = result.find("line_to_line_constant")
    assert all(covered(mean, result.find(f"line_to_line_constant_{pair}").value) for pair in PAIRS)
    assert covered(result.find("back_emf_constant"), KB)
    assert covered(result.find("torque_constant_ratio"), 1.0)
    assert noted(result, "the pairs contradict each other")

    def windings(time, columns):  # uneven ones leave nothing of the sum: the mean is as well known as ever
        columns["bc"] *= 1.04
        columns["ca"][:] = -columns["ab"] - columns["bc"]

    sharp = found(leads, edit=windings, told_skew=True, skew_s=0.0)
    assert noted(sharp, "the pairs differ by")
    assert not noted(sharp, "contradict")
    assert sharp.find("line_to_line_constant").std < 1e-3 * LINE


def test_a_delta_has_a_q_axis_of_its_own_frame(leads):
    result = found(leads, model="torque_constant: 0.49\npole_pairs: 41\nwinding: delta\n")
    assert result.find("back_emf_constant").value == pytest.approx(math.sqrt(1.5) * LINE, rel=1e-4)
    assert noted(result, "delta")


def test_missing_samples_cost_their_waves_and_nothing_else(leads):
    def edit(time, columns):
        for volts in columns.values():
            volts[(time > 1.0) & (time < 1.2)] = np.nan

    result = found(leads, edit=edit)
    assert noted(result, "waves lack samples and do not count")
    assert result.find("back_emf_constant").value == pytest.approx(KB, rel=5e-5)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"seconds": 0.2}, r"8\.\d waves of .* 12 at least are needed"),
        ({"rate_Hz": 200}, r"4\.9 samples a wave of 41"),
        ({"noise": 30.0}, "no wave stands out"),
        ({"enabled": True}, "the test drive was enabled"),
        (
            {"edit": lambda time, columns: [volts.fill(np.nan) for volts in columns.values()]},
            "no pair that can be used",
        ),
    ],
)
def test_what_no_constant_can_be_found_from(leads, how, said):
    with pytest.raises(NotIdentifiable, match=said):
        found(leads, **how)


def test_a_run_without_steps_is_used_whole_and_skew_that_is_not_told_changes_no_constant(leads):
    result = found(leads, steps=False, told_skew=False)
    assert noted(result, "the run has no steps")
    assert result.find("back_emf_constant").value == pytest.approx(KB, rel=1e-4)


@pytest.mark.parametrize(("value", "std"), [(-0.4, None), (math.nan, None), (0.4, -0.1)])
def test_torque_constants_that_make_no_sense_are_refused(leads, value, std):
    with pytest.raises(InputError, match="was expected"):
        analyzed(analyze, leads.run(), torque_constant=value, torque_constant_std=std)


def test_intervals_hold_the_constant_as_often_as_they_say(leads):
    """20 runs with an error of scale each: 16 or fewer have a chance of 1 in 400."""
    hits = 0
    for _ in range(20):
        scale = 1.0 + 3e-4 * leads.rng.standard_normal()
        path = leads.run(seconds=0.5, rate_Hz=4000, scale_std=3e-4, gains=(scale,) * 3, noise=0.02)
        hits += covered(analyzed(analyze, path).find("back_emf_constant"), KB)
    assert hits >= 17
