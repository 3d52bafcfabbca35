"""The thermal network behind heated records: least squares over every frame, the network solved exactly in each try.

Unknowns are the winding's conductance to the air, which may be nothing, the logarithms of the other two resistances
and both capacitances, and for each stretch of record the temperatures it began at, the camera's offset at winding and
housing from the sensor of the air (without one, the air's temperature), and the lag of the camera's clock.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.heating.first_guess import covered, guesses, starting_lag, thinned
from leactl.analysis.heating.record import Array, HeatingRecord
from leactl.errors import NotIdentifiable
from leactl.model.thermal_network import Conductances, Drive, driven_at, remaining_rise

NETWORK = 5  # unknowns that all records share
STEP = 1e-4  # of central differences: their error is its square
EXACT = 1e-12
FARTHEST = 12.0  # e-folds that a logarithm may move from its starting value


@dataclass(frozen=True)
class Unknowns:
    """Which unknowns a fit has beside the network's five."""

    offset_std: float  # K, prior of the camera's offset from the sensor of the air; zero: there is none
    lag: float | None  # s, of the camera's clock as told; None: it is fitted

    def of(self, record: HeatingRecord) -> tuple[str, ...]:
        """Return the names of the unknowns of one record."""
        air = ("air",) if record.ambient is None else ("offset_winding", "offset_housing") if self.offset_std else ()
        lag = ("lag",) if self.lag is None else ()
        return ("winding_start", "housing_start", *air, *lag)


@dataclass(frozen=True, eq=False)
class NetworkFit:
    """Least-squares fit of the network, with what its uncertainty follows from."""

    point: Array  # all unknowns
    names: tuple[tuple[str, ...], ...]  # of each record's own unknowns, after the network's five
    records: tuple[HeatingRecord, ...]
    fitted: tuple[Array, ...]  # degC of each record, winding and housing, shape (2, frames)
    columns: tuple[Array, ...]  # derivatives of these, shape (2, frames, unknowns)
    prior: Array  # weight of each unknown's prior, one over K^2 of noise
    lags: tuple[float, ...]  # s, of the camera's clock in each record
    rates: tuple[Array, ...]  # K/s, how fast the fitted temperatures change, shape (2, frames)

    @property
    def network(self) -> Conductances:
        """The fitted network."""
        return network_of(self.point)

    @property
    def residuals(self) -> list[Array]:
        """Measured less fitted temperatures [K] of each record, shape (2, frames), NaN where a frame is missing."""
        return [measured(record) - fit for record, fit in zip(self.records, self.fitted, strict=True)]

    def index_of(self, stretch: int, name: str) -> int | None:
        """Return the index of an unknown of a record in `point`; None where the record has none of this name."""
        first = NETWORK + sum(len(names) for names in self.names[:stretch])
        return first + self.names[stretch].index(name) if name in self.names[stretch] else None


def network_of(point: Array) -> Conductances:
    """Return the network that the first five unknowns describe."""
    wh, ha, cw, ch = np.exp(point[1:NETWORK])
    return Conductances(float(point[0]), 1.0 / float(wh), 1.0 / float(ha), float(cw), float(ch))


def measured(record: HeatingRecord) -> Array:
    """Return the camera's temperatures of winding and housing [degC], shape (2, frames)."""
    return np.stack([record.winding, record.housing])


def fit_network(records: Sequence[HeatingRecord], unknowns: Unknowns, place: str) -> NetworkFit:
    """Least squares over winding and housing at the same weight, every frame counted once.

    Raises
    ------
    NotIdentifiable : too few frames, or no network of two bodies comes near what was seen; `place` opens the message.
    """
    lags = [starting_lag(record) if "lag" in unknowns.of(record) else unknowns.lag or 0.0 for record in records]
    covered_records = [covered(record, lag) for record, lag in zip(records, lags, strict=True)]
    thin_records = [thinned(record) for record in covered_records]
    starts = [value for record, lag in zip(thin_records, lags, strict=True) for value in _begun(record, unknowns, lag)]
    solutions = [_solved(thin_records, unknowns, np.array([*guess, *starts]), 1.0) for guess in guesses(thin_records)]
    best = min((record for record in solutions if record is not None), key=lambda record: record[1], default=None)
    noise = _noise_of(covered_records, unknowns, best[0]) if best is not None else math.nan
    solution = _solved(covered_records, unknowns, best[0], noise) if best is not None else None
    if solution is None:
        raise NotIdentifiable(f"{place}: no network of winding and housing follows these temperatures")
    point = solution[0]
    fitted = tuple(
        _fitted(record, unknowns, *record_unknowns)
        for record, record_unknowns in _each(covered_records, unknowns, point)
    )
    columns = tuple(_columns(covered_records, unknowns, point))
    names = tuple(unknowns.of(record) for record in covered_records)
    by_record = _each(covered_records, unknowns, point)
    lags_fitted = tuple(record_unknowns.get("lag", unknowns.lag or 0.0) for _, (_, record_unknowns) in by_record)
    rates = tuple(_rate(record, unknowns, *record_unknowns) for record, record_unknowns in by_record)
    weight = priors(covered_records, unknowns, noise)
    return NetworkFit(point, names, tuple(covered_records), fitted, columns, weight, lags_fitted, rates)


