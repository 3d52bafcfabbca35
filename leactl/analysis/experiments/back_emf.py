"""Back-EMF constant: flux linkage of the three pairs of leads, wave by wave, while the load actuator turns the shaft.

Paper, section "Back-EMF Constant": amplitude and frequency of each wave of the line-to-line voltages, the speed from
that frequency and the pole pairs, Kb_q = Kb_ll / sqrt(2) of a wye. Amplitude over speed is taken here as one integral
over each wave (waves.py), so that a speed that drifts within a wave causes no error. The pole pairs are counted: turns
of the electrical angle for each turn of the shaft's encoder.
"""

import math
from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import Estimate, Noted, Plot, Result, Series, joined
from leactl.analysis.experiments.friction import refuse_torque_constant
from leactl.analysis.quality import current_convention
from leactl.analysis.quality.wrong_units import unit_notes
from leactl.analysis.run_model import model_of
from leactl.analysis.statistics.linefit import paths_of, setup_notes
from leactl.analysis.statistics.regression import t_quantile
from leactl.analysis.voltage_waves.harmonics import harmonics_of
from leactl.analysis.voltage_waves.line_voltages import PAIRS
from leactl.analysis.voltage_waves.pole_pairs import waves_per_turn, whole_pole_pairs
from leactl.analysis.voltage_waves.turning_holds import TurningHold, turning_holds
from leactl.analysis.voltage_waves.wave_means import CommonUncertainties, constant_of, drift_of
from leactl.errors import NotIdentifiable
from leactl.model.winding import FRAMES, WindingType
from leactl.runfile.read.reader import Run

RESULTS = {
    "back_emf_constant": "V*s/rad",
    "line_to_line_constant": "V*s/rad",
    "line_to_line_constant_ab": "V*s/rad",
    "line_to_line_constant_bc": "V*s/rad",
    "line_to_line_constant_ca": "V*s/rad",
    "unevenness": "1",
    "pole_pairs": "1",
    "electrical_frequency": "Hz",
    "torque_constant_ratio": "1",
    "total_harmonic_distortion": "1",
    "harmonic_2": "1",
    "harmonic_2_phase": "rad",
    "harmonic_3": "1",
    "harmonic_3_phase": "rad",
    "harmonic_5": "1",
    "harmonic_5_phase": "rad",
    "harmonic_7": "1",
    "harmonic_7_phase": "rad",
    "harmonic_11": "1",
    "harmonic_11_phase": "rad",
    "harmonic_13": "1",
    "harmonic_13_phase": "rad",
}

TIME_BASE_STD = 50e-6 / math.sqrt(3.0)  # a converter's quartz is good to 50 ppm (USB-6218 data sheet), evenly spread
MOST_UNEVENNESS = 0.005  # relative difference of pairs, or relative ripple of the speed; a note names larger ones
MOST_SUM_OF_THREE = 0.01  # sum of the three voltages, which should be zero, over the voltage of a pair
MOST_OFFSET = 0.01  # of the amplitude; a note names a larger offset of a channel
UNITS = "V*s/rad"


