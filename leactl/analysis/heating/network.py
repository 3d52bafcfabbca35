"""The thermal network behind heated records: least squares over every frame, the network solved exactly in each try.

Unknowns are the winding's conductance to the air, which may be nothing, the logarithms of the other two resistances
and both capacitances, and for each stretch of record the temperatures it began at, the camera's offset at winding and
housing from the sensor of the air (without one, the air's temperature), and the lag of the camera's clock.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.heating.record import Array, HeatingRecord
from leactl.analysis.heating.start import covered, guesses, starting_lag, thinned
from leactl.errors import NotIdentifiable
from leactl.model.thermal_network import Conductances, Drive, driven_at, left_of_start

NETWORK = 5  # unknowns that all stretches share
STEP = 1e-4  # of central differences: their error is its square
EXACT = 1e-12
FARTHEST = 12.0  # e-folds that a logarithm may go from where it began


@dataclass(frozen=True)
class Unknowns:
    """Which unknowns a fit has, and where they are."""

    offset_std: float  # K, prior of the camera's offset from the sensor of the air; zero: there is none
    lag: float | None  # s, of the camera's clock as told; None: it is fitted

    def of(self, stretch: HeatingRecord) -> tuple[str, ...]:
        """Names of what is a stretch's own."""
        air = ("air",) if stretch.ambient is None else ("offset_winding", "offset_housing") if self.offset_std else ()
        lag = ("lag",) if self.lag is None else ()
        return ("winding_start", "housing_start", *air, *lag)


@dataclass(frozen=True, eq=False)
class NetworkFit:
    """The optimum, and what its uncertainty is made of."""

    point: Array  # all unknowns
    names: tuple[tuple[str, ...], ...]  # of each stretch's own, after the network's five
    stretches: tuple[HeatingRecord, ...]
    fitted: tuple[Array, ...]  # degC of each stretch, winding and housing, shape (2, frames)
    columns: tuple[Array, ...]  # derivatives of these, shape (2, frames, unknowns)
    prior: Array  # weight of each unknown's prior, one over K^2 of noise
    lags: tuple[float, ...]  # s, of the camera's clock in each stretch
    rates: tuple[Array, ...]  # K/s, how fast the fitted temperatures change, shape (2, frames)

    @property
    def network(self) -> Conductances:
        """The network at the optimum."""
        return network_of(self.point)

    @property
    def residuals(self) -> list[Array]:
        """Measured less fitted [K] of each stretch, NaN where a frame is missing."""
        return [measured(one) - fit for one, fit in zip(self.stretches, self.fitted, strict=True)]

    def own(self, stretch: int, name: str) -> int | None:
        """Where an unknown of a stretch is; None where it has none of this name."""
        start = NETWORK + sum(len(names) for names in self.names[:stretch])
        return start + self.names[stretch].index(name) if name in self.names[stretch] else None


def network_of(point: Array) -> Conductances:
    """The network of a point."""
    wh, ha, cw, ch = np.exp(point[1:NETWORK])
    return Conductances(float(point[0]), 1.0 / float(wh), 1.0 / float(ha), float(cw), float(ch))


def measured(stretch: HeatingRecord) -> Array:
    """What the camera saw, shape (2, frames)."""
    return np.stack([stretch.winding, stretch.housing])


def fit_network(stretches: Sequence[HeatingRecord], unknowns: Unknowns, place: str) -> NetworkFit:
    """Least squares over winding and housing at the same weight, every frame counted once.

    Raises
    ------
    NotIdentifiable : too few frames, or no network of two bodies comes near what was seen; `place` opens the message.
    """
    lags = [starting_lag(one) if "lag" in unknowns.of(one) else unknowns.lag or 0.0 for one in stretches]
    records = [covered(one, lag) for one, lag in zip(stretches, lags, strict=True)]
    thin = [thinned(one) for one in records]
    begun = [value for one, lag in zip(thin, lags, strict=True) for value in _begun(one, unknowns, lag)]
    tries = [_solved(thin, unknowns, np.array([*guess, *begun]), 1.0) for guess in guesses(thin)]
    best = min((one for one in tries if one is not None), key=lambda one: one[1], default=None)
    noise = _noise_of(records, unknowns, best[0]) if best is not None else math.nan
    final = _solved(records, unknowns, best[0], noise) if best is not None else None
    if final is None:
        raise NotIdentifiable(f"{place}: no network of winding and housing follows these temperatures")
    point = final[0]
    fitted = tuple(_fitted(one, unknowns, *own) for one, own in _each(records, unknowns, point))
    columns = tuple(_columns(records, unknowns, point))
    names = tuple(unknowns.of(one) for one in records)
    each = _each(records, unknowns, point)
    late = tuple(own.get("lag", unknowns.lag or 0.0) for _, (_, own) in each)
    rates = tuple(_rate(one, unknowns, *own) for one, own in each)
    weight = priors(records, unknowns, noise)
    return NetworkFit(point, names, tuple(records), fitted, columns, weight, late, rates)


