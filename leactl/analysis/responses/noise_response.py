"""Frequency response of a drive's loops to noise about several levels: -3 dB bandwidth and the band that is known.

Paper, section "Controller Performance": Blackman-Tukey with a window of 400 samples, bandwidth at the -3 dB crossover,
mean over trials and levels. A response is known below the noise's cut-off where its coherence is 0.6 or more (Tischler
& Remple, Aircraft and Rotorcraft System Identification, 2nd ed., section 2.2). It holds for noise of that amplitude:
of a smaller amplitude, friction takes a larger share.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Noted, Plot, Result, Series, joined, plot_slice
from leactl.analysis.responses.bandwidth import HALF_POWER, bandwidth_of
from leactl.analysis.responses.blackman_tukey import BlackmanTukey, Mask, Response, Spectra, sum_of_spectra
from leactl.analysis.responses.noise_records import NoiseExperiment, NoiseRecord, records_of
from leactl.analysis.statistics.linefit import paths_of, setup_notes
from leactl.analysis.statistics.regression import Array
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Run

NOISE_RESULTS = {
    "bandwidth": "Hz",
    "coherent_band_low": "Hz",
    "coherent_band_high": "Hz",
}
WINDOW_LAGS = 400  # of the window to either side, as in the paper
LEAST_COHERENCE = 0.6  # of a known response (Tischler & Remple, section 2.2)
SAMPLING_SHOWS_ABOVE = 0.1  # of the record's rate; above it, holding and sampling change the response
MOST_POINTS = 80  # of a level in a plot


def noise_response(runs: Sequence[Run], loop: NoiseExperiment) -> Result:
    """Estimate the bandwidth of the test actuator's loop.

    `bandwidth` [Hz]: where the gain first falls below -3 dB, mean over the levels. If the gain stays above -3 dB in the
    known band, the value is NaN and `low` is the frequency up to which it stays above, at 95 % confidence.
    `coherent_band_low` and `coherent_band_high` [Hz]: ends of the band that is known at every level; notes name the
    gaps in it.

    Raises
    ------
    MissingChannel : a run has no reference or no response of the test actuator.
    NotIdentifiable : no step of noise has data, no frequency has enough coherence at every level, or a response opposes
        its reference.
    """
    error_prefix = f"{paths_of(runs)}: {loop.experiment}"
    notes = setup_notes(runs, (loop.setup,), "the response is that of another load")
    usable_records = joined(records_of(run, loop) for run in runs)
    records = usable_records.value
    notes += usable_records.notes
    interval = float(np.median([record.interval for record in records]))
    highest_frequency = min(min(record.cutoff for record in records), 0.5 / interval)
    method = BlackmanTukey(interval, WINDOW_LAGS, highest_frequency)
    levels = spectra_by_level(records, method)
    counts = {level: len(trials) for level, trials in levels.items()}
    if len(set(counts.values())) > 1:
        counts_text = ", ".join(f"{count} at {level:.3g}" for level, count in counts.items())
        notes.append(f"repeats are missing: records are {counts_text}; every level counts the same")

    responses = {level: method.response(sum_of_spectra(trials)) for level, trials in levels.items()}
    masks = {level: known_frequencies(response, method.resolution, level) for level, response in responses.items()}
    known = {level: mask.value for level, mask in masks.items()}
    notes += [note for mask in masks.values() for note in mask.notes]
    band = method.frequency[: len(next(iter(known.values())))][np.all(list(known.values()), axis=0)]
    if not len(band):
        raise NotIdentifiable(
            f"{error_prefix}: no frequency at which the coherence of every level is {LEAST_COHERENCE:g} or more"
        )
    for level, response in responses.items():
        refuse_swapped_sign(response, known[level], f"{error_prefix}: at {level:.3g}")
    half_power = bandwidth_of(method, levels, responses, known)
    bandwidth = half_power.value
    notes += half_power.notes
    band_ends = [("coherent_band_low", float(band[0])), ("coherent_band_high", float(band[-1]))]
    results = (bandwidth, *(Estimate(name, value, NAN, NAN, NAN, "Hz") for name, value in band_ends))
    if not bandwidth.high <= SAMPLING_SHOWS_ABOVE / interval:
        notes.append(
            f"above {SAMPLING_SHOWS_ABOVE / interval:g} Hz, a tenth of the record's rate, the response is that of a "
            "sampled loop to references that are held; its effect on the gain is within the bandwidth's limits"
        )
    units = runs[0].channel(loop.response, role="test").units
    plots = plots_of(responses, known, units)
    return Result(loop.experiment, tuple(str(run.path) for run in runs), results, tuple(notes), plots)


def spectra_by_level(records: Sequence[NoiseRecord], method: BlackmanTukey) -> dict[float, list[Spectra]]:
    """Return the spectra by level, one for each noise: records with the same seed count as one trial."""
    by_level: dict[float, dict[object, Spectra]] = {}
    for record in sorted(records, key=lambda record: record.level):
        spectra, by_noise = method.spectra(record.reference, record.response), by_level.setdefault(record.level, {})
        by_noise[record.seed] = by_noise[record.seed].plus(spectra) if record.seed in by_noise else spectra
    return {level: list(by_noise.values()) for level, by_noise in by_level.items()}


def known_frequencies(response: Response, resolution: float, level: float) -> Noted[Mask]:
    """Return the mask of frequencies at which a level's response is known; notes name bands of too little coherence.

    `resolution` [Hz] is the lowest frequency that can be known.
    """
    frequency = response.frequency
    is_known = (response.coherence >= LEAST_COHERENCE) & (frequency >= resolution)
    is_unknown = ~is_known & (frequency >= resolution)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_unknown, [False]]).astype(np.int8)))
    notes = tuple(
        f"coherence at {level:.3g} is below {LEAST_COHERENCE:g} from {frequency[first]:.1f} to "
        f"{frequency[last]:.1f} Hz: the response there is not known"
        for first, last in zip(edges[::2], edges[1::2] - 1, strict=True)
    )
    return Noted(is_known, notes)


def refuse_swapped_sign(response: Response, known: Mask, error_prefix: str) -> None:
    """Raise NotIdentifiable if a response opposes its reference: then a sign is swapped.

    The mean real part at the four lowest known frequencies decides.
    """
    lowest_indices = np.flatnonzero(known)[:4]
    if np.mean(response.value[lowest_indices].real) < 0.0:
        frequency = response.frequency[lowest_indices[0]]
        raise NotIdentifiable(
            f"{error_prefix} the response goes against the reference at {frequency:.1f} Hz: a sign is swapped"
        )


def plots_of(responses: Mapping[float, Response], known: Mapping[float, Mask], units: str) -> tuple[Plot, ...]:
    """Return plots of gain, phase and coherence over frequency; gain and phase only at known frequencies."""
    gains, gain_limits, phases, coherences = [], [], [], []
    for level, response in responses.items():
        plotted = plot_slice(len(response.frequency), MOST_POINTS)
        label, x = f"{level:.3g} {units}", tuple(response.frequency[plotted].tolist())
        known_gain = np.where(known[level], response.gain, NAN)
        gains.append(Series(label, x, _tuple(20.0 * np.log10(known_gain)[plotted])))
        for side in (-1.96, 1.96):
            limit = np.maximum(known_gain * (1.0 + side * response.relative_std), 1e-6)
            gain_limits.append(Series(f"{label}, 95 %", x, _tuple(20.0 * np.log10(limit)[plotted])))
        phase = np.full(len(response.frequency), NAN)
        phase[known[level]] = response.at(known[level]).phase
        phases.append(Series(label, x, _tuple(np.degrees(phase)[plotted])))
        coherences.append(Series(label, x, _tuple(response.coherence[plotted])))
    x_range = (0.0, max(series.x[-1] for series in gains))
    minus_3_db = Series("-3 dB", x_range, (20.0 * math.log10(HALF_POWER),) * 2)
    threshold = Series("known from here", x_range, (LEAST_COHERENCE,) * 2)
    return (
        Plot("frequency [Hz]", "gain [dB]", tuple(gains), (minus_3_db, *gain_limits), x_log=True),
        Plot("frequency [Hz]", "phase [deg]", tuple(phases), (), x_log=True),
        Plot("frequency [Hz]", "coherence [1]", tuple(coherences), (threshold,), x_log=True),
    )


def _tuple(values: Array) -> tuple[float, ...]:
    """Return the values as a tuple of Python numbers."""
    return tuple(values.tolist())
