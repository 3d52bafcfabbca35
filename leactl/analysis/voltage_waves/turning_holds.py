"""Holds of a turning shaft with open leads: electrical angle, waves and lead connection of each hold."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import Noted
from leactl.analysis.voltage_waves.line_voltages import PAIRS, LineVoltage, connection_of, line_voltages, third_voltage
from leactl.analysis.voltage_waves.pole_pairs import ShaftMotion, shaft_motion
from leactl.analysis.voltage_waves.waves import FEWEST_WAVES, Angle, Array, Waves, follow, waves_of
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Run


@dataclass(frozen=True, eq=False)
class TurningHold:
    """One hold of a turning shaft: waves of each pair of leads over one electrical angle."""

    run: Run
    start: float  # s
    angle: Angle
    shaft: ShaftMotion
    waves: Mapping[str, Waves]
    linkages: Mapping[str, Array]  # V*s, flux linkage of each pair's fundamental, shape (waves,)
    mean_of_pairs: Array  # V*s, mean of `linkages`; with two pairs, the third is computed from them
    complete: bool  # whether the mean is over three pairs
    offsets: Mapping[str, float]  # V, mean of each pair's voltage
    amplitudes: Mapping[str, float]  # V, of each pair's fundamental
    sum_of_three: float  # magnitude of the fundamentals' sum over their mean magnitude; see `check_connection` for NaN
    scale_std: float  # relative, largest of the pairs
    resolution: float  # relative standard uncertainty by rounding, if every wave rounds alike
    findings: Sequence[str]  # notes on swapped leads and left-out waves


def turning_holds(run: Run) -> Noted[list[TurningHold]]:
    """Return the holds of a run whose waves are usable; notes say why other holds are not."""
    hold_spans = spans_of(run)
    holds, notes = [], [*hold_spans.notes]
    for start, stop in hold_spans.value:
        try:
            refuse_powered(run, start, stop)
            pairs = line_voltages(run, start, stop)
            notes += pairs.notes
            followed_waves = follow_waves(run, start, pairs.value)
            notes += followed_waves.notes
            holds.append(turning_hold(run, start, pairs.value, *followed_waves.value))
        except NotIdentifiable as fault:
            notes.append(f"{run.path} from {start:.2f} s: {fault}")
    return Noted(holds, tuple(notes))


def spans_of(run: Run) -> Noted[list[tuple[float, float]]]:
    """Return start and stop [s] of each settled hold of a velocity, or of the whole record if the run has no steps."""
    steps = run.steps
    if not steps:
        channels = [channel for name in PAIRS for channel in run.channels(f"phase_voltage_{name}", role="test")]
        times = [channel.time for channel in channels if len(channel.time)]
        note = f"{run.path}: the run has no steps; its whole record is used"
        if not times:
            return Noted([], (note,))
        stop = math.nextafter(max(time[-1] for time in times), math.inf)
        return Noted([(min(time[0] for time in times), stop)], (note,))
    spans = []
    for step in steps:
        speed = step.parameters.get("velocity_rad_s")
        if step.name == "hold" and isinstance(speed, int | float) and not isinstance(speed, bool) and speed != 0:
            spans.append((step.start + step.settle, step.stop))
    note = f"{run.path}: no step named 'hold' with velocity_rad_s among its {len(steps)}"
    return Noted(spans, () if spans else (note,))


def follow_waves(run: Run, start: float, pairs: Mapping[str, LineVoltage]) -> Noted[tuple[Angle, dict[str, Waves]]]:
    """Return the electrical angle of a hold that begins at `start` [s], and the waves of each pair over it.

    Notes name the pairs with too few whole waves, which are left out.

    Raises
    ------
    NotIdentifiable : `pairs` is empty, or no wave can be followed.
    """
    if not pairs:
        raise NotIdentifiable("no pair that can be used")
    angle = follow(pairs[best_pair(pairs)].record)
    waves = {name: waves_of(pair.record, angle) for name, pair in pairs.items()}
    notes = []
    for name in list(waves):
        count = int(np.isfinite(waves[name].offset).sum())
        if count < FEWEST_WAVES:
            notes.append(f"{run.path}: pair {name} from {start:.2f} s has {count} whole waves; it does not count")
            del waves[name]
    return Noted((angle, waves), tuple(notes))


def turning_hold(
    run: Run, start: float, pairs: Mapping[str, LineVoltage], angle: Angle, waves: Mapping[str, Waves]
) -> TurningHold:
    """Return a hold that begins at `start` [s], from the waves of its pairs over one electrical angle.

    Raises
    ------
    NotIdentifiable : no pair has enough waves, or no channel shows how far the shaft turned.
    """
    if not waves:
        raise NotIdentifiable(f"no pair with {FEWEST_WAVES} whole waves")
    linkages = {name: fundamental_linkages(pair_waves) for name, pair_waves in waves.items()}
    frequency = float(angle.frequencies.mean())
    amplitudes = {
        name: 2.0 * math.pi * frequency * float(np.nanmean(pair_linkages)) for name, pair_linkages in linkages.items()
    }
    shaft = shaft_motion(run, angle)
    findings, sum_of_three, corrected_waves = check_connection(waves, shaft)
    lost_count = len(angle.edges) - 1 - min(int(np.isfinite(pair_waves.offset).sum()) for pair_waves in waves.values())
    if lost_count:
        findings.append(f"{lost_count} of {len(angle.edges) - 1} waves lack samples and do not count")
    linkages_of_pairs = list(linkages.values())
    if len(waves) == 2:
        third_linkage = third_voltage([pair_waves.linkage[0] for pair_waves in waves.values()])
        linkages_of_pairs.append(fundamental_linkages(Waves(third_linkage[np.newaxis], np.zeros(0))))
        missing_pair = next(name for name in PAIRS if name not in waves)
        findings.append(f"pair {missing_pair} is computed from the other two: all three add up to zero")
    samples_per_wave = len(angle.time) / max(len(angle.edges) - 1, 1)
    rounding_stds = {
        name: pairs[name].resolution / math.sqrt(12.0) * math.sqrt(2.0 / samples_per_wave) / amplitudes[name]
        for name in waves
    }
    return TurningHold(
        run=run,
        start=start,
        angle=angle,
        shaft=shaft,
        waves=corrected_waves,
        linkages=linkages,
        mean_of_pairs=np.mean(linkages_of_pairs, axis=0),
        complete=len(linkages_of_pairs) == len(PAIRS),
        offsets={name: float(np.nanmean(pair_waves.offset)) for name, pair_waves in waves.items()},
        amplitudes=amplitudes,
        sum_of_three=sum_of_three,
        scale_std=max(pairs[name].scale_std for name in waves),
        resolution=max(rounding_stds.values()),
        findings=findings,
    )


def refuse_powered(run: Run, start: float, stop: float) -> None:
    """Raise NotIdentifiable if the drive was enabled between two times [s]: the leads carry more than back-EMF then."""
    for channel in run.channels("drive_enabled", role="test"):
        samples = slice(*np.searchsorted(channel.time, (start, stop)).tolist())
        if np.any(channel.values[samples] > 0.0):
            raise NotIdentifiable("the test drive was enabled: its leads carry more than back-EMF")


def best_pair(pairs: Mapping[str, LineVoltage]) -> str:
    """Return the name of the pair with the fewest missing samples; of several such pairs, that with the largest rms."""

    def quality_of(name: str) -> tuple[float, float]:
        values = pairs[name].record.values
        return float(np.mean(np.isfinite(values))), float(np.nanstd(values))

    return max(pairs, key=quality_of)


def fundamental_linkages(waves: Waves) -> Array:
    """Return the flux linkage of each wave's fundamental in phase with their mean [V*s], shape (waves,)."""
    fundamental = waves.linkage[0]
    mean = complex(np.nanmean(fundamental))
    return np.asarray((fundamental * np.conj(mean) / abs(mean)).real)


