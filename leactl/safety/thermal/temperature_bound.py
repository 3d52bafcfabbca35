"""An upper bound of the temperatures of actuators, guaranteed for every parameter inside its box.

An actuator has three phases of a third of the winding each, and a housing; phase k takes (1 + cos(2 theta - 2 phi_k))
/ 3 of the copper heat, up to two thirds at standstill. Three nodes bound it: the hottest phase, whatever the angle of
commutation, the mean of the phases, and the housing. The heat flow into a node rises with the temperature of every
other node (a cooperative system), so that an upper bound of each node follows from upper bounds of the others
(Mueller, 1927; Walter, Differential and Integral Inequalities, 1970): each equation is maximised over the box, a
capacitance low where its node heats up and high where it cools. Heat that leaves the winding through the resistance to
the housing enters the housing: two flows maximised independently, one at either end, would create heat. Nor does any
real winding heat with its lowest capacitance and cool with its highest. The ranges of this resistance and of the
winding's capacitance are therefore split into cells, and each cell has a bound of its own.

A step is order-preserving: the temperatures of the other nodes are replaced by limits that hold over the whole step,
and the equation of each node, linear then, is solved exactly. A step is tried with narrow limits, which are widened
until they hold.
"""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from leactl.safety.thermal.box import Array, Box

CELLS, CAPACITANCE_CELLS = 12, 4  # of the resistance to the housing and of the winding's capacitance
LONGEST_STEP_S = 2.0
# weight of the hottest phase, beside the mean of the phases, in the temperature of the winding's resistance: half where
# phases heat alike, see docs
OTHER_PHASES = 0.55
# first limits of a node's temperature during a step
GAIN_FACTOR = 1.5  # over what the node would gain or lose in the step at its present rate
GAIN_FLOOR_K = 1e-3
NEIGHBOUR_SHARE = 0.01  # of what the fastest node gains in the step: that node warms the others
MOST_WIDENINGS = 6  # of these limits, before the step is halved
MOST_ITERATIONS, SETTLED_K = 2000, 1e-7  # of `settle`, which ends early once no node changes by more
MOST_GROWTH_CONSTANTS = 20.0  # time constants within a step, of a temperature that grows exponentially
STEPPED_REST_S = 60.0  # the first part of a rest, which is stepped; the remainder is bounded in closed form
# relative excesses e of the winding's rise over the housing's that `rest` tries
SHAPES = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 41)])
BURNT_DEGC = 1e4  # degC, the highest temperature that a bound is computed up to

HOTTEST, MEAN, HOUSING = range(3)
Seconds = TypeVar("Seconds", float, Array)
NEIGHBOUR_NODE = np.array([HOUSING, HOUSING, MEAN])  # for each node, the node that it exchanges heat with