def residual(records: Sequence[HeatingRecord], unknowns: Unknowns, point: Array, noise: float) -> Array:
    """What least squares makes small [K]: every frame that was seen, then the offsets' priors."""
    parts = [_seen(measured(one) - _fitted(one, unknowns, *own), one) for one, own in _each(records, unknowns, point)]
    weight = priors(records, unknowns, noise)
    return np.concatenate([*parts, -(np.sqrt(weight) * point)[weight > 0.0]])


def priors(records: Sequence[HeatingRecord], unknowns: Unknowns, noise: float) -> Array:
    """Weight of each unknown's prior: only offsets have one, around nothing."""
    names = [name for one in records for name in unknowns.of(one)]
    weight = (noise / unknowns.offset_std) ** 2 if unknowns.offset_std else 0.0
    return np.array([0.0] * NETWORK + [weight if name.startswith("offset") else 0.0 for name in names])


def _solved(
    records: Sequence[HeatingRecord], unknowns: Unknowns, begin: Array, noise: float
) -> tuple[Array, float] | None:
    """The optimum from a start and its sum of squares; None where nothing comes of it."""
    from scipy.optimize import least_squares

    weight = priors(records, unknowns, noise)
    pulled = np.diag(np.sqrt(weight))[weight > 0.0]

    def slopes(point: Array) -> Array:
        parts = [_seen(columns, one) for columns, one in zip(_columns(records, unknowns, point), records, strict=True)]
        return -np.concatenate([*parts, pulled])

    def left(point: Array) -> Array:
        if np.max(np.abs(point[1:NETWORK] - begin[1:NETWORK])) > FARTHEST or point[0] < -begin[0]:
            return np.full(size, 1e3)
        return residual(records, unknowns, point, noise)

    size = len(residual(records, unknowns, begin, noise))
    if size <= len(begin):
        return None
    found = least_squares(left, begin, slopes, method="lm", x_scale="jac", xtol=EXACT, ftol=EXACT, gtol=EXACT)
    return (found.x, float(2.0 * found.cost)) if np.isfinite(found.x).all() else None


def _begun(stretch: HeatingRecord, unknowns: Unknowns, lag: float) -> list[float]:
    """A start of what is a stretch's own."""
    seen = measured(stretch)
    first = [float(row[np.isfinite(row)][0]) for row in seen]
    air = min(first) if stretch.ambient is None else 0.0
    known = {"winding_start": first[0] - air, "housing_start": first[1] - air, "air": air, "lag": lag}
    return [known.get(name, 0.0) for name in unknowns.of(stretch)]


def _each(
    records: Sequence[HeatingRecord], unknowns: Unknowns, point: Array
) -> list[tuple[HeatingRecord, tuple[Conductances, dict[str, float]]]]:
    """Each stretch with the network and its own unknowns by name."""
    network, found, at = network_of(point), [], NETWORK
    for one in records:
        names = unknowns.of(one)
        found.append((one, (network, dict(zip(names, point[at : at + len(names)].tolist(), strict=True)))))
        at += len(names)
    return found


def _fitted(stretch: HeatingRecord, unknowns: Unknowns, network: Conductances, own: dict[str, float]) -> Array:
    """Temperatures [degC] as the camera would see them."""
    forced, _ = _forced(stretch, unknowns, network, own)
    return forced + _started(stretch, unknowns, network, own) + _offset(own)


