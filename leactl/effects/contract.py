"""Contract of an effect of the library: its columns in the places of the equations, and its parameters.

The equations of the bench (voltage, torque balance, sensor channels, heat) have places for any effect: a drag on the
rotor, a factor on the torque constant, an error of the torque channel. An effect fills places with columns, one for
each of its coefficients, and turns fitted coefficients into the parameters of its definition.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from leactl.effects.plant import Plant
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
Form = tuple[float, ...]
Terms = dict[str, dict[str, Array]]  # place, coefficient, column

PLACES = (
    "drag",  # N*m against the test rotor
    "torque_factor",  # relative change of the torque constant
    "emf_factor",  # relative change of the back-EMF constant
    "voltage",  # V, beyond the model's
    "torque_reading",  # N*m, reading minus torque
    "current_reading",  # A, reading minus current of the test drive
    "angle_reading",  # rad, reading minus angle
    "velocity_reading",  # rad/s, reading with the model's filter undone, minus velocity
    "current_following",  # A, current minus what the model's loop makes of the reference
    "bus_voltage",  # V, beyond the model's
    "twist",  # rad, of the shaft beyond the model's
    "line_voltage",  # V, of the heated winding beyond the model's
    "winding_heat",  # W
    "housing_heat",  # W
    "camera_rise",  # relative change of the rise that the camera reads
)


SCALES = (
    "1",
    "highest speed",  # rad/s, of the runs
    "highest current",  # A, of the runs, measured or as a reference
    "highest power",  # W, of torque by the reference current, and speed
    "longest run",  # s, of turning runs
    "travel",  # rad, angle range of the widest run
    "loop",  # s, time constant of the model's current loop
    "velocity filter",  # s, time constant
    "torque filter",  # s, time constant
    "highest rate",  # A/s, of the highest current through the loop
    "friction",  # N*m, Coulomb friction
    "sampling rate",  # Hz, the finest
    "housing",  # s, time constant with which it cools
)
"""A machine's own scales, in which forms of effects are given, so that similar machines have similar forms."""


@dataclass
class Signals:
    """Signals of one run at its base rate, smoothed where the equations take derivatives; NaN-free, SI and degC.

    `angle`, `velocity`, `acceleration` come from the encoder's angle, `torque` is the model's torque on the shaft,
    never the sensor's reading; `sliding` is the smoothed sign of the velocity, between -1 and 1.
    """

    mechanical: str
    time: Array
    model: Model
    interval: float  # s
    run: str = ""  # name of the run
    fastest: float = 0.0  # rad/s, highest speed of the whole run, where this is a stretch of it
    current: Array | None = None  # A
    command: Array | None = None  # A, reference of the model's loop over each interval
    command_held: bool = False  # whether the log says that it steps where an interval begins and holds from there
    following: Array | None = None  # A, response of the model's loop to the reference, as the current is read
    # returns `following` for a command that ramps to its value as each interval begins and then holds; arguments: the
    # values, the share of each interval that the ramp takes, and the value before the first interval
    looped: Callable[[Array, Array, float], Array] | None = None
    voltage: Array | None = None  # V
    angle: Array | None = None
    sharp_angle: Array | None = None  # rad, mean over the interval that ends at each sample, not smoothed
    velocity: Array | None = None
    acceleration: Array | None = None
    sliding: Array | None = None
    torque: Array | None = None  # N*m
    count: float = 0.0  # rad, step of the encoder; zero if its steps do not show
    load_inertia: float = 0.0  # kg*m^2, of the model's pendulum or arm
    weight: Array | None = None  # N*m, torque of gravity on the model's pendulum or arm at the measured angle
    weight_slope: Array | None = None  # N*m/rad, its change with the angle
    settled: npt.NDArray[np.bool_] | bool = True  # whether the sticking position of a locked rotor is known
    unleapt: npt.NDArray[np.bool_] | bool = True  # whether the sliding of a locked rotor is known
    resolved: npt.NDArray[np.bool_] | bool = True  # whether the samples resolve the motion between them
    calm_torque: Array | None = None  # torque smoothed until the encoder's steps no longer show, for lags
    calm_velocity: Array | None = None  # velocity smoothed in the same way
    winding_rise: Array | None = None  # K above the model's reference temperature
    housing_rise: Array | None = None  # K above the model's reference temperature
    winding: Array | None = None  # degC
    housing: Array | None = None  # degC
    ambient: Array | None = None  # degC
    line_current: Array | None = None  # A
    bus_voltage: Array | None = None  # V
    extra: dict[str, Array] = field(default_factory=dict)
    smoothed: Callable[[Array], Array] = np.asarray  # smoothing of torques and accelerations

    def waves(self, order: float) -> tuple[Array, Array]:
        """Return cosine and sine of order times angle, attenuated by the mean over an interval and by the smoothing.

        A wave that advances by half of its period or more in an interval becomes zero.

        Raises
        ------
        ValueError : the run has no angle or no velocity.
        """
        if self.angle is None or self.velocity is None:
            raise ValueError("waves over the angle of a run that has none")
        phase = order * (self.angle if self.sharp_angle is None else self.sharp_angle)
        advance = order * np.abs(self.velocity) * self.interval
        attenuation = np.where(advance < np.pi, np.sinc(advance / (2.0 * np.pi)), 0.0)
        return self.smoothed(attenuation * np.cos(phase)), self.smoothed(attenuation * np.sin(phase))