class ThermalBound:
    """Upper bounds of the temperatures of several actuators.

    The state is an array of shape (3, lanes): one lane for each cell of each box. A box without width has one cell.
    """

    def __init__(self, boxes: Sequence[Box], start: float) -> None:
        grids = [_cells(box) for box in boxes]
        lanes = [grid.shape[1] for grid in grids]
        self.count = len(boxes)
        self._actuator_of_lane = np.repeat(np.arange(self.count), lanes)
        self._first_lane = np.concatenate([[0], np.cumsum(lanes)[:-1]])
        housing_resistance_low, housing_resistance_high, winding_capacitance_low, winding_capacitance_high = (
            np.concatenate(grids, axis=1)
        )

        def low(name: str) -> Array:
            return np.array([getattr(box, name).low for box in boxes])[self._actuator_of_lane]

        def high(name: str) -> Array:
            return np.array([getattr(box, name).high for box in boxes])[self._actuator_of_lane]

        def single(name: str) -> Array:
            return np.array([getattr(box, name) for box in boxes])[self._actuator_of_lane]

        # rows: hottest phase, scaled to a winding of three such phases, mean of the phases, housing; every array has
        # the full shape of the state, because numpy takes three times as long in `_linear_flows` if it broadcasts rows
        self._to_housing = tuple(
            np.stack([g, g, g]) for g in (1.0 / housing_resistance_high, 1.0 / housing_resistance_low)
        )
        to_air = 1.0 / high("winding_ambient_resistance"), 1.0 / low("winding_ambient_resistance")
        housing_to_air = 1.0 / high("housing_ambient_resistance"), 1.0 / low("housing_ambient_resistance")
        self._to_air = tuple(np.stack([w, w, h]) for w, h in zip(to_air, housing_to_air, strict=True))
        winding_capacitance = winding_capacitance_low, winding_capacitance_high
        housing_capacitance = low("housing_capacitance"), high("housing_capacitance")
        self._capacitance = tuple(
            np.stack([w, w, h]) for w, h in zip(winding_capacitance, housing_capacitance, strict=True)
        )
        self._resistance, self._reference_temperature = high("phase_resistance"), single("reference_temperature")
        self._coefficient = high("resistance_coefficient")
        self._coefficient_range = self._coefficient - low("resistance_coefficient")
        # resistance at 0 degC over the resistance at the reference temperature
        self._resistance_factor_at_zero = 1.0 - self._coefficient * self._reference_temperature
        self._friction = high("coulomb_friction"), high("viscous_damping")
        self._gain_squared, self._ambient_rise = single("current_gain") ** 2, np.stack([single("ambient_rise")] * 3)
        self._decay = self._capacitance[0][MEAN] / (self._to_housing[1][MEAN] + self._to_air[1][MEAN])
        self.decay_s = float(np.min(self._decay))  # the shortest time constant of any winding
        self.state = np.full((3, len(self._actuator_of_lane)), float(start))  # degC

    def step(
        self,
        duration: float,
        squares: Array,
        aligned: Array,
        speeds: Array,
        ambient: float,
        delay: Array | float | None = None,
    ) -> None:
        """Advance the bounds of all actuators by one step.

        An input that is not finite or a negative duration makes all bounds infinite.

        Parameters
        ----------
        duration : step [s], of any length.
        squares : mean square of each actuator's q-axis current reading over the step [A^2], shape (actuators,).
        aligned : |mean i^2 e^(2j theta)| / mean i^2 of each actuator, over its electrical angle theta, shape
            (actuators,): 1 at standstill and 0 over whole turns.
        speeds : largest speed of each actuator in the step [rad/s], shape (actuators,).
        ambient : temperature of the air, as measured or as the bench file has it [degC].
        delay : upper bound [s] of the delay of a phase's heat behind heat that comes evenly over the step; see
            `delay_bound`. A number, or one for each actuator. 0 where current and angle are known to stay constant.
            None: the length of each piece of at most `LONGEST_STEP_S` that the step is split into.
        """
        inputs = np.concatenate([squares, aligned, speeds, [duration, ambient]])
        if not (np.isfinite(inputs).all() and duration >= 0.0 and np.isfinite(self.state).all()):
            self.state = np.full_like(self.state, np.inf)  # nothing can be promised any more
            return
        pieces = max(1, int(np.ceil(duration / LONGEST_STEP_S)))
        lane_square, share, friction, air = self._heat(squares, aligned, speeds, ambient)
        lane_delay = duration / pieces if delay is None else delay
        if isinstance(lane_delay, np.ndarray):
            lane_delay = lane_delay[self._actuator_of_lane]
        # of heat that comes late, less has left by the end of the step
        lane_square = lane_square * (1.0 + lane_delay / self._decay)
        for _ in range(pieces):
            self._advance(duration / pieces, lane_square, share, friction, air)

    def rest(self, duration: float, ambient: float) -> None:
        """Advance the bounds of all actuators by a time [s] of any length without heat; ambient in degC.

        The first `STEPPED_REST_S` are stepped. The remainder is bounded in closed form by rises above the air that
        decay together: a (1 + e) exp(-r t) in the winding and a exp(-r t) in the housing, where the amplitude a covers
        the rises at its start. They stay above the true rises if every node cools at least as fast as they decay,
        whatever the parameters of its cell: r C (1 + e) <= e g + (1 + e) g_air for the winding and r C <= g_air - e g
        for the housing, where C is the node's capacitance, g_air the conductance to the air and g that from winding to
        housing. Of the `SHAPES`, the e that allows the fastest decay is taken; e = 0 always allows one.
        """
        zeros = np.zeros(self.count)
        stepped_time = min(duration, STEPPED_REST_S)
        self.step(stepped_time, zeros, zeros, zeros, ambient)
        if not (duration > stepped_time and np.isfinite(self.state).all()):
            return
        excess = SHAPES[:, None]
        (g_low, g_high), (air_low, _), (_, highest_capacitance) = self._to_housing, self._to_air, self._capacitance
        winding_rate = (excess * g_low[MEAN] + (1.0 + excess) * air_low[MEAN]) / (
            (1.0 + excess) * highest_capacitance[MEAN]
        )
        housing_rate = (air_low[HOUSING] - excess * g_high[HOUSING]) / highest_capacitance[HOUSING]
        rates = np.minimum(winding_rate, housing_rate)
        best_shape = np.argmax(rates, axis=0)
        rate = np.take_along_axis(rates, best_shape[None], axis=0)[0]
        shape = np.stack([1.0 + SHAPES[best_shape], 1.0 + SHAPES[best_shape], np.ones_like(rate)])
        air = ambient + self._ambient_rise
        amplitude = np.maximum(np.max((self.state - air) / shape, axis=0), 0.0)
        self.state = air + amplitude * shape * np.exp(-rate * (duration - stepped_time))

    def settle(self, squares: Array, aligned: Array, speeds: Array, ambient: float) -> None:
        """Set the bounds to their steady state under constant heat, or to `BURNT_DEGC` where none exists.

        Arguments are those of `step`.
        """
        square, share, friction, air = self._heat(squares, aligned, speeds, ambient)
        self.state = np.full_like(self.state, ambient)
        for _ in range(MOST_ITERATIONS):
            constant, slope = self._linear_flows(self.state, self.state, square, share, friction, air)
            converges = slope > 0.0
            new_state = np.where(
                converges, np.minimum(constant / np.where(converges, slope, 1.0), BURNT_DEGC), BURNT_DEGC
            )
            largest_change = float(np.max(np.abs(new_state - self.state)))
            self.state = new_state
            if largest_change < SETTLED_K:
                return

    def _heat(self, squares: Array, aligned: Array, speeds: Array, ambient: float) -> tuple[Array, Array, Array, Array]:
        """Return the heat input of each lane, at the most.

        These are the mean square current [A^2], three times the hottest phase's share of the copper heat, and the heat
        of friction [W], each of shape (lanes,), and the temperature of the air [degC], of shape (3, lanes).
        """
        lanes = self._actuator_of_lane
        speed = np.abs(speeds[lanes])
        friction = (self._friction[0] + self._friction[1] * speed) * speed
        return squares[lanes] * self._gain_squared, 1.0 + aligned[lanes], friction, ambient + self._ambient_rise

    def _advance(self, duration: float, square: Array, share: Array, friction: Array, air: Array) -> None:
        """Advance the state by one step, in two halves if no limits tried for the step hold."""
        widening = np.full_like(square, GAIN_FACTOR)
        for _ in range(MOST_WIDENINGS):
            new_state, ceiling, floor = self._trial_step(duration, square, share, friction, air, widening)
            is_valid = ((new_state <= ceiling) & (new_state >= floor)).all(axis=0)
            if is_valid.all():
                self.state = new_state
                return
            widening = np.where(is_valid, widening, 2.0 * widening)
        self._advance(0.5 * duration, square, share, friction, air)
        self._advance(0.5 * duration, square, share, friction, air)

    def _trial_step(
        self, duration: float, square: Array, share: Array, friction: Array, air: Array, widening: Array
    ) -> tuple[Array, Array, Array]:
        """Return the state after a step [degC], and the ceiling and floor that the step assumes for the state.

        The step is a bound only where the new state lies within them; `widening` widens them, lane by lane.
        """
        state = self.state
        rate = self._rates(state, square, share, friction, air)
        gains, losses = duration * np.maximum(rate, 0.0), duration * np.minimum(rate, 0.0)
        ceiling = np.minimum(
            state + widening * (gains + GAIN_FLOOR_K + NEIGHBOUR_SHARE * gains.max(axis=0)), BURNT_DEGC
        )
        floor = state + widening * (losses - GAIN_FLOOR_K + NEIGHBOUR_SHARE * losses.min(axis=0))
        constant, slope = self._linear_flows(ceiling, floor, square, share, friction, air)
        net_heat = constant - slope * state
        capacitance = np.where(net_heat > 0.0, *self._capacitance)
        decays = np.maximum(slope * duration / capacitance, -MOST_GROWTH_CONSTANTS)
        mean_decay = -np.expm1(-decays) / np.where(decays == 0.0, 1.0, decays)
        mean_decay[decays == 0.0] = 1.0
        return np.minimum(state + net_heat * mean_decay * duration / capacitance, BURNT_DEGC), ceiling, floor

    def fastest_warming(self, squares: Array, aligned: Array, speeds: Array, ambient: float) -> float:
        """Return the largest rate at which any node warms under this heat [K/s]; arguments are those of `step`."""
        return float(np.max(self._rates(self.state, *self._heat(squares, aligned, speeds, ambient))))

    def _rates(self, state: Array, square: Array, share: Array, friction: Array, air: Array) -> Array:
        """Return the largest rate at which each node warms [K/s], shape (3, lanes)."""
        constant, slope = self._linear_flows(state, state, square, share, friction, air)
        net_heat = constant - slope * state
        return np.asarray(net_heat / np.where(net_heat > 0.0, *self._capacitance), np.float64)

    def _linear_flows(
        self, ceiling: Array, floor: Array, square: Array, share: Array, friction: Array, air: Array
    ) -> tuple[Array, Array]:
        """Return constant [W] and slope [W/K] of a line over each node's temperature that bounds its net heat flow.

        The line is `constant - slope * temperature`; no actuator of the box has a larger flow. The flow into the
        hottest phase is scaled to a winding of three such phases, so that the capacitance of the whole winding serves
        both nodes.
        """
        cold_correction = (
            np.maximum(self._reference_temperature - np.minimum(floor[HOTTEST], floor[MEAN]), 0.0)
            * self._coefficient_range
        )
        reference_heat = self._resistance * square
        base_heat, heat_per_kelvin = (
            reference_heat * (self._resistance_factor_at_zero + cold_correction),
            reference_heat * self._coefficient,
        )
        constant, slope = inflow(air, ceiling, floor, *self._to_air)
        housing_constant, housing_slope = inflow(
            ceiling.take(NEIGHBOUR_NODE, axis=0), ceiling, floor, *self._to_housing
        )
        constant += housing_constant
        slope += housing_slope
        constant[HOTTEST] += share * base_heat
        slope[HOTTEST] -= share * heat_per_kelvin
        constant[MEAN] += base_heat + heat_per_kelvin * OTHER_PHASES * np.maximum(ceiling[HOTTEST], ceiling[MEAN])
        slope[MEAN] -= heat_per_kelvin * (1.0 - OTHER_PHASES)
        constant[HOUSING] += friction
        return constant, slope

    def hottest(self) -> Array:
        """Return the bound of each actuator's hottest phase [degC], shape (actuators,)."""
        return np.maximum.reduceat(self.state[HOTTEST], self._first_lane)

    def nodes(self) -> Array:
        """Return the bounds of hottest phase, mean of the phases and housing [degC], shape (3, actuators).

        Each bound is the highest among the actuator's cells.
        """
        return np.maximum.reduceat(self.state, self._first_lane, axis=1)

    def set(self, nodes: Array) -> None:
        """Replace the state by bounds of hottest phase, mean of the phases and housing [degC], shape (3, actuators)."""
        self.state = np.ascontiguousarray(nodes[:, self._actuator_of_lane])