def residual(records: Sequence[HeatingRecord], unknowns: Unknowns, point: Array, noise: float) -> Array:
    """Return the residuals that least squares minimises [K]: every frame that was seen, then the offsets' priors."""
    parts = [
        _seen(measured(record) - _fitted(record, unknowns, *record_unknowns), record)
        for record, record_unknowns in _each(records, unknowns, point)
    ]
    weight = priors(records, unknowns, noise)
    return np.concatenate([*parts, -(np.sqrt(weight) * point)[weight > 0.0]])


def priors(records: Sequence[HeatingRecord], unknowns: Unknowns, noise: float) -> Array:
    """Return the weight of each unknown's prior, shape (unknowns,): only offsets have one, with mean zero."""
    names = [name for record in records for name in unknowns.of(record)]
    weight = (noise / unknowns.offset_std) ** 2 if unknowns.offset_std else 0.0
    return np.array([0.0] * NETWORK + [weight if name.startswith("offset") else 0.0 for name in names])


def _solved(
    records: Sequence[HeatingRecord], unknowns: Unknowns, begin: Array, noise: float
) -> tuple[Array, float] | None:
    """Return the optimum from a starting point, and its sum of squares; None where the fit fails."""
    from scipy.optimize import least_squares

    weight = priors(records, unknowns, noise)
    prior_rows = np.diag(np.sqrt(weight))[weight > 0.0]

    def slopes(point: Array) -> Array:
        parts = [
            _seen(columns, record) for columns, record in zip(_columns(records, unknowns, point), records, strict=True)
        ]
        return -np.concatenate([*parts, prior_rows])

    def residuals_at(point: Array) -> Array:
        if np.max(np.abs(point[1:NETWORK] - begin[1:NETWORK])) > FARTHEST or point[0] < -begin[0]:
            return np.full(size, 1e3)
        return residual(records, unknowns, point, noise)

    size = len(residual(records, unknowns, begin, noise))
    if size <= len(begin):
        return None
    solution = least_squares(
        residuals_at, begin, slopes, method="lm", x_scale="jac", xtol=EXACT, ftol=EXACT, gtol=EXACT
    )
    return (solution.x, float(2.0 * solution.cost)) if np.isfinite(solution.x).all() else None


def _begun(record: HeatingRecord, unknowns: Unknowns, lag: float) -> list[float]:
    """Return starting values of a record's own unknowns."""
    temperatures = measured(record)
    first = [float(row[np.isfinite(row)][0]) for row in temperatures]
    air = min(first) if record.ambient is None else 0.0
    starts = {"winding_start": first[0] - air, "housing_start": first[1] - air, "air": air, "lag": lag}
    return [starts.get(name, 0.0) for name in unknowns.of(record)]


def _each(
    records: Sequence[HeatingRecord], unknowns: Unknowns, point: Array
) -> list[tuple[HeatingRecord, tuple[Conductances, dict[str, float]]]]:
    """Return each record with the network and its own unknowns by name."""
    network, by_record, first = network_of(point), [], NETWORK
    for record in records:
        names = unknowns.of(record)
        by_record.append((record, (network, dict(zip(names, point[first : first + len(names)].tolist(), strict=True)))))
        first += len(names)
    return by_record


def _fitted(
    record: HeatingRecord, unknowns: Unknowns, network: Conductances, record_unknowns: dict[str, float]
) -> Array:
    """Return the temperatures [degC] that the camera would show, shape (2, frames)."""
    forced, _ = _forced(record, unknowns, network, record_unknowns)
    return forced + _started(record, unknowns, network, record_unknowns) + _offset(record_unknowns)