class Effect:
    """One effect; each file of this package holds one subclass, found by listing the package."""

    name: ClassVar[str]
    forms: ClassVar[Sequence[Form]] = ((),)  # grid of its non-linear parameters, in units of `form_scales`
    form_scales: ClassVar[tuple[str, ...]] = ()  # names in `SCALES`; missing ones are 1
    relative_to: ClassVar[tuple[str, ...]] = ()  # model parameters of the torque of which the effect is a share
    one_sided: ClassVar[bool] = False  # whether its coefficient has to be positive
    least: ClassVar[float] = 0.0  # smallest size; below it another cause is assumed
    continuous: ClassVar[bool] = True  # whether values between those of its forms are possible
    refined: ClassVar[int] = 1  # number of a form's numbers that are refined, from the first on
    narrow: ClassVar[bool] = False  # whether the first number may lie between two forms that both show nothing
    shaped: ClassVar[bool] = False  # whether its coefficient is a share of a shape, and 1 for the whole effect
    limits_current: ClassVar[bool] = False  # whether it alone determines the current wherever it acts
    delays: ClassVar[bool] = False  # whether it is a pure delay, as wrong stamps are
    explains: ClassVar[float] = 0.82  # least share of the residual that its right form explains where it acts
    periodic: ClassVar[str] = ""  # place of a wave over the angle, whose order a periodogram finds; empty for others
    orders: ClassVar[tuple[int, int]] = (0, 0)  # lowest and highest order tried of a wave, the first number of its form

    def forms_at(self, scales: Mapping[str, float]) -> list[Form]:
        """Return the forms in SI units at a machine's scales (see `SCALES`); empty if a scale is not known."""
        scale_values = [scales.get(name) for name in self.form_scales]
        if None in scale_values:
            return []
        return [
            tuple(number * (scale or 1.0) for number, scale in zip_longest(form, scale_values)) for form in self.forms
        ]

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the columns by place and coefficient, shape (samples,); empty if the run cannot show the effect."""
        raise NotImplementedError

    def terms_of_all(self, signals: Signals, forms: Sequence[Form]) -> Iterator[Terms]:
        """Yield the terms of several forms; an effect overrides this method if all forms at once cost less."""
        return (self.terms(signals, form) for form in forms)

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add the effect with these parameters to a simulated bench."""
        raise NotImplementedError

    def applies(self, model: Model) -> bool:
        """Return whether a model of this kind can lack the effect."""
        return True

    def is_usual(self, travel: float) -> bool:
        """Return whether the effect is the usual cause among effects with equal columns.

        travel : rad, angle range of the widest run.
        """
        return True

    def is_distinct(self, form: Form, coefficients: Mapping[str, float], visited: tuple[float, float]) -> bool:
        """Return whether runs with these coefficients distinguish the effect from a constant torque.

        visited : rad, lowest and highest angle of the runs.
        """
        return True

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the parameters of the definition from fitted coefficients."""
        raise NotImplementedError

    def whole(self, form: Form, strength: float) -> Form:
        """Return the form in which a shape with a fitted strength would have the strength 1."""
        return (form[0] * strength, *form[1:])

    def about(self, form: Form, coefficients: Mapping[str, float]) -> Form:
        """Return the form at which the columns are linearised again once coefficients are fitted."""
        return form

    def size(self, form: Form, coefficients: Mapping[str, float], model: Model) -> float:
        """Return the size of the effect in the unit of its leading parameter; zero if it is absent."""
        return abs(next(iter(self.parameters(form, coefficients, model).values())))