def analyze(
    runs: Sequence[Run], *, torque_constant: float | None = None, torque_constant_std: float | None = None
) -> Result:
    """Estimate back-EMF constants, pole pairs, harmonics, and the torque constant over the back-EMF constant.

    `back_emf_constant` [V*s/rad] (q axis, power-invariant), `line_to_line_constant` (amplitude over shaft speed, mean
    of the pairs) and `line_to_line_constant_ab`, `_bc`, `_ca`; `unevenness` of the pairs, `pole_pairs` as counted,
    `electrical_frequency` [Hz], `torque_constant_ratio` (Kt / Kb, 1 in theory), `total_harmonic_distortion` and
    `harmonic_2`, `_3`, `_5`, ... over the fundamental with their `_phase` [rad]: cos(x) + r_h cos(h x + phase_h).

    Parameters
    ----------
    runs : of one actuator under one condition, unpowered, whose steps `hold` a velocity of the shaft.
    torque_constant : [N*m/A], for the ratio; by default that of the runs' model.
    torque_constant_std : [N*m/A], its standard uncertainty.

    Raises
    ------
    NotIdentifiable : no pair with waves, too few of them, or a count of pole pairs that is no whole number.
    InputError : a torque constant that is no positive number, or an uncertainty below zero.
    """
    error_prefix = f"{paths_of(runs)}: back-EMF"
    notes = setup_notes(runs, ("coupled",), "another machine has to turn the shaft")
    usable_holds = joined(turning_holds(run) for run in runs)
    holds = usable_holds.value
    notes += usable_holds.notes
    if not holds:
        raise NotIdentifiable("\n".join([f"{error_prefix}: no hold with waves that can be used", *notes]))
    pole_pairs = pole_pairs_of(holds, error_prefix)
    pole_pair_estimate, poles = pole_pairs.value
    winding = winding_of(runs[0])
    notes += [*pole_pairs.notes, *winding.notes]

    constants_by_pair = {
        name: [poles * hold.linkages[name] for hold in holds if name in hold.linkages] for name in PAIRS
    }
    constants_by_pair = {name: constants for name, constants in constants_by_pair.items() if constants}
    common_uncertainties = CommonUncertainties(
        scale=max(hold.scale_std for hold in holds),
        time_base=TIME_BASE_STD,
        resolution=max(hold.resolution for hold in holds),
        ripple=max(hold.shaft.ripple for hold in holds),
    )
    mean_constants = [poles * hold.mean_of_pairs for hold in holds]
    all_complete = all(hold.complete for hold in holds)
    line_constant = constant_of(
        "line_to_line_constant",
        UNITS,
        mean_constants,
        common_uncertainties if all_complete else common_uncertainties.of_one_pair,
    )
    if any(hold.sum_of_three > MOST_SUM_OF_THREE for hold in holds):
        widened_constant = widened_by_scatter(line_constant, constants_by_pair)
        line_constant = widened_constant.value
        notes += widened_constant.notes
    kb = scaled_estimate(line_constant, FRAMES[winding.value].back_emf, "back_emf_constant", UNITS)
    results = [kb, line_constant]
    results += [
        constant_of(f"line_to_line_constant_{name}", UNITS, constants, common_uncertainties.of_one_pair)
        for name, constants in constants_by_pair.items()
    ]
    if len(constants_by_pair) > 1:
        results.append(unevenness(constants_by_pair, common_uncertainties))
    results.append(pole_pair_estimate)
    results.append(
        constant_of(
            "electrical_frequency", "Hz", [hold.angle.frequencies for hold in holds], common_uncertainties.of_time
        )
    )
    ratio = torque_constant_ratio(runs, kb, torque_constant, torque_constant_std)
    results += [*ratio.value, *harmonics_of(holds)]

    notes += [*ratio.notes, *measurement_notes(holds, constants_by_pair, common_uncertainties, all_complete)]
    notes[:0] = unit_notes(runs, [kb], ["phase_voltage"])
    paths = tuple(str(run.path) for run in runs)
    return Result(
        "back-emf", paths, tuple(results), tuple(notes), (plot_over_time(holds, poles), plot_of_wave(holds, poles))
    )


def pole_pairs_of(holds: Sequence[TurningHold], error_prefix: str) -> Noted[tuple[Estimate, int]]:
    """Estimate the waves a turn, and return the number of pole pairs; a note names a model with another number.

    Raises
    ------
    NotIdentifiable : the pole pairs are no whole number, or differ between holds.
    """
    turn_estimates = [waves_per_turn(len(hold.angle.edges) - 1, hold.shaft) for hold in holds]
    pole_pair_counts = {
        whole_pole_pairs(value, std, f"{hold.run.path} from {hold.start:.2f} s")
        for hold, (value, std) in zip(holds, turn_estimates, strict=True)
    }
    if len(pole_pair_counts) > 1:
        raise NotIdentifiable(
            f"{error_prefix}: pole pairs of {' and '.join(map(str, sorted(pole_pair_counts)))} in different holds"
        )
    poles = pole_pair_counts.pop()
    waves_a_turn, stds = np.array(turn_estimates).T
    value, std = float(waves_a_turn.mean()), math.sqrt(float(np.sum(stds**2))) / len(turn_estimates)
    half_width = 1.96 * std
    notes = []
    for path, model_count in {str(hold.run.path): model_of(hold.run).get("pole_pairs") for hold in holds}.items():
        if model_count == 2 * poles:
            notes.append(
                f"{path}: the model has {model_count} pole pairs; {poles} were counted: its figure is that of poles"
            )
        elif isinstance(model_count, int) and model_count != poles:
            notes.append(
                f"{path}: the model has {model_count} pole pairs; {poles} were counted, by which the speed is taken:"
                f" the model or the encoder's counts a turn are wrong; by {model_count} every constant would be"
                f" {model_count / poles:.3g} times as large"
            )
    return Noted((Estimate("pole_pairs", value, std, value - half_width, value + half_width, "1"), poles), tuple(notes))


