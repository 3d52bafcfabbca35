"""An upper bound of the temperatures of actuators, guaranteed for every parameter inside its box.

An actuator has three phases of a third of the winding each, and a housing; phase k takes (1 + cos(2 theta - 2 phi_k))
/ 3 of the copper heat, up to two thirds at standstill. Three nodes bound it: the hottest phase, whatever the angle of
commutation, the mean of the phases, and the housing. Heat flows from node to node are monotone in all of them
but the own one (a cooperative system), so that an upper bound of each node follows from upper bounds of the others
(Mueller, 1927; Walter, Differential and Integral Inequalities, 1970): each equation is maximised over the box, a
capacitance low where its node heats up and high where it cools. What leaves the winding through the resistance to the
housing enters the housing: maximised by itself at either end it would make heat of nothing. A winding that heats with
its lowest and cools with its highest capacitance is none either. Both are therefore split into cells, each of which is
bounded by itself.

A step is order-preserving: neighbours are held at a bound that they keep over the whole step, and each node's own
equation, linear then, is solved exactly. The bound on the neighbours is tried first and widened until it holds.
"""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from leactl.safety.thermal.box import Array, Box

CELLS, CAPACITANCE_CELLS = 12, 4  # of the resistance to the housing and of the winding's capacitance
LONGEST_STEP_S = 2.0
OTHER_PHASES = 0.55  # weight of the hottest phase in the winding's resistance: half where phases heat alike, see docs
AHEAD = 1.5  # times what a node would gain in a step at its present rate, that it is taken to gain at most
WIDER = 1e-3  # K
FOLLOWING = 0.01  # of what the fastest node gains in a step, that one at rest may gain behind it
WIDENINGS = 6
MOST_ITERATIONS, SETTLED_K = 2000, 1e-7
RUNAWAY = 20.0  # time constants of a growing temperature within a step
FOLLOWED_S = 60.0  # that a rest goes step by step at first; what is left of it is bounded at once
SHAPES = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 41)])  # excesses of winding over housing that are tried
BURNT = 1e4  # degC, above which a bound is not worked out any further

HOTTEST, MEAN, HOUSING = range(3)
Seconds = TypeVar("Seconds", float, Array)
ACROSS = np.array([HOUSING, HOUSING, MEAN])  # the node that each of them gives to and takes from


