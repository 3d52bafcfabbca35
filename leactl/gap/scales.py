"""A machine's own units: what its model file and its runs say of its torque, current, time, speed and heat."""

from collections.abc import Sequence

import numpy as np

from leactl.gap.record import Record
from leactl.model.nominal import Model


def scales(records: Sequence[Record], model: Model) -> dict[str, float]:
    """One unit of each kind for a machine and its runs; a kind that they do not tell is left out.

    Torque is the Coulomb friction and current what makes it; time is the finest interval between samples, speed the
    highest that was reached. Machines that are similar in the sense of dimensional analysis have similar units.
    """
    found = {"1": 1.0, "rad": 1.0, "K": 1.0, "1/K": 1.0, "share of the limit": 1.0}
    clocks = [record.fast for record in records if record.fast is not None]
    if clocks:
        found["s"] = min(clock.interval for clock in clocks)
        lasting = max(float(clock.time[-1] - clock.time[0]) for clock in clocks)
        speeds = [
            float(np.quantile(np.abs(np.diff(angle)), TOP)) / clock.interval
            for clock in clocks
            if (angle := clock.get("angle")) is not None
        ]
        if speeds and max(speeds) > 0.0:
            found["rad/s"] = max(speeds)
            found["s/rad"] = 1.0 / found["rad/s"]
        if model.coulomb_friction:
            found["N*m/s"] = model.coulomb_friction / lasting
    if model.coulomb_friction:
        found["N*m"] = model.coulomb_friction
        if "rad/s" in found:
            found["N*m*s^2/rad^2"] = found["N*m"] / found["rad/s"] ** 2
        if model.torque_constant:
            found["A"] = found["N*m"] / model.torque_constant
    if model.phase_resistance:
        found["ohm"] = model.phase_resistance
        if "A" in found:
            found["V"] = found["ohm"] * found["A"]
    if model.thermal is not None:
        found["J/K"] = model.thermal.housing_capacitance
    return found


TOP = 0.999  # quantile of a run's speeds that counts as its highest
