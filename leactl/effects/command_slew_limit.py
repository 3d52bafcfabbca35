"""Slew limit: the current command changes by no more than a rate."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.hysteresis_and_lags import ramp_means, ramp_shares, rate_limited
from leactl.effects.plant import Plant
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
ROUNDING_SHARE = 1e-9  # share of an interval; a ramp that is shorter by less fills the interval


class CommandSlewLimit(Effect):
    """A drive that follows no faster than a fixed rate."""

    name = "command_slew_limit"
    one_sided = True
    explains = 0.75  # many logs do not tell when within an interval a command comes
    shaped = True
    forms = ((0.0015,), (0.0032,), (0.0068,), (0.0145,), (0.03,), (0.06,), (0.12,), (0.25,), (0.5,))
    form_scales = ("highest rate",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the change of the model's current by a rate limit of its command before the current loop."""
        if signals.command is None or signals.following is None or signals.looped is None:
            return {}
        largest_change = form[0] * signals.interval
        # a run may begin during a ramp: it starts at the current, not at the command
        begin = float(signals.command[0] if signals.current is None else signals.current[0])
        ends = rate_limited(signals.command, largest_change, begin)
        shares = ramp_shares(ends, largest_change, begin)
        if not signals.command_held:
            # the command may change anywhere in an interval: a ramp counts in those that it fills and where it ends
            filled = shares > 1.0 - ROUNDING_SHARE
            shares = np.where(filled | np.append(False, filled[:-1]), shares, 0.0)
        return {"current_following": {"strength": signals.looped(ends, shares, begin) - signals.following}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the largest rate of the command."""
        return {"rate": form[0]}

    def size(self, form: Form, coefficients: Mapping[str, float], model: Model) -> float:
        """Return the fitted share of the limit."""
        return abs(coefficients["strength"])

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a rate limit of the current reference."""
        rate = parameters["rate"]
        plant.command.append(lambda values, interval: limited_means(values, rate * interval))

    def whole(self, form: Form, strength: float) -> Form:
        """Return the form unchanged: half the effect of a limit is not that of a limit at another rate."""
        return form


def limited_means(values: Array, largest_change: float) -> Array:
    """Return the means over steps of a signal that follows values by at most `largest_change` in a step."""
    begin = float(values[0])
    ends = rate_limited(values, largest_change, begin)
    return ramp_means(ends, ramp_shares(ends, largest_change, begin), begin)
