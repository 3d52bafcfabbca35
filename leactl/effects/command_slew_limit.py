"""Slew limit: the current command changes by no more than a rate."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.effects.shapes import rate_limited
from leactl.model.nominal import Model

ROUNDING = 1e-9  # of an interval


class CommandSlewLimit(Effect):
    """A drive that follows no faster than a fixed rate."""

    name = "command_slew_limit"
    one_sided = True
    explains = 0.75  # the moment within an interval at which a command comes is not known
    shaped = True
    forms = ((0.0015,), (0.0032,), (0.0068,), (0.0145,), (0.03,), (0.05,), (0.07,))
    form_scales = ("highest rate",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """The change of the model's current by a limit of its command before the current loop."""
        if signals.command is None or signals.following is None:
            return {}
        initial = None if signals.current is None else float(signals.current[0])  # a run may begin during a ramp
        most = form[0] * signals.interval
        ends = rate_limited(signals.command, most, initial)
        change = np.diff(ends, prepend=ends[0] if initial is None else initial)
        ramp = np.minimum(np.abs(change) / most, 1.0)  # share of each interval
        # the mean of an interval stands for its end where the limit acts throughout it, and in the next, where the ramp
        # ends; a ramp within one interval counts as a step, for stamps may be wrong by an interval
        limited = ramp > 1.0 - ROUNDING
        averaged = limited | np.append(False, limited[:-1])
        means = ends - np.where(averaged, 0.5 * change * ramp, 0.0)
        return {"current_following": {"strength": signals.looped(means) - signals.following}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Rate."""
        return {"rate": form[0]}

    def size(self, form: Form, coefficients: Mapping[str, float], model: Model) -> float:
        """How much of the limit is there."""
        return abs(coefficients["strength"])

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """A reference that is followed at a limited rate."""
        rate = parameters["rate"]
        plant.command.append(lambda values, interval: rate_limited(values, rate * interval))

    def whole(self, form: Form, strength: float) -> Form:
        """The rate as it is: a limit of half the strength is not a limit at another rate."""
        return form
