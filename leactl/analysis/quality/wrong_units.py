"""Signs of a wrong unit: a result far from the run's model, or readings far beyond the limits of its bench.

They cause notes and no error, since the model may be wrong as well. Model and machine may differ by a factor of two,
and in friction by more, with preload and temperature; a wrong unit is a factor of a thousand.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from leactl import yamlfile
from leactl.analysis.estimate import Estimate, listed
from leactl.analysis.run_model import model_of, positive_number
from leactl.errors import InputError
from leactl.quantities import UNITS as VOCABULARY
from leactl.runfile.read.reader import Run

# by result: largest plausible ratio to the model's value, and the keys of the model that may have it, in this order
PLAUSIBLE_RATIOS: dict[str, tuple[float, tuple[str, ...]]] = {
    "torque_constant": (10.0, ("torque_constant",)),
    "back_emf_constant": (10.0, ("back_emf_constant", "torque_constant")),  # equal in SI, q axis
    "rotor_inertia": (30.0, ("rotor_inertia",)),
    "coulomb_friction": (30.0, ("coulomb_friction",)),
    "viscous_damping": (30.0, ("viscous_damping",)),
    "phase_resistance": (10.0, ("phase_resistance",)),
    "cold_resistance": (20.0, ("phase_resistance",)),  # between two leads, which is 2/3 to 2 phases
    "breakaway_torque": (30.0, ("coulomb_friction",)),
}
GIVEN_CONSTANT = "the torque constant given"
UNITS = {
    "torque": "N*m",
    "q_axis_current": "A",
    "velocity": "rad/s",
    "angle": "rad",
    "phase_voltage": "V",
    "line_voltage": "V",
    "line_current": "A",
    GIVEN_CONSTANT: "N*m/A",
}
MISTAKEN_BY_THOUSANDS = (
    "torque",
    "q_axis_current",
    "phase_voltage",
    "line_voltage",
    "line_current",
    GIVEN_CONSTANT,
)  # quantities that logs have in a unit a thousand times off; an angle in mrad is no mistake
PREFIXES = {1: ("m", "k"), 2: ("u", "M")}  # of too large and of too small readings, by the power of a thousand
UNIT_TOLERANCE = 0.1  # relative; a ratio so near to a power of a thousand, or to degrees, names the unit
DEGREES_PER_RADIAN = 180.0 / math.pi
LIMIT_KEYS = {"q_axis_current": "current_A", "torque": "torque_Nm", "velocity": "velocity_rad_s"}
LIMIT_KEYS |= {"bus_voltage": "bus_voltage_high_V"}
LIMIT_KEYS |= {f"phase_voltage_{leads}": "bus_voltage_high_V" for leads in ("ab", "bc", "ca")}
BEYOND_LIMIT_FACTOR = 3.0  # times a limit of the bench; higher readings make the unit doubtful
SPIKE_FREE_QUANTILE = 0.99  # of the readings; a spike lies above it


def unit_notes(
    runs: Sequence[Run],
    results: Sequence[Estimate],
    proportional: Sequence[str],
    inverse: Sequence[str] = (),
    given_constant: float | None = None,
) -> list[str]:
    """Return notes on quantities whose unit is doubtful.

    Parameters
    ----------
    proportional, inverse : quantities that the results are in proportion to, and in inverse proportion to.
    given_constant : the torque constant that a caller gave [N*m/A]; the results are in proportion to it as well.
    """
    notes = []
    model = source_in_run(runs[0], "model")
    model_constant = positive_number(model.get("torque_constant"))
    plausible_ratio = PLAUSIBLE_RATIOS["torque_constant"][0]
    if (
        given_constant is not None
        and not 1.0 / plausible_ratio <= given_constant / model_constant <= plausible_ratio
        and math.isfinite(model_constant)
    ):
        notes.append(
            f"the torque constant {given_constant:g} N*m/A, as given, is {given_constant / model_constant:.4g} times"
            f" the model's {model_constant:g} N*m/A:"
            f" {unit_question(given_constant / model_constant, [GIVEN_CONSTANT])}"
        )
    if given_constant is not None:
        proportional = [*proportional, GIVEN_CONSTANT]
    differences: list[str] = []
    ratios: list[float] = []
    for estimate in results:
        if (ratio := ratio_to_model(estimate, model)) is not None:
            possessive = "its" if differences else "the model's"
            differences.append(
                f"{estimate.name} is {ratio:.4g} times {possessive} {estimate.value / ratio:.4g} {estimate.units}"
            )
            ratios.append(ratio)
    if differences:
        # other ratios may contain a difference of the machine too
        clearest_ratio = min(ratios, key=distance_from_thousands)
        notes.append(f"{', '.join(differences)}: {unit_question(clearest_ratio, proportional, inverse)}")
    return notes + beyond_limits(runs, [*proportional, *inverse])


def ratio_to_model(estimate: Estimate, model: dict[str, Any]) -> float | None:
    """Return result over model if the whole interval of the result is beyond the largest plausible ratio, else None."""
    if estimate.name not in PLAUSIBLE_RATIOS:
        return None
    plausible_ratio, names = PLAUSIBLE_RATIOS[estimate.name]
    model_value = next((positive_number(model[name]) for name in names if name in model), math.nan)
    ratio, low, high = estimate.value / model_value, estimate.low / model_value, estimate.high / model_value
    is_above = (low if math.isfinite(low) else ratio) > plausible_ratio
    is_below = ratio > 0.0 and (high if math.isfinite(high) else ratio) < 1.0 / plausible_ratio
    return ratio if is_above or is_below else None


def unit_question(ratio: float, proportional: Sequence[str], inverse: Sequence[str] = ()) -> str:
    """Return a question whether a quantity is in the unit that explains `ratio`, and the units to check."""
    power = round(math.log10(ratio) / 3.0)
    candidates = []
    if abs(power) in PREFIXES and distance_from_thousands(ratio) < UNIT_TOLERANCE:
        proportional_prefix, inverse_prefix = PREFIXES[abs(power)][:: 1 if power > 0 else -1]
        candidates += [
            f"{name} in {proportional_prefix}{UNITS[name]}" for name in proportional if name in MISTAKEN_BY_THOUSANDS
        ]
        candidates += [f"{name} in {inverse_prefix}{UNITS[name]}" for name in inverse if name in MISTAKEN_BY_THOUSANDS]
    elif "angle" in proportional and abs(ratio / DEGREES_PER_RADIAN - 1.0) < UNIT_TOLERANCE:
        candidates.append("angle in degrees")
    request = f"check the units of {' and '.join([*proportional, *inverse])}"
    return f"{' or '.join(candidates)}? {request}" if candidates else request


def distance_from_thousands(ratio: float) -> float:
    """Return the distance of a ratio from the nearest power of a thousand, as a share of that power."""
    return abs(ratio / 1000.0 ** round(math.log10(ratio) / 3.0) - 1.0)


def beyond_limits(runs: Sequence[Run], quantities: Sequence[str]) -> list[str]:
    """Return a note for each quantity of the test actuator with readings far beyond the limit of a run's bench."""
    notes = []
    for quantity in quantities:
        readings_beyond = [
            (run, *reading_and_limit)
            for run in runs
            if (reading_and_limit := reading_beyond_limit(run, quantity)) is not None
        ]
        if readings_beyond:
            _, highest, limit = max(readings_beyond, key=lambda item: item[1] / item[2])
            unit = VOCABULARY[quantity]
            notes.append(
                f"{quantity} reads up to {highest:.0f} {unit}, {highest / limit:.3g} times the bench's limit of"
                f" {limit:g}"
                f" {unit} ({listed(run.path for run, *_ in readings_beyond)}): check its units"
            )
    return notes


def reading_beyond_limit(run: Run, quantity: str) -> tuple[float, float] | None:
    """Return a run's highest reading without spikes, and the bench's limit; None if it is not far beyond the limit."""
    limits = source_in_run(run, "bench").get("limits")
    limit = positive_number(limits.get(LIMIT_KEYS.get(quantity, ""))) if isinstance(limits, dict) else math.nan
    if not math.isfinite(limit):
        return None
    magnitudes = [
        np.abs(channel.values[np.isfinite(channel.values)]) for channel in run.channels(quantity, role="test")
    ]
    highest = max(
        (
            float(np.quantile(channel_magnitudes, SPIKE_FREE_QUANTILE))
            for channel_magnitudes in magnitudes
            if len(channel_magnitudes)
        ),
        default=0.0,
    )
    return (highest, limit) if highest > BEYOND_LIMIT_FACTOR * limit else None


def source_in_run(run: Run, name: str) -> dict[str, Any]:
    """Return the model or the bench file in a run; empty if the run has none, or it cannot be parsed."""
    try:
        if name == "model":
            return model_of(run)
        document = yamlfile.parse(run.source(name) or "", f"{run.path}:/{name}/source").data
    except InputError:
        return {}
    return document if isinstance(document, dict) else {}