def _offset(record_unknowns: dict[str, float]) -> Array:
    air = record_unknowns.get("air", 0.0)
    return np.array(
        [[record_unknowns.get("offset_winding", 0.0) + air], [record_unknowns.get("offset_housing", 0.0) + air]]
    )


def _forced(
    record: HeatingRecord, unknowns: Unknowns, network: Conductances, record_unknowns: dict[str, float]
) -> tuple[Array, Array]:
    return driven_at(network, drive_of(record), _stamps(record, unknowns, record_unknowns))


def _started(
    record: HeatingRecord, unknowns: Unknowns, network: Conductances, record_unknowns: dict[str, float]
) -> Array:
    after = _stamps(record, unknowns, record_unknowns) - record.supply.time[0]
    start = np.array([record_unknowns["winding_start"], record_unknowns["housing_start"]])
    return np.asarray(np.einsum("nst,s->nt", remaining_rise(network, after), start), np.float64)


def _stamps(record: HeatingRecord, unknowns: Unknowns, record_unknowns: dict[str, float]) -> Array:
    """Return the camera's frames on the clock of the supply [s]."""
    return np.asarray(record.time - record_unknowns.get("lag", unknowns.lag or 0.0))


def drive_of(record: HeatingRecord) -> Drive:
    """Return heat and ambient temperature that drive the network.

    Readings that are means hold over their interval, others are joined by straight lines. A current that is switched
    between two readings steps halfway; the lag of the clock absorbs the rest.
    """
    supply, heat = record.supply, record.supply.heat
    air = np.zeros(len(heat)) if record.ambient is None else record.ambient
    if supply.means:
        return Drive(supply.time, heat[1:], heat[1:], air)
    switches = np.flatnonzero(np.diff(supply.on))
    time, ambient = (
        np.insert(values, switches + 1, 0.5 * (values[switches] + values[switches + 1]))
        for values in (supply.time, air)
    )
    before, after = np.insert(heat, switches + 1, heat[switches]), np.insert(heat, switches + 1, heat[switches + 1])
    return Drive(time, after[:-1], before[1:], ambient)


def _columns(records: Sequence[HeatingRecord], unknowns: Unknowns, point: Array) -> list[Array]:
    """Return the derivatives of each record's fitted temperatures, shape (2, frames, unknowns)."""
    columns, first, by_record = [], NETWORK, _each(records, unknowns, point)
    steps = np.full(NETWORK, STEP)
    steps[0] *= 1.0 / math.exp(point[2])  # a conductance goes with that past the housing
    for record, (network, record_unknowns) in by_record:
        derivatives = np.zeros((2, len(record.time), len(point)))
        for k, step in enumerate(steps):
            moved = [point + sign * step * np.eye(len(point))[k] for sign in (1.0, -1.0)]
            high, low = (_fitted(record, unknowns, network_of(p), record_unknowns) for p in moved)
            derivatives[:, :, k] = (high - low) / (2.0 * step)
        after = _stamps(record, unknowns, record_unknowns) - record.supply.time[0]
        start, names = remaining_rise(network, after), unknowns.of(record)
        derivative_of = {
            "winding_start": start[:, 0],
            "housing_start": start[:, 1],
            "air": np.ones((2, 1)),
            "offset_winding": np.array([[1.0], [0.0]]),
            "offset_housing": np.array([[0.0], [1.0]]),
        }
        for column, name in enumerate(names, start=first):
            derivatives[:, :, column] = (
                -_rate(record, unknowns, network, record_unknowns) if name == "lag" else derivative_of[name]
            )
        first += len(names)
        columns.append(derivatives)
    return columns


def _rate(record: HeatingRecord, unknowns: Unknowns, network: Conductances, record_unknowns: dict[str, float]) -> Array:
    """Return how fast the fitted temperatures change [K/s], shape (2, frames)."""
    rates, shapes, inverse = network.modes()
    started = _started(record, unknowns, network, record_unknowns)
    return _forced(record, unknowns, network, record_unknowns)[1] + (shapes * rates) @ inverse @ started


def _seen(values: Array, record: HeatingRecord) -> Array:
    """Return the values of the frames that were seen, winding first."""
    seen = np.isfinite(measured(record))
    return np.concatenate([values[node][seen[node]] for node in (0, 1)])


def _noise_of(records: Sequence[HeatingRecord], unknowns: Unknowns, point: Array) -> float:
    residuals = residual(records, unknowns, point, 0.0)
    return math.sqrt(max(float(np.mean(residuals**2)), 1e-18))