class ThermalBound:
    """Bounds of several actuators side by side, one lane for each cell of each box; a box without width has one."""

    def __init__(self, boxes: Sequence[Box], start: float) -> None:
        grids = [_cells(box) for box in boxes]
        lanes = [grid.shape[1] for grid in grids]
        self.count = len(boxes)
        self._of = np.repeat(np.arange(self.count), lanes)
        self._first = np.concatenate([[0], np.cumsum(lanes)[:-1]])
        across_low, across_high, winding_low, winding_high = np.concatenate(grids, axis=1)

        def low(name: str) -> Array:
            return np.array([getattr(box, name).low for box in boxes])[self._of]

        def high(name: str) -> Array:
            return np.array([getattr(box, name).high for box in boxes])[self._of]

        def plain(name: str) -> Array:
            return np.array([getattr(box, name) for box in boxes])[self._of]

        # node by node: hottest phase, mean of the phases, housing; conductances for one phase, all phases, housing
        # as large as what they meet in `_lines`: numpy takes three times as long where it has to repeat rows
        self._to_housing = tuple(np.stack([g, g, g]) for g in (1.0 / across_high, 1.0 / across_low))
        to_air = 1.0 / high("winding_ambient_resistance"), 1.0 / low("winding_ambient_resistance")
        from_housing = 1.0 / high("housing_ambient_resistance"), 1.0 / low("housing_ambient_resistance")
        self._to_air = tuple(np.stack([w, w, h]) for w, h in zip(to_air, from_housing, strict=True))
        winding = winding_low, winding_high
        housing = low("housing_capacitance"), high("housing_capacitance")
        self._capacitance = tuple(np.stack([w, w, h]) for w, h in zip(winding, housing, strict=True))
        self._resistance, self._tref = high("phase_resistance"), plain("reference_temperature")
        self._rise = high("resistance_coefficient")
        self._rise_range = self._rise - low("resistance_coefficient")
        self._at_zero = 1.0 - self._rise * self._tref  # of the resistance, at 0 degC
        self._friction = high("coulomb_friction"), high("viscous_damping")
        self._gain_squared, self._ambient_rise = plain("current_gain") ** 2, np.stack([plain("ambient_rise")] * 3)
        self._decay = self._capacitance[0][MEAN] / (self._to_housing[1][MEAN] + self._to_air[1][MEAN])
        self.decay_s = float(np.min(self._decay))  # the shortest time constant of any winding
        self.state = np.full((3, len(self._of)), float(start))  # degC

    def step(
        self,
        duration: float,
        squares: Array,
        aligned: Array,
        speeds: Array,
        ambient: float,
        late: Array | float | None = None,
    ) -> None:
        """Advance all lanes.

        Parameters
        ----------
        duration : step [s], of any length.
        squares : mean square of each actuator's q-axis current over the step [A^2], as read.
        aligned : of each actuator, how far its current stood at one electrical angle: |mean i^2 e^(2j theta)| / mean
            i^2, 1 at standstill and 0 over whole turns.
        speeds : of each actuator, the largest speed in the step [rad/s].
        ambient : as measured or told [degC].
        late : of each actuator, how much later than evenly a phase's heat may have come [s]: see `lateness`. 0 where
            the current and the angle are known to stay as they are; as long as the step where nothing is said.
        """
        told = np.concatenate([squares, aligned, speeds, [duration, ambient]])
        if not (np.isfinite(told).all() and duration >= 0.0 and np.isfinite(self.state).all()):
            self.state = np.full_like(self.state, np.inf)  # nothing can be promised any more
            return
        pieces = max(1, int(np.ceil(duration / LONGEST_STEP_S)))
        square, share, friction, air = self._heat(squares, aligned, speeds, ambient)
        behind = duration / pieces if late is None else late
        if isinstance(behind, np.ndarray):
            behind = behind[self._of]
        square = square * (1.0 + behind / self._decay)  # less of what comes late has left again
        for _ in range(pieces):
            self._advance(duration / pieces, square, share, friction, air)

    def rest(self, duration: float, ambient: float) -> None:
        """Advance all lanes by a time [s] of any length without heat; ambient in degC.

        A long rest is bounded at once by rises above the air that fade together: a (1 + e) exp(-r t) in the winding and
        a exp(-r t) in the housing, where a is large enough for the rises that it begins with. They stay above the true
        ones if no node cools more slowly than they fade, whatever the parameters of its cell:
        r C (1 + e) <= e g + (1 + e) g_air for the winding and r C <= g_air - e g for the housing, where C is the node's
        capacitance, g_air leads to the air and g from winding to housing. The e that allows the fastest fading is
        taken; one of 0 allows some.
        """
        none = np.zeros(self.count)
        followed = min(duration, FOLLOWED_S)
        self.step(followed, none, none, none, ambient)
        if not (duration > followed and np.isfinite(self.state).all()):
            return
        excess = SHAPES[:, None]
        (g_low, g_high), (air_low, _), (_, heavy) = self._to_housing, self._to_air, self._capacitance
        winding = (excess * g_low[MEAN] + (1.0 + excess) * air_low[MEAN]) / ((1.0 + excess) * heavy[MEAN])
        housing = (air_low[HOUSING] - excess * g_high[HOUSING]) / heavy[HOUSING]
        rates = np.minimum(winding, housing)
        best = np.argmax(rates, axis=0)
        rate = np.take_along_axis(rates, best[None], axis=0)[0]
        shape = np.stack([1.0 + SHAPES[best], 1.0 + SHAPES[best], np.ones_like(rate)])
        air = ambient + self._ambient_rise
        most = np.maximum(np.max((self.state - air) / shape, axis=0), 0.0)
        self.state = air + most * shape * np.exp(-rate * (duration - followed))

    def settle(self, squares: Array, aligned: Array, speeds: Array, ambient: float) -> None:
        """Go to where constant heat leads in the end, `BURNT` where it runs away; arguments as of `step`."""
        square, share, friction, air = self._heat(squares, aligned, speeds, ambient)
        self.state = np.full_like(self.state, ambient)
        for _ in range(MOST_ITERATIONS):
            constant, slope = self._lines(self.state, self.state, square, share, friction, air)
            ends = slope > 0.0
            fresh = np.where(ends, np.minimum(constant / np.where(ends, slope, 1.0), BURNT), BURNT)
            moved = float(np.max(np.abs(fresh - self.state)))
            self.state = fresh
            if moved < SETTLED_K:
                return

    def _heat(self, squares: Array, aligned: Array, speeds: Array, ambient: float) -> tuple[Array, Array, Array, Array]:
        """Lane by lane: mean square current at the most, share of the hottest phase times 3, friction, air."""
        of = self._of
        speed = np.abs(speeds[of])
        friction = (self._friction[0] + self._friction[1] * speed) * speed
        return squares[of] * self._gain_squared, 1.0 + aligned[of], friction, ambient + self._ambient_rise

    def _advance(self, h: float, square: Array, share: Array, friction: Array, air: Array) -> None:
        factor = np.full_like(square, AHEAD)
        for _ in range(WIDENINGS):
            fresh, ceiling, floor = self._tried(h, square, share, friction, air, factor)
            kept = ((fresh <= ceiling) & (fresh >= floor)).all(axis=0)
            if kept.all():
                self.state = fresh
                return
            factor = np.where(kept, factor, 2.0 * factor)
        self._advance(0.5 * h, square, share, friction, air)
        self._advance(0.5 * h, square, share, friction, air)

    def _tried(
        self, h: float, square: Array, share: Array, friction: Array, air: Array, factor: Array
    ) -> tuple[Array, Array, Array]:
        """The state after a step, and between what it is taken to stay on the way."""
        state = self.state
        rate = self._rates(state, square, share, friction, air)
        gains, losses = h * np.maximum(rate, 0.0), h * np.minimum(rate, 0.0)
        ceiling = np.minimum(state + factor * (gains + WIDER + FOLLOWING * gains.max(axis=0)), BURNT)
        floor = state + factor * (losses - WIDER + FOLLOWING * losses.min(axis=0))
        constant, slope = self._lines(ceiling, floor, square, share, friction, air)
        gained = constant - slope * state
        capacitance = np.where(gained > 0.0, *self._capacitance)
        decay = np.maximum(slope * h / capacitance, -RUNAWAY)
        shrink = -np.expm1(-decay) / np.where(decay == 0.0, 1.0, decay)
        shrink[decay == 0.0] = 1.0
        return np.minimum(state + gained * shrink * h / capacitance, BURNT), ceiling, floor

    def fastest(self, squares: Array, aligned: Array, speeds: Array, ambient: float) -> float:
        """How fast any node rises at the most under such heat [K/s]; arguments as of `step`."""
        return float(np.max(self._rates(self.state, *self._heat(squares, aligned, speeds, ambient))))

    def _rates(self, state: Array, square: Array, share: Array, friction: Array, air: Array) -> Array:
        """How fast each node rises at the most [K/s]."""
        constant, slope = self._lines(state, state, square, share, friction, air)
        gained = constant - slope * state
        return np.asarray(gained / np.where(gained > 0.0, *self._capacitance), np.float64)

    def _lines(
        self, ceiling: Array, floor: Array, square: Array, share: Array, friction: Array, air: Array
    ) -> tuple[Array, Array]:
        """Of each node: its heat as `constant - slope x own temperature`, no less than it is in any bench of the box.

        Heats of the winding count as if all three phases were as the one that is bounded: one capacitance serves both.
        """
        cold = np.maximum(self._tref - np.minimum(floor[HOTTEST], floor[MEAN]), 0.0) * self._rise_range
        heat = self._resistance * square
        base, warmer = heat * (self._at_zero + cold), heat * self._rise
        constant, slope = inflow(air, ceiling, floor, *self._to_air)
        more, steeper = inflow(ceiling.take(ACROSS, axis=0), ceiling, floor, *self._to_housing)
        constant += more
        slope += steeper
        constant[HOTTEST] += share * base
        slope[HOTTEST] -= share * warmer
        constant[MEAN] += base + warmer * OTHER_PHASES * np.maximum(ceiling[HOTTEST], ceiling[MEAN])
        slope[MEAN] -= warmer * (1.0 - OTHER_PHASES)
        constant[HOUSING] += friction
        return constant, slope

    def hottest(self) -> Array:
        """Bound of each actuator's hottest phase [degC]."""
        return np.maximum.reduceat(self.state[HOTTEST], self._first)

    def nodes(self) -> Array:
        """Bounds of hottest phase, mean and housing, each the highest of its cells, shape (3, actuators) [degC]."""
        return np.maximum.reduceat(self.state, self._first, axis=1)

    def set(self, nodes: Array) -> None:
        """Start from bounds of hottest phase, mean and housing, shape (3, actuators) [degC]."""
        self.state = np.ascontiguousarray(nodes[:, self._of])