def _cells(box: Box) -> Array:
    """Split a box into cells; return their edges, shape (4, cells).

    Rows: low and high resistance from winding to housing [K/W], low and high capacitance of the winding [J/K].
    """
    resistance, capacitance = box.winding_housing_resistance, box.winding_capacitance
    resistance_edges = resistance.cells(CELLS if resistance.high > resistance.low else 1)
    capacitance_edges = capacitance.cells(CAPACITANCE_CELLS if capacitance.high > capacitance.low else 1)
    pairs = [
        np.meshgrid(edge_resistance, edge_capacitance)
        for edge_resistance in resistance_edges
        for edge_capacitance in capacitance_edges
    ]
    (low, capacitance_low), (_, capacitance_high), (high, _), _ = pairs
    return np.stack([low.ravel(), high.ravel(), capacitance_low.ravel(), capacitance_high.ravel()])


def delay_bound(mean_delay: Seconds, duration: Seconds, longest_gap: float, decay: float) -> Seconds:
    """Return an upper bound of the delay of a phase's heat behind heat that comes evenly over the step [s].

    Heat leaves at a rate r at the most, so that exp(-r (d - t)) of the heat that comes at t remains at the end of a
    step of length d. This is convex in t: of all heats with the same mean time, heat that comes at the two ends of the
    step alone leaves the largest remainder, (r d/2) coth(r d/2) + r s times that of even heat, where s is the time from
    the middle of the step to the mean time; and x coth x is no more than 1 + x^2 / 3.

    Parameters
    ----------
    mean_delay : time from the middle of the step to the mean time of a phase's heat [s].
    duration : of the step [s].
    longest_gap : longest time between two samples [s]; the heat between them is assigned to its middle.
    decay : time constant 1/r [s].
    """
    return mean_delay + 0.5 * longest_gap + duration * duration / (12.0 * decay)


def inflow(source: Array, ceiling: Array, floor: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return constant and slope of a line `constant - slope * node` that bounds the heat flow g * (source - node).

    The conductance g lies between `low` and `high` and the temperature of the node between `floor` and `ceiling`. Where
    the source is above the ceiling, the high conductance gives the largest flow. Elsewhere the line is that of the low
    conductance, raised by the most that the difference of the conductances can bring in.
    """
    slope = np.where(source >= ceiling, high, low)
    return slope * source + (high - slope) * np.maximum(source - floor, 0.0), slope
