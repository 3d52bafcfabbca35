"""What an effect of the library says of itself: the places of the equations it touches, as columns of a regression.

The equations of the bench (voltage, torque balance, sensor channels, heat) know places, not effects: a drag on the
rotor, a factor on the torque constant, something the torque channel reads. An effect fills places with columns, one for
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
    "highest speed",  # rad/s, that the runs reach
    "highest current",  # A, that the runs reach
    "highest power",  # W, of torque and speed, that the runs reach or ask for
    "longest run",  # s, of those that turn
    "travel",  # rad, that the widest run covers
    "loop",  # s, time constant of the model's current loop
    "velocity filter",  # s, time constant
    "torque filter",  # s, time constant
    "highest rate",  # A/s, of the highest current through the loop
    "friction",  # N*m, Coulomb friction
    "sampling rate",  # Hz, the finest
    "housing",  # s, time constant with which it cools
)
"""A machine's own scales, in which forms of effects are told, so that similar machines have similar forms."""


@dataclass
class Signals:
    """What one run shows at its base rate, smoothed where the equations take derivatives; NaN-free, SI and degC.

    `angle`, `velocity`, `acceleration` come from the encoder's angle, `torque` is what the model says the shaft
    carries, never what the sensor reads; `sliding` is -1, 0 or 1 and smooth in between.
    """

    mechanical: str
    time: Array
    model: Model
    interval: float
    run: str = ""
    fastest: float = 0.0  # rad/s, that the run reaches elsewhere, where this is a stretch of it
    current: Array | None = None
    command: Array | None = None  # A, that the model's loop is to follow over each interval
    command_held: bool = False  # as far as the log tells: it steps where an interval begins and holds from there
    following: Array | None = None  # A, what the model's loop makes of the reference, as the current is read
    # the same of a command that ramps to its value as each interval begins, then holds: called with the values, the
    # share of each interval that the ramp takes, and the value before the first
    looped: Callable[[Array, Array, float], Array] | None = None
    voltage: Array | None = None
    angle: Array | None = None
    sharp_angle: Array | None = None  # rad, mean over the interval that ends at each sample, not smoothed
    velocity: Array | None = None
    acceleration: Array | None = None
    sliding: Array | None = None
    torque: Array | None = None
    count: float = 0.0  # rad, of the encoder; zero where its steps do not show
    settled: npt.NDArray[np.bool_] | bool = True  # whether it is known where a locked rotor sticks,
    unleapt: npt.NDArray[np.bool_] | bool = True  # and how it slides
    resolved: npt.NDArray[np.bool_] | bool = True  # whether samples tell the motion between them
    calm_torque: Array | None = None  # the same and
    calm_velocity: Array | None = None  # smoothed until the encoder's steps no longer show: what lags are made of
    winding_rise: Array | None = None  # K above the model's reference temperature
    housing_rise: Array | None = None
    winding: Array | None = None  # degC
    housing: Array | None = None
    ambient: Array | None = None
    line_current: Array | None = None
    bus_voltage: Array | None = None
    extra: dict[str, Array] = field(default_factory=dict)
    smoothed: Callable[[Array], Array] = np.asarray  # as torques and accelerations are

    def waves(self, order: float) -> tuple[Array, Array]:
        """Cosine and sine of order times angle, attenuated by the mean over an interval and by the smoothing.

        A wave that advances by half of its period or more in an interval becomes zero.

        Raises
        ------
        ValueError : the run has no angle.
        """
        if self.angle is None or self.velocity is None:
            raise ValueError("waves over the angle of a run that has none")
        turned = order * (self.angle if self.sharp_angle is None else self.sharp_angle)
        advance = order * np.abs(self.velocity) * self.interval
        left = np.where(advance < np.pi, np.sinc(advance / (2.0 * np.pi)), 0.0)
        return self.smoothed(left * np.cos(turned)), self.smoothed(left * np.sin(turned))


class Effect:
    """One effect; a file of this room holds one subclass, found by listing the room."""

    name: ClassVar[str]
    forms: ClassVar[Sequence[Form]] = ((),)  # values of its non-linear parameters that are tried, in
    form_scales: ClassVar[tuple[str, ...]] = ()  # the machine's scales; pure numbers where left out
    relative_to: ClassVar[tuple[str, ...]] = ()  # the model's parameters whose part in a torque it is a share of
    one_sided: ClassVar[bool] = False  # whether its coefficient makes sense above zero only
    least: ClassVar[float] = 0.0  # size below which it is something else
    continuous: ClassVar[bool] = True  # whether values between those of its forms make sense,
    refined: ClassVar[int] = 1  # and for how many of a form's numbers, the first first
    narrow: ClassVar[bool] = False  # whether the first of them may lie between its forms where both show nothing
    shaped: ClassVar[bool] = False  # whether its coefficient is the share of a shape that is whole at one
    delays: ClassVar[bool] = False  # whether it is a delay and nothing else, which wrong stamps are too
    explains: ClassVar[float] = 0.82  # share of what it does to the channels it touches that its columns must explain
    periodic: ClassVar[str] = ""  # the place whose column repeats over the angle, where orders are searched for
    orders: ClassVar[tuple[int, int]] = (0, 0)  # of a wave over the angle, first number of its form; that are tried

    def forms_at(self, scales: Mapping[str, float]) -> list[Form]:
        """Forms in SI units at a machine's scales (see `SCALES`); none where one of these is not known."""
        counted = [scales.get(name) for name in self.form_scales]
        if None in counted:
            return []
        return [tuple(part * (scale or 1.0) for part, scale in zip_longest(form, counted)) for form in self.forms]

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Columns for each place and coefficient; empty where the run cannot show the effect."""
        raise NotImplementedError

    def terms_of_all(self, signals: Signals, forms: Sequence[Form]) -> Iterator[Terms]:
        """The same of several forms; an effect says it where all at once cost less."""
        return (self.terms(signals, form) for form in forms)

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Put the effect with these parameters into a simulated bench."""
        raise NotImplementedError

    def applies(self, model: Model) -> bool:
        """Whether a model of this kind can lack the effect."""
        return True

    def is_usual(self, travel: float) -> bool:
        """Whether it is what one thinks of first, of effects that share an equation, on a joint that travels so far.

        travel : rad, that the widest of the runs covers.
        """
        return True

    def is_distinct(self, form: Form, coefficients: Mapping[str, float], visited: tuple[float, float]) -> bool:
        """Whether runs show with these coefficients what tells it from a constant torque.

        visited : rad, lowest and highest angle of the runs.
        """
        return True

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """The parameters of the definition from fitted coefficients."""
        raise NotImplementedError

    def whole(self, form: Form, strength: float) -> Form:
        """The form at which a shape that was found at some strength would be whole."""
        return (form[0] * strength, *form[1:])

    def about(self, form: Form, coefficients: Mapping[str, float]) -> Form:
        """The form about which columns are made once coefficients are known."""
        return form

    def size(self, form: Form, coefficients: Mapping[str, float], model: Model) -> float:
        """How large the effect is, in units of its leading parameter; zero where it is absent."""
        return abs(next(iter(self.parameters(form, coefficients, model).values())))
