"""Gear backlash: a share of the inertia hangs behind teeth with play, and is free while these cross it.

The load goes on by itself, slowed by its own friction, until a flank of the motor's side reaches it; there it takes the
motor's speed without rebound, as gears do whose teeth are stiff and damped (models of play: Nordin and Gutman, 2002).
The measured motion of the motor alone moves the load, so that the load's torque is known but for its share of the
inertia. A pendulum or an arm falls by its weight while it is free; all of it is taken to hang behind the teeth.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.joint_elasticity import MOST_LOAD_SHARE
from leactl.effects.plant import GearedLoad, Plant
from leactl.effects.teeth import follow_loads
from leactl.model.nominal import Model

DEFAULT_FRICTION_SHARE = 0.2  # a load's share of the friction if the parameters do not give it
LEAST_PLAY_COUNTS = 4.0  # encoder counts, smallest play that shows; its ends are known to one count
MOST_SAMPLES_AT_ONCE = 1 << 20  # samples of all loads that are stepped together: bounds the memory for many forms


class GearBacklash(Effect):
    """A load behind teeth with play, without an encoder behind it."""

    name = "gear_backlash"
    relative_to = ("rotor_inertia",)
    one_sided = True
    explains = 0.6  # the time at which flanks meet is known to one sample, and the torque there is large
    least = 0.1  # share of the inertia; a smaller part is loose, and no load
    refined = 2
    forms = tuple(
        (float(play), friction_ratio)
        for play in np.geomspace(0.001, 0.064, 9)
        for friction_ratio in (0.02, 0.06, 0.2, 0.5, 1.2)
    )

    def applies(self, model: Model) -> bool:
        """Return whether the model has no shaft to a load actuator, whose play is `backlash`."""
        return model.bench.shaft_stiffness is None

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the change of the rigid joint's torque balance if the whole inertia were behind teeth."""
        return next(self.terms_of_all(signals, [form]))

    def terms_of_all(self, signals: Signals, forms: Sequence[Form]) -> Iterator[Terms]:
        """Yield the terms of several forms, whose loads are stepped side by side."""
        inertia, speed = signals.model.rotor_inertia, signals.velocity
        if signals.mechanical != "free" or speed is None or signals.acceleration is None or not inertia:
            yield from ({} for _ in forms)
            return
        inertia += signals.load_inertia
        damping, friction = signals.model.viscous_damping or 0.0, signals.model.coulomb_friction or 0.0
        fall = None if signals.weight is None else signals.weight / signals.load_inertia
        forms_at_once = max(MOST_SAMPLES_AT_ONCE // len(speed), 1)
        for first in range(0, len(forms), forms_at_once):
            plays, friction_ratios = (
                np.array(column) for column in zip(*forms[first : first + forms_at_once], strict=True)
            )
            rates = friction_ratios * damping / inertia, friction_ratios * friction / inertia
            loads, twists = follow_loads(speed, signals.interval, 0.5 * plays, *rates, fall)
            for load, twist, play, friction_ratio in zip(loads, twists, plays, friction_ratios, strict=True):
                if play < LEAST_PLAY_COUNTS * signals.count:
                    yield {}
                    continue
                relative_speed = signals.smoothed(load - speed)
                friction_change = damping * relative_speed + friction * signals.smoothed(np.sign(load) - np.sign(speed))
                column = inertia * np.gradient(relative_speed, signals.interval) + friction_ratio * friction_change
                if signals.weight_slope is not None:
                    # the load hangs at another angle than the motor's; all of it is the model's pendulum or arm
                    column -= inertia / signals.load_inertia * signals.weight_slope * signals.smoothed(twist)
                yield {"drag": {"share": column}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the play, and the load's shares of the inertia and of the friction."""
        share = coefficients["share"]
        return {"share": share, "play": form[0], "friction": share * form[1]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a second inertia behind teeth."""
        share, friction = parameters["share"], parameters.get("friction", DEFAULT_FRICTION_SHARE)
        plant.geared_load = GearedLoad(min(share, MOST_LOAD_SHARE), min(friction, MOST_LOAD_SHARE))
        plant.play += parameters["play"]