def winding_of(run: Run) -> Noted[WindingType]:
    """Return the winding that a run's model states, `wye` or `delta`; if it states neither, `wye` and a note."""
    winding = model_of(run).get("winding")
    if winding not in FRAMES:
        return Noted("wye", (f"{run.path}: no winding in its model; wye is taken, Kb_q = Kb_ll / sqrt(2)",))
    if winding == "delta":
        note = "the winding is a delta: Kb_q = sqrt(3/2) Kb_ll in its own frame, Kb_ll / sqrt(2) as a wye's"
        return Noted("delta", (note,))
    return Noted(winding)


def scaled_estimate(estimate: Estimate, factor: float, name: str, units: str) -> Estimate:
    """Return an estimate under another name, multiplied by an exact number."""
    value, std, low, high = (factor * number for number in (estimate.value, estimate.std, estimate.low, estimate.high))
    return Estimate(name, value, std, low, high, units)


def widened_by_scatter(line_constant: Estimate, constants_by_pair: dict[str, list[np.ndarray]]) -> Noted[Estimate]:
    """Return the pairs' mean with an interval widened by their scatter: it is not known which of them is wrong."""
    means = [
        float(np.mean([np.nanmean(wave_constants) for wave_constants in hold_constants]))
        for hold_constants in constants_by_pair.values()
    ]
    standard_error = float(np.std(means, ddof=1)) / math.sqrt(len(means))
    half_width = math.hypot(0.5 * (line_constant.high - line_constant.low), t_quantile(len(means) - 1) * standard_error)
    std = math.hypot(line_constant.std, standard_error)
    note = (
        "line_to_line_constant and back_emf_constant: the pairs contradict each other, so that the uncertainty holds"
        f" their scatter of {standard_error / line_constant.value:.2%} on the mean"
    )
    return Noted(
        Estimate(
            line_constant.name,
            line_constant.value,
            std,
            line_constant.value - half_width,
            line_constant.value + half_width,
            UNITS,
        ),
        (note,),
    )


def unevenness(constants_by_pair: dict[str, list[np.ndarray]], common_uncertainties: CommonUncertainties) -> Estimate:
    """Estimate the difference of the largest and the smallest pair over the pairs' mean; their shared scale cancels."""
    estimates = [
        constant_of(name, UNITS, wave_constants, common_uncertainties.between_pairs)
        for name, wave_constants in constants_by_pair.items()
    ]
    values = [estimate.value for estimate in estimates]
    mean = sum(values) / len(values)
    value = (max(values) - min(values)) / mean
    std = math.hypot(estimates[values.index(max(values))].std, estimates[values.index(min(values))].std) / mean
    low = value - 1.96 * std if value > 3.5 * std else 0.0
    return Estimate("unevenness", value, std, low, value + 1.96 * std, "1")


def torque_constant_ratio(
    runs: Sequence[Run], kb: Estimate, given_constant: float | None, std: float | None
) -> Noted[list[Estimate]]:
    """Estimate Kt over Kb; return an empty list if no Kt is known.

    The ratio is 1 in theory; a wrong convention of current makes it 0.82, 1.22 or 1.73.

    Raises
    ------
    InputError : see `refuse_torque_constant`.
    """
    refuse_torque_constant(given_constant, std)
    kt = given_constant if given_constant is not None else model_of(runs[0]).get("torque_constant")
    if not isinstance(kt, int | float) or isinstance(kt, bool) or kt <= 0.0:
        return Noted([], ("no torque constant is known to compare with: give --torque-constant",))
    source = "as given" if given_constant is not None else "of the model in the run"
    ratio = kt / kb.value
    relative_std = math.hypot(kb.std / kb.value, (std or 0.0) / kt)
    notes = []
    reason = current_convention.reason_for_ratio(ratio, given_constant is not None)
    if reason:
        notes.append(
            f"the torque constant {kt:g} N*m/A, {source}, is {ratio:.3f} times the back-EMF constant: {reason}"
        )
    half_width = ratio * math.hypot(0.5 * (kb.high - kb.low) / kb.value, 1.96 * (std or 0.0) / kt)
    uncertainty_text = "its own uncertainty is in the ratio's" if std else "its own uncertainty is not in the ratio's"
    notes.append(f"torque_constant_ratio is with {kt:g} N*m/A, {source}; {uncertainty_text}")
    estimate = Estimate(
        "torque_constant_ratio", ratio, relative_std * ratio, ratio - half_width, ratio + half_width, "1"
    )
    return Noted([estimate], tuple(notes))