def _cells(box: Box) -> Array:
    """Edges of what a box is split into: low and high resistances to the housing, low and high winding capacitances."""
    across, winding = box.winding_housing_resistance, box.winding_capacitance
    sides = across.cells(CELLS if across.high > across.low else 1)
    heats = winding.cells(CAPACITANCE_CELLS if winding.high > winding.low else 1)
    pairs = [np.meshgrid(side, heat) for side in sides for heat in heats]
    (low, light), (_, heavy), (high, _), _ = pairs
    return np.stack([low.ravel(), high.ravel(), light.ravel(), heavy.ravel()])


def lateness(behind: Seconds, duration: Seconds, unseen: float, decay: float) -> Seconds:
    """How much later than evenly the heat of a phase may count as having come in a step [s].

    Heat leaves at a rate r at the most, so that exp(-r (d - t)) of what comes at t is left at the end of a step. That
    is convex in t: of all heats with one mean time most is left of what comes at both ends of the step alone, which is
    (r d/2) coth(r d/2) + r s times what is left of an even one, where s is how far the mean time lies behind the
    middle; and x coth x is no more than 1 + x^2 / 3.

    Parameters
    ----------
    behind : how far the mean time of a phase's heat lies behind the middle of the step [s].
    duration : of the step [s].
    unseen : the longest time from look to look [s], of which the middle is taken, whatever is within.
    decay : 1/r [s].
    """
    return behind + 0.5 * unseen + duration * duration / (12.0 * decay)


def inflow(source: Array, ceiling: Array, floor: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Bound of g x (source - own) over conductances g from low to high, as constant and slope of the own temperature.

    The own temperature stays between floor and ceiling. Where the source is above that, the higher conductance is the
    worst; elsewhere the lower one's line, raised by what the difference of the two can bring in.
    """
    slope = np.where(source >= ceiling, high, low)
    return slope * source + (high - slope) * np.maximum(source - floor, 0.0), slope
