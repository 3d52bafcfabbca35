"""Signs of a wrong unit: a result far from the run's model, or readings far beyond the limits of its bench.

They cause notes and no refusal, since the model may be wrong as well. Model and bench may differ by a factor of two,
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
PREFIXES = {1: ("m", "k"), 2: ("u", "M")}  # by power of a thousand: prefix if readings are too large, if too small
UNIT_TOLERANCE = 0.1  # of a power of a thousand, or of degrees; a ratio within it names the unit
DEGREES_PER_RADIAN = 180.0 / math.pi
LIMIT_KEYS = {"q_axis_current": "current_A", "torque": "torque_Nm", "velocity": "velocity_rad_s"}
LIMIT_KEYS |= {"bus_voltage": "bus_voltage_high_V"}
LIMIT_KEYS |= {f"phase_voltage_{leads}": "bus_voltage_high_V" for leads in ("ab", "bc", "ca")}
BEYOND_LIMIT_FACTOR = 3.0  # times a limit of the bench; readings beyond it make the unit doubtful
SPIKE_FREE_QUANTILE = 0.99  # of the readings; a spike lies above it


def unit_notes(
    runs: Sequence[Run],
    results: Sequence[Estimate],
    over: Sequence[str],
    under: Sequence[str] = (),
    given: float | None = None,
) -> list[str]:
    """Return notes on quantities whose unit is doubtful; none for a sound record.

    Parameters
    ----------
    over, under : quantities that the results are in proportion to, and in inverse proportion.
    given : the torque constant that a caller gave, which the results are in proportion to as well.
    """
    notes = []
    model = source_in_run(runs[0], "model")
    model_constant = positive_number(model.get("torque_constant"))
    limit = PLAUSIBLE_RATIOS["torque_constant"][0]
    if given is not None and not 1.0 / limit <= given / model_constant <= limit and math.isfinite(model_constant):
        notes.append(
            f"the torque constant {given:g} N*m/A, as given, is {given / model_constant:.4g} times the model's"
            f" {model_constant:g} N*m/A:"
            f" {unit_question(given / model_constant, [GIVEN_CONSTANT])}"
        )
    if given is not None:
        over = [*over, GIVEN_CONSTANT]
    differences: list[str] = []
    ratios: list[float] = []
    for item in results:
        if (ratio := ratio_to_model(item, model)) is not None:
            possessive = "its" if differences else "the model's"
            differences.append(f"{item.name} is {ratio:.4g} times {possessive} {item.value / ratio:.4g} {item.units}")
            ratios.append(ratio)
    if differences:
        clearest = min(ratios, key=off_a_unit)  # the others may contain a difference of the machine too
        notes.append(f"{', '.join(differences)}: {unit_question(clearest, over, under)}")
    return notes + beyond_limits(runs, [*over, *under])


def ratio_to_model(item: Estimate, model: dict[str, Any]) -> float | None:
    """Return result over model if the result's interval is beyond the largest plausible ratio, else None."""
    if item.name not in PLAUSIBLE_RATIOS:
        return None
    largest_factor, names = PLAUSIBLE_RATIOS[item.name]
    modelled = next((positive_number(model[name]) for name in names if name in model), math.nan)
    ratio, low, high = item.value / modelled, item.low / modelled, item.high / modelled
    above = (low if math.isfinite(low) else ratio) > largest_factor
    below = ratio > 0.0 and (high if math.isfinite(high) else ratio) < 1.0 / largest_factor
    return ratio if above or below else None


def unit_question(ratio: float, over: Sequence[str], under: Sequence[str] = ()) -> str:
    """Ask whether a quantity is in the unit that would explain `ratio`, and say which units to check."""
    power = round(math.log10(ratio) / 3.0)
    candidates = []
    if abs(power) in PREFIXES and off_a_unit(ratio) < UNIT_TOLERANCE:
        too_many_prefix, too_few_prefix = PREFIXES[abs(power)][:: 1 if power > 0 else -1]
        candidates += [f"{name} in {too_many_prefix}{UNITS[name]}" for name in over if name in MISTAKEN_BY_THOUSANDS]
        candidates += [f"{name} in {too_few_prefix}{UNITS[name]}" for name in under if name in MISTAKEN_BY_THOUSANDS]
    elif "angle" in over and abs(ratio / DEGREES_PER_RADIAN - 1.0) < UNIT_TOLERANCE:
        candidates.append("angle in degrees")
    check = f"check the units of {' and '.join([*over, *under])}"
    return f"{' or '.join(candidates)}? {check}" if candidates else check


def off_a_unit(ratio: float) -> float:
    """Return the distance of a ratio from the nearest power of a thousand, as a share of that power."""
    return abs(ratio / 1000.0 ** round(math.log10(ratio) / 3.0) - 1.0)


def beyond_limits(runs: Sequence[Run], quantities: Sequence[str]) -> list[str]:
    """Return a note on each quantity of the test actuator with readings far beyond the run's bench limit."""
    notes = []
    for quantity in quantities:
        beyond = [
            (run, *reading_and_limit)
            for run in runs
            if (reading_and_limit := reading_beyond_limit(run, quantity)) is not None
        ]
        if beyond:
            _, highest, limit = max(beyond, key=lambda item: item[1] / item[2])
            unit = VOCABULARY[quantity]
            notes.append(
                f"{quantity} reads up to {highest:.0f} {unit}, {highest / limit:.3g} times the bench's limit of"
                f" {limit:g}"
                f" {unit} ({listed(run.path for run, *_ in beyond)}): check its units"
            )
    return notes


def reading_beyond_limit(run: Run, quantity: str) -> tuple[float, float] | None:
    """Return a run's highest reading without spikes, and the bench's limit, if the reading is far beyond; else None."""
    limits = source_in_run(run, "bench").get("limits")
    limit = positive_number(limits.get(LIMIT_KEYS.get(quantity, ""))) if isinstance(limits, dict) else math.nan
    if not math.isfinite(limit):
        return None
    sizes = [np.abs(channel.values[np.isfinite(channel.values)]) for channel in run.channels(quantity, role="test")]
    highest = max((float(np.quantile(size, SPIKE_FREE_QUANTILE)) for size in sizes if len(size)), default=0.0)
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