def measurement_notes(
    holds: Sequence[TurningHold],
    constants_by_pair: dict[str, list[np.ndarray]],
    common_uncertainties: CommonUncertainties,
    complete: bool,
) -> list[str]:
    """Return notes on uncertainties, uneven and drifting pairs, offsets, and ripple of the speed.

    `complete` states whether every hold has at least two pairs.
    """
    notes = [
        "uncertainties hold the scatter of the waves, the converter's steps and time base"
        + (
            f" and {common_uncertainties.scale:.2g} of its scale"
            if common_uncertainties.scale
            else "; the uncertainty of its scale is not known"
        )
    ]
    if not complete:
        notes.append("fewer than two pairs: how uneven the others are is not in the uncertainty of the constant")
    for hold in holds:
        opening = f"{hold.run.path} from {hold.start:.2f} s"
        notes += [f"{opening}: {text}" for text in hold.findings]
        if hold.shaft.ripple > MOST_UNEVENNESS:
            notes.append(
                f"{opening}: the speed ripples by {hold.shaft.ripple:.2%} twice a wave, which moves single pairs by a"
                " quarter of that, and their mean by nothing"
            )
        if hold.sum_of_three > MOST_SUM_OF_THREE:
            notes.append(
                f"{opening}: the three voltages leave {hold.sum_of_three:.1%} of a pair, and not zero: a channel's"
                " scale is off, or a pair is not measured at the motor's leads"
            )
        for name, offset in hold.offsets.items():
            if abs(offset) > MOST_OFFSET * hold.amplitudes[name]:
                notes.append(f"{opening}: pair {name} is offset by {offset:+.3g} V, which does not count")
        drifts = {
            name: drift_of(wave_constants) / float(np.nanmean(wave_constants))
            for name, wave_constants in hold.linkages.items()
        }
        drifting = {name: change for name, change in drifts.items() if change}
        changes = ", ".join(f"{name} by {change:+.2%}" for name, change in drifting.items())
        if len(drifting) == len(drifts) and len(drifts) > 1:
            notes.append(f"{opening}: all pairs drift ({changes}): the magnets' temperature, or the converter's scale")
        elif drifting:
            notes.append(f"{opening}: pair {changes} drifts, others do not: its channel, or the contacts of its leads")
    pair_constants = [
        float(np.nanmean(np.concatenate(wave_constants))) for wave_constants in constants_by_pair.values()
    ]
    if max(pair_constants) - min(pair_constants) > MOST_UNEVENNESS * max(pair_constants):
        notes.append(
            f"the pairs differ by {(max(pair_constants) - min(pair_constants)) / max(pair_constants):.1%}:"
            " windings, dividers or contacts"
        )
    return notes


def plot_over_time(holds: Sequence[TurningHold], poles: int) -> Plot:
    """Return the plot of the line-to-line constant of every wave over the time of its middle."""
    points = []
    for name in PAIRS:
        holds_with_pair = [hold for hold in holds if name in hold.linkages]
        if holds_with_pair:
            time = np.concatenate([0.5 * (hold.angle.edges[1:] + hold.angle.edges[:-1]) for hold in holds_with_pair])
            constants = np.concatenate([poles * hold.linkages[name] for hold in holds_with_pair])
            points.append(Series(name, tuple(time.tolist()), tuple(constants.tolist())))
    mean_constant = float(np.nanmean(np.concatenate([poles * hold.mean_of_pairs for hold in holds])))
    times = [time_of_wave for series in points for time_of_wave in series.x]
    line = Series("mean", (min(times), max(times)), (mean_constant, mean_constant))
    return Plot("time [s]", f"Kb line to line [{UNITS}]", tuple(points), (line,))


def plot_of_wave(holds: Sequence[TurningHold], poles: int) -> Plot:
    """Return the plot of each pair's mean wave in the first hold over the electrical angle, at a speed of 1 rad/s."""
    angle = np.linspace(0.0, 2.0 * math.pi, 49)
    points = []
    for name in PAIRS:
        linkages = [hold.waves[name].linkage for hold in holds if name in hold.waves]
        if linkages:
            mean_linkage = np.nanmean(linkages[0], axis=1)
            orders = np.arange(1, len(mean_linkage) + 1)[:, np.newaxis]
            wave = poles * np.sum(
                np.abs(mean_linkage)[:, np.newaxis] * np.cos(orders * angle + np.angle(mean_linkage)[:, np.newaxis]),
                axis=0,
            )
            points.append(Series(name, tuple(angle.tolist()), tuple(wave.tolist())))
    return Plot("electrical angle [rad]", f"voltage over speed [{UNITS}]", tuple(points), ())
