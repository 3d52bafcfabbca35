"""What tells of a wrong unit: a figure that no machine like the run's model has, a reading beyond all of its bench.

Nothing is refused for it, since a model may be wrong as well. A model and a bench are twofold apart at times, friction
by preload and temperature more; a unit is off by a thousand.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from leactl import yamlfile
from leactl.analysis.estimate import Estimate, listed
from leactl.analysis.run_model import model_of, positive
from leactl.errors import InputError
from leactl.quantities import UNITS as VOCABULARY
from leactl.runfile.reader import Run

# how many times a result may be what the model has, and under which names that has it, the first that is there
FIGURES: dict[str, tuple[float, tuple[str, ...]]] = {
    "torque_constant": (10.0, ("torque_constant",)),
    "back_emf_constant": (10.0, ("back_emf_constant", "torque_constant")),  # equal in SI, q axis
    "rotor_inertia": (30.0, ("rotor_inertia",)),
    "coulomb_friction": (30.0, ("coulomb_friction",)),
    "viscous_damping": (30.0, ("viscous_damping",)),
    "phase_resistance": (10.0, ("phase_resistance",)),
    "cold_resistance": (20.0, ("phase_resistance",)),  # between two leads, which is 2/3 to 2 phases
    "breakaway_torque": (30.0, ("coulomb_friction",)),
}
GIVEN = "the torque constant given"
UNITS = {
    "torque": "N*m",
    "q_axis_current": "A",
    "velocity": "rad/s",
    "angle": "rad",
    "phase_voltage": "V",
    "line_voltage": "V",
    "line_current": "A",
    GIVEN: "N*m/A",
}
IN_THOUSANDS = (
    "torque",
    "q_axis_current",
    "phase_voltage",
    "line_voltage",
    "line_current",
    GIVEN,
)  # an angle is not told in mrad by mistake
PREFIXES = {1: ("m", "k"), 2: ("u", "M")}  # powers of a thousand: the unit of too many, that of too few
NEAR = 0.1  # of a power of a thousand: as close as machines are to their models for a unit to be named
DEGREES = 180.0 / math.pi
LIMITS = {"q_axis_current": "current_A", "torque": "torque_Nm", "velocity": "velocity_rad_s"}
LIMITS |= {"bus_voltage": "bus_voltage_high_V"}
LIMITS |= {f"phase_voltage_{leads}": "bus_voltage_high_V" for leads in ("ab", "bc", "ca")}
BEYOND = 3.0  # times a limit of the bench
NEARLY_ALL = 0.99  # of the readings, so that a spike is none


def unit_notes(
    runs: Sequence[Run],
    results: Sequence[Estimate],
    over: Sequence[str],
    under: Sequence[str] = (),
    given: float | None = None,
) -> list[str]:
    """Notes on units that are in doubt, for the head of all notes; none for a sound record.

    Parameters
    ----------
    over, under : quantities that the results are in proportion to, and in inverse proportion.
    given : the torque constant that a caller gave, which the results are in proportion to as well.
    """
    notes = []
    model = source_in_run(runs[0], "model")
    own = positive(model.get("torque_constant"))
    limit = FIGURES["torque_constant"][0]
    if given is not None and not 1.0 / limit <= given / own <= limit and math.isfinite(own):
        notes.append(
            f"the torque constant {given:g} N*m/A, as given, is {given / own:.4g} times the model's {own:g} N*m/A:"
            f" {unit_question(given / own, [GIVEN])}"
        )
    if given is not None:
        over = [*over, GIVEN]
    told: list[str] = []
    ratios: list[float] = []
    for item in results:
        if (ratio := ratio_to_model(item, model)) is not None:
            whose = "its" if told else "the model's"
            told.append(f"{item.name} is {ratio:.4g} times {whose} {item.value / ratio:.4g} {item.units}")
            ratios.append(ratio)
    if told:
        telling = min(ratios, key=off_a_unit)  # one of them may be off by the machine as well
        notes.append(f"{', '.join(told)}: {unit_question(telling, over, under)}")
    return notes + beyond_limits(runs, [*over, *under])


def ratio_to_model(item: Estimate, model: dict[str, Any]) -> float | None:
    """How many times the model's figure a result is where its whole interval is beyond what may be; None elsewhere."""
    if item.name not in FIGURES:
        return None
    most, names = FIGURES[item.name]
    told = next((positive(model[name]) for name in names if name in model), math.nan)
    ratio, low, high = item.value / told, item.low / told, item.high / told
    above = (low if math.isfinite(low) else ratio) > most
    below = ratio > 0.0 and (high if math.isfinite(high) else ratio) < 1.0 / most
    return ratio if above or below else None


def unit_question(ratio: float, over: Sequence[str], under: Sequence[str] = ()) -> str:
    """The question by which a unit that makes this ratio is named where one does, and what to check."""
    power = round(math.log10(ratio) / 3.0)
    named = []
    if abs(power) in PREFIXES and off_a_unit(ratio) < NEAR:
        many, few = PREFIXES[abs(power)][:: 1 if power > 0 else -1]
        named += [f"{name} in {many}{UNITS[name]}" for name in over if name in IN_THOUSANDS]
        named += [f"{name} in {few}{UNITS[name]}" for name in under if name in IN_THOUSANDS]
    elif "angle" in over and abs(ratio / DEGREES - 1.0) < NEAR:
        named.append("angle in degrees")
    check = f"check the units of {' and '.join([*over, *under])}"
    return f"{' or '.join(named)}? {check}" if named else check


def off_a_unit(ratio: float) -> float:
    """How far a ratio is off the nearest power of a thousand, of that power."""
    return abs(ratio / 1000.0 ** round(math.log10(ratio) / 3.0) - 1.0)


def beyond_limits(runs: Sequence[Run], quantities: Sequence[str]) -> list[str]:
    """A note for each quantity of the test actuator whose readings are beyond the limit in the run's bench file."""
    notes = []
    for quantity in quantities:
        far = [(run, *found) for run in runs if (found := reading_beyond_limit(run, quantity)) is not None]
        if far:
            _, most, limit = max(far, key=lambda item: item[1] / item[2])
            unit = VOCABULARY[quantity]
            notes.append(
                f"{quantity} reads up to {most:.0f} {unit}, {most / limit:.3g} times the bench's limit of {limit:g}"
                f" {unit} ({listed(run.path for run, *_ in far)}): check its units"
            )
    return notes


def reading_beyond_limit(run: Run, quantity: str) -> tuple[float, float] | None:
    """The highest reading of a run but for spikes, and the limit, where it is far beyond."""
    limits = source_in_run(run, "bench").get("limits")
    limit = positive(limits.get(LIMITS.get(quantity, ""))) if isinstance(limits, dict) else math.nan
    if not math.isfinite(limit):
        return None
    sizes = [np.abs(channel.values[np.isfinite(channel.values)]) for channel in run.channels(quantity, role="test")]
    most = max((float(np.quantile(size, NEARLY_ALL)) for size in sizes if len(size)), default=0.0)
    return (most, limit) if most > BEYOND * limit else None


def source_in_run(run: Run, name: str) -> dict[str, Any]:
    """The model or the bench file in a run; empty where a foreign run has none, or none that can be read."""
    try:
        if name == "model":
            return model_of(run)
        found = yamlfile.parse(run.source(name) or "", f"{run.path}:/{name}/source").data
    except InputError:
        return {}
    return found if isinstance(found, dict) else {}