def check_connection(waves: Mapping[str, Waves], shaft: ShaftMotion) -> tuple[list[str], float, dict[str, Waves]]:
    """Return notes on the phases of three pairs, the relative magnitude of their sum, and waves with corrected signs.

    With fewer than three pairs, or phases that no connection explains, the magnitude is NaN and no sign is corrected.
    """
    phasors = {name: complex(np.nanmean(pair_waves.linkage[0])) for name, pair_waves in waves.items()}
    if len(phasors) < len(PAIRS):
        return [], math.nan, dict(waves)
    connection = connection_of(phasors)
    if connection is None:
        phases = ", ".join(
            f"{name} {math.degrees(math.remainder(float(np.angle(value / phasors['ab'])), 2 * math.pi)):+.0f} degrees"
            for name, value in phasors.items()
            if name != "ab"
        )
        return (
            [f"the pairs are not thirds of a wave apart ({phases} from ab): a pair is mislabelled"],
            math.nan,
            dict(waves),
        )
    findings = [f"pair {name} has its two leads swapped" for name, sign in connection.signs.items() if sign < 0]
    if connection.forward != (shaft.rotation > 0.0):
        findings.append(
            "the pairs follow one another against the sense of rotation: two leads, or two pairs' channels, are"
            " exchanged, or the encoder's sign is wrong"
        )
    corrected_waves = {
        name: Waves(connection.signs[name] * pair_waves.linkage, pair_waves.offset)
        for name, pair_waves in waves.items()
    }
    sum_of_three = abs(sum(connection.signs[name] * phasor for name, phasor in phasors.items()))
    return findings, sum_of_three / (sum(map(abs, phasors.values())) / len(phasors)), corrected_waves