def _offset(own: dict[str, float]) -> Array:
    air = own.get("air", 0.0)
    return np.array([[own.get("offset_winding", 0.0) + air], [own.get("offset_housing", 0.0) + air]])


def _forced(
    stretch: HeatingRecord, unknowns: Unknowns, network: Conductances, own: dict[str, float]
) -> tuple[Array, Array]:
    return driven_at(network, drive_of(stretch), _stamps(stretch, unknowns, own))


def _started(stretch: HeatingRecord, unknowns: Unknowns, network: Conductances, own: dict[str, float]) -> Array:
    after = _stamps(stretch, unknowns, own) - stretch.supply.time[0]
    start = np.array([own["winding_start"], own["housing_start"]])
    return np.asarray(np.einsum("nst,s->nt", left_of_start(network, after), start), np.float64)


def _stamps(stretch: HeatingRecord, unknowns: Unknowns, own: dict[str, float]) -> Array:
    """The camera's frames by the clock of the supply [s]."""
    return np.asarray(stretch.time - own.get("lag", unknowns.lag or 0.0))


def drive_of(stretch: HeatingRecord) -> Drive:
    """What drives the network: readings that are means hold over their interval, others are joined by straight lines.

    A current that is switched between two readings steps halfway; the lag of the clock takes up where it really does.
    """
    supply, heat = stretch.supply, stretch.supply.heat
    air = np.zeros(len(heat)) if stretch.ambient is None else stretch.ambient
    if supply.means:
        return Drive(supply.time, heat[1:], heat[1:], air)
    at = np.flatnonzero(np.diff(supply.on))
    time, ambient = (np.insert(values, at + 1, 0.5 * (values[at] + values[at + 1])) for values in (supply.time, air))
    before, after = np.insert(heat, at + 1, heat[at]), np.insert(heat, at + 1, heat[at + 1])
    return Drive(time, after[:-1], before[1:], ambient)


def _columns(records: Sequence[HeatingRecord], unknowns: Unknowns, point: Array) -> list[Array]:
    """Derivatives of what each stretch's camera would see, shape (2, frames, unknowns)."""
    found, at, each = [], NETWORK, _each(records, unknowns, point)
    steps = np.full(NETWORK, STEP)
    steps[0] *= 1.0 / math.exp(point[2])  # a conductance goes with that past the housing
    for one, (network, own) in each:
        out = np.zeros((2, len(one.time), len(point)))
        for k, step in enumerate(steps):
            moved = [point + sign * step * np.eye(len(point))[k] for sign in (1.0, -1.0)]
            high, low = (_fitted(one, unknowns, network_of(p), own) for p in moved)
            out[:, :, k] = (high - low) / (2.0 * step)
        after = _stamps(one, unknowns, own) - one.supply.time[0]
        start, names = left_of_start(network, after), unknowns.of(one)
        known = {
            "winding_start": start[:, 0],
            "housing_start": start[:, 1],
            "air": np.ones((2, 1)),
            "offset_winding": np.array([[1.0], [0.0]]),
            "offset_housing": np.array([[0.0], [1.0]]),
        }
        for place, name in enumerate(names, start=at):
            out[:, :, place] = -_rate(one, unknowns, network, own) if name == "lag" else known[name]
        at += len(names)
        found.append(out)
    return found


def _rate(stretch: HeatingRecord, unknowns: Unknowns, network: Conductances, own: dict[str, float]) -> Array:
    """How fast the fitted temperatures change [K/s]."""
    rates, shapes, inverse = network.modes()
    started = _started(stretch, unknowns, network, own)
    return _forced(stretch, unknowns, network, own)[1] + (shapes * rates) @ inverse @ started


def _seen(values: Array, stretch: HeatingRecord) -> Array:
    """Frames that were seen, winding first."""
    seen = np.isfinite(measured(stretch))
    return np.concatenate([values[node][seen[node]] for node in (0, 1)])


def _noise_of(records: Sequence[HeatingRecord], unknowns: Unknowns, point: Array) -> float:
    left = residual(records, unknowns, point, 0.0)
    return math.sqrt(max(float(np.mean(left**2)), 1e-18))
