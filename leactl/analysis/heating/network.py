"""Fit of the two-node thermal network to heated records, by least squares over every frame of the camera.

Each residual takes the exact solution of the network. Its unknowns are the winding's conductance to the air, which may
be zero, and the logarithms of the other two resistances and of both capacitances. Each record adds unknowns: the
starting temperatures, the camera's offsets at winding and housing from the ambient sensor (without a sensor, the air's
temperature), the lag of the camera's clock, and, where the supply's readings may change from run to run, the change of
the heat from that of the first run.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leactl.analysis.heating.first_guess import frames_with_known_heat, starting_lag, starting_points, thin_record
from leactl.analysis.heating.record import Array, HeatingRecord
from leactl.errors import NotIdentifiable
from leactl.model.thermal_network import Conductances, Drive, remaining_rise, temperatures_and_rates_at

NETWORK_UNKNOWNS = 5  # unknowns that all records share
DIFFERENCE_STEP = 1e-4  # of a logarithm; the relative error of central differences is about its square
FIT_TOLERANCE = 1e-12  # relative, of the least-squares solver
LARGEST_LOG_SHIFT = 12.0  # change of a logarithm from its starting value: a factor of 160 000


@dataclass(frozen=True)
class Unknowns:
    """Settings that decide which unknowns each record adds to the network's five."""

    offset_std: float  # K, prior of the camera's offset from the ambient sensor; zero: no offset is fitted
    lag: float | None  # s, the known lag of the camera's clock; None: the lag of each record is fitted
    heat_change_std: float = 0.0  # relative, prior of the heat's change from the first run; zero: none is fitted
    first_run: str = ""  # path

    def names_of(self, record: HeatingRecord) -> tuple[str, ...]:
        """Return the names of the unknowns of one record."""
        offset_names = (
            ("air",) if record.ambient is None else ("offset_winding", "offset_housing") if self.offset_std else ()
        )
        lag_names = ("lag",) if self.lag is None else ()
        changes = self.heat_change_std > 0.0 and record.run_path != self.first_run
        return ("winding_start", "housing_start", *offset_names, *lag_names, *(("heat_change",) if changes else ()))

    def prior_std_of(self, name: str) -> float:
        """Return the standard deviation of an unknown's prior, whose mean is zero; zero without a prior."""
        return self.offset_std if name.startswith("offset") else self.heat_change_std if name == "heat_change" else 0.0


@dataclass(frozen=True, eq=False)
class NetworkFit:
    """Least-squares fit of the network, with the derivatives that its uncertainty follows from."""

    point: Array  # all unknowns
    names: tuple[tuple[str, ...], ...]  # of the unknowns that each record adds after the network's five
    records: tuple[HeatingRecord, ...]
    fitted_temperatures: tuple[Array, ...]  # degC, winding and housing of each record, shape (2, frames)
    derivatives: tuple[Array, ...]  # of the fitted temperatures by the unknowns, shape (2, frames, unknowns)
    prior_weights: Array  # variance of the residuals over that of each unknown's prior; zero without a prior
    prior_stds: Array  # of each unknown's prior; zero without a prior
    lags: tuple[float, ...]  # s, of the camera's clock in each record
    rates: tuple[Array, ...]  # K/s, how fast the fitted temperatures change, shape (2, frames)

    @property
    def network(self) -> Conductances:
        """Return the fitted network."""
        return network_of(self.point)

    @property
    def residuals(self) -> list[Array]:
        """Return measured minus fitted temperatures [K] of each record, shape (2, frames); NaN for missing frames."""
        return [
            camera_temperatures(record) - fit
            for record, fit in zip(self.records, self.fitted_temperatures, strict=True)
        ]

    @property
    def heat_changes(self) -> dict[str, float]:
        """Return the largest relative change of the heat from that of the first run, by path of a run that has one."""
        changes: dict[str, float] = {}
        for number, record in enumerate(self.records):
            index = self.index_of(number, "heat_change")
            if index is not None:
                changes[record.run_path] = max(changes.get(record.run_path, 0.0), float(self.point[index]), key=abs)
        return changes

    def index_of(self, record_number: int, name: str) -> int | None:
        """Return the index in `point` of an unknown of a record; None if the record has no unknown of this name."""
        first_index = NETWORK_UNKNOWNS + sum(len(record_names) for record_names in self.names[:record_number])
        record_names = self.names[record_number]
        return first_index + record_names.index(name) if name in record_names else None


def network_of(point: Array) -> Conductances:
    """Return the network that the first five unknowns describe: a conductance [W/K], then four logarithms."""
    wh, ha, cw, ch = np.exp(point[1:NETWORK_UNKNOWNS])
    return Conductances(float(point[0]), 1.0 / float(wh), 1.0 / float(ha), float(cw), float(ch))


def camera_temperatures(record: HeatingRecord) -> Array:
    """Return the camera's temperatures of winding and housing [degC], shape (2, frames)."""
    return np.stack([record.winding, record.housing])


def fit_network(records: Sequence[HeatingRecord], unknowns: Unknowns, error_prefix: str) -> NetworkFit:
    """Fit the network to the temperatures of winding and housing by least squares; every frame has the same weight.

    Raises
    ------
    NotIdentifiable : too few frames, or no fit of a network of two bodies succeeds; `error_prefix` opens the message of
        the latter.
    """
    lags = [starting_lag(record) if "lag" in unknowns.names_of(record) else unknowns.lag or 0.0 for record in records]
    covered_records = [frames_with_known_heat(record, lag) for record, lag in zip(records, lags, strict=True)]
    thin_records = [thin_record(record) for record in covered_records]
    starts = [
        value for record, lag in zip(thin_records, lags, strict=True) for value in _start_values(record, unknowns, lag)
    ]
    optima = [
        _optimum(thin_records, unknowns, np.array([*guess, *starts]), 1.0) for guess in starting_points(thin_records)
    ]
    best = min((optimum for optimum in optima if optimum is not None), key=lambda optimum: optimum[1], default=None)
    noise = _residual_rms(covered_records, unknowns, best[0]) if best is not None else math.nan
    optimum = _optimum(covered_records, unknowns, best[0], noise) if best is not None else None
    if optimum is None:
        raise NotIdentifiable(f"{error_prefix}: no network of winding and housing follows these temperatures")
    point, _ = optimum
    fitted_temperatures = tuple(
        _fitted_temperatures(record, unknowns, *values)
        for record, values in _values_by_record(covered_records, unknowns, point)
    )
    derivatives = tuple(_derivatives_by_record(covered_records, unknowns, point))
    names = tuple(unknowns.names_of(record) for record in covered_records)
    values_by_record = _values_by_record(covered_records, unknowns, point)
    fitted_lags = tuple(record_unknowns.get("lag", unknowns.lag or 0.0) for _, (_, record_unknowns) in values_by_record)
    rates = tuple(_rate(record, unknowns, *values) for record, values in values_by_record)
    weights = prior_weights(covered_records, unknowns, noise)
    return NetworkFit(
        point,
        names,
        tuple(covered_records),
        fitted_temperatures,
        derivatives,
        weights,
        prior_stds(covered_records, unknowns),
        fitted_lags,
        rates,
    )


def residual_vector(records: Sequence[HeatingRecord], unknowns: Unknowns, point: Array, noise: float) -> Array:
    """Return the residuals that least squares minimises [K]: those of valid frames, then those of priors."""
    frame_residuals = [
        _of_valid_frames(camera_temperatures(record) - _fitted_temperatures(record, unknowns, *values), record)
        for record, values in _values_by_record(records, unknowns, point)
    ]
    weights = prior_weights(records, unknowns, noise)
    return np.concatenate([*frame_residuals, -(np.sqrt(weights) * point)[weights > 0.0]])


def prior_weights(records: Sequence[HeatingRecord], unknowns: Unknowns, noise: float) -> Array:
    """Return the weight of each unknown's prior, shape (unknowns,).

    `noise` is the root mean square of the residuals [K].
    """
    stds = prior_stds(records, unknowns)
    return np.divide(noise, stds, out=np.zeros_like(stds), where=stds > 0.0) ** 2


def prior_stds(records: Sequence[HeatingRecord], unknowns: Unknowns) -> Array:
    """Return the standard deviation of each unknown's prior, shape (unknowns,); zero without a prior."""
    names = [name for record in records for name in unknowns.names_of(record)]
    return np.array([0.0] * NETWORK_UNKNOWNS + [unknowns.prior_std_of(name) for name in names])


def _optimum(
    records: Sequence[HeatingRecord], unknowns: Unknowns, start: Array, noise: float
) -> tuple[Array, float] | None:
    """Return the optimum that least squares reaches from a starting point, and its sum of squares.

    Return None if there are no more residuals than unknowns, or the optimum is not finite.
    """
    from scipy.optimize import least_squares

    weights = prior_weights(records, unknowns, noise)
    prior_rows = np.diag(np.sqrt(weights))[weights > 0.0]

    def jacobian_at(point: Array) -> Array:
        frame_derivatives = [
            _of_valid_frames(record_derivatives, record)
            for record_derivatives, record in zip(
                _derivatives_by_record(records, unknowns, point), records, strict=True
            )
        ]
        return -np.concatenate([*frame_derivatives, prior_rows])

    def residuals_at(point: Array) -> Array:
        if (
            np.max(np.abs(point[1:NETWORK_UNKNOWNS] - start[1:NETWORK_UNKNOWNS])) > LARGEST_LOG_SHIFT
            or point[0] < -start[0]
        ):
            return np.full(residual_count, 1e3)  # K, so large that the solver turns back
        return residual_vector(records, unknowns, point, noise)

    residual_count = len(residual_vector(records, unknowns, start, noise))
    if residual_count <= len(start):
        return None
    solution = least_squares(
        residuals_at,
        start,
        jacobian_at,
        method="lm",
        x_scale="jac",
        xtol=FIT_TOLERANCE,
        ftol=FIT_TOLERANCE,
        gtol=FIT_TOLERANCE,
    )
    return (solution.x, float(2.0 * solution.cost)) if np.isfinite(solution.x).all() else None


def _start_values(record: HeatingRecord, unknowns: Unknowns, lag: float) -> list[float]:
    """Return starting values of the unknowns that a record adds."""
    temperatures = camera_temperatures(record)
    winding, housing = (float(row[np.isfinite(row)][0]) for row in temperatures)
    air = min(winding, housing) if record.ambient is None else 0.0
    starts = {"winding_start": winding - air, "housing_start": housing - air, "air": air, "lag": lag}
    return [starts.get(name, 0.0) for name in unknowns.names_of(record)]


def _values_by_record(
    records: Sequence[HeatingRecord], unknowns: Unknowns, point: Array
) -> list[tuple[HeatingRecord, tuple[Conductances, dict[str, float]]]]:
    """Return each record with the network and with the values of the unknowns that the record adds, by name."""
    network, values_by_record, first_index = network_of(point), [], NETWORK_UNKNOWNS
    for record in records:
        names = unknowns.names_of(record)
        record_unknowns = dict(zip(names, point[first_index : first_index + len(names)].tolist(), strict=True))
        values_by_record.append((record, (network, record_unknowns)))
        first_index += len(names)
    return values_by_record


def _fitted_temperatures(
    record: HeatingRecord, unknowns: Unknowns, network: Conductances, record_unknowns: dict[str, float]
) -> Array:
    """Return the temperatures [degC] that the camera would show, shape (2, frames)."""
    forced, _ = _forced_response(record, unknowns, network, record_unknowns)
    return forced + _decay_of_start(record, unknowns, network, record_unknowns) + _camera_offset(record_unknowns)


def _camera_offset(record_unknowns: dict[str, float]) -> Array:
    """Return the offsets of winding and housing [K], plus a fitted temperature of the air [degC], shape (2, 1)."""
    air = record_unknowns.get("air", 0.0)
    return np.array(
        [[record_unknowns.get("offset_winding", 0.0) + air], [record_unknowns.get("offset_housing", 0.0) + air]]
    )


def _forced_response(
    record: HeatingRecord, unknowns: Unknowns, network: Conductances, record_unknowns: dict[str, float]
) -> tuple[Array, Array]:
    """Return the temperatures [degC] that heat and ambient cause at the frames, and their rates [K/s].

    Both have shape (2, frames).
    """
    drive, heat_ratio = drive_of(record), 1.0 + record_unknowns.get("heat_change", 0.0)
    drive = replace(drive, begin=heat_ratio * drive.begin, end=heat_ratio * drive.end)
    return temperatures_and_rates_at(network, drive, _stamps(record, unknowns, record_unknowns))


def _response_to_heat(
    record: HeatingRecord, unknowns: Unknowns, network: Conductances, record_unknowns: dict[str, float]
) -> Array:
    """Return the rises [K] that the heat as it was read causes at the frames, shape (2, frames)."""
    drive = drive_of(record)
    drive = replace(drive, ambient=np.zeros(len(drive.ambient)))
    return temperatures_and_rates_at(network, drive, _stamps(record, unknowns, record_unknowns))[0]


def _decay_of_start(
    record: HeatingRecord, unknowns: Unknowns, network: Conductances, record_unknowns: dict[str, float]
) -> Array:
    """Return what remains of the starting rises at the frames [K], shape (2, frames)."""
    elapsed = _stamps(record, unknowns, record_unknowns) - record.supply.time[0]
    start = np.array([record_unknowns["winding_start"], record_unknowns["housing_start"]])
    return np.asarray(np.einsum("nst,s->nt", remaining_rise(network, elapsed), start), np.float64)


def _stamps(record: HeatingRecord, unknowns: Unknowns, record_unknowns: dict[str, float]) -> Array:
    """Return the times of the camera's frames on the clock of the supply [s]."""
    return np.asarray(record.time - record_unknowns.get("lag", unknowns.lag or 0.0))


def drive_of(record: HeatingRecord) -> Drive:
    """Return heat and ambient temperature that drive the network.

    A reading that is a mean holds over its interval; other readings are joined by straight lines. A current that is
    switched between two readings steps halfway; the lag of the clock absorbs the remaining error.
    """
    supply, heat = record.supply, record.supply.heat
    ambient_readings = np.zeros(len(heat)) if record.ambient is None else record.ambient
    if supply.means:
        return Drive(supply.time, heat[1:], heat[1:], ambient_readings)
    switches = np.flatnonzero(np.diff(supply.on))
    time, ambient = (
        np.insert(values, switches + 1, 0.5 * (values[switches] + values[switches + 1]))
        for values in (supply.time, ambient_readings)
    )
    ending_heat, starting_heat = (
        np.insert(heat, switches + 1, heat[switches]),
        np.insert(heat, switches + 1, heat[switches + 1]),
    )
    return Drive(time, starting_heat[:-1], ending_heat[1:], ambient)


def _derivatives_by_record(records: Sequence[HeatingRecord], unknowns: Unknowns, point: Array) -> list[Array]:
    """Return the derivatives of each record's fitted temperatures by the unknowns, shape (2, frames, unknowns)."""
    derivatives_by_record, first_column, values_by_record = (
        [],
        NETWORK_UNKNOWNS,
        _values_by_record(records, unknowns, point),
    )
    steps = np.full(NETWORK_UNKNOWNS, DIFFERENCE_STEP)
    steps[0] *= 1.0 / math.exp(point[2])  # the step of a conductance is relative to that from housing to air
    for record, (network, record_unknowns) in values_by_record:
        derivatives = np.zeros((2, len(record.time), len(point)))
        for index, step in enumerate(steps):
            shifted_points = [point + sign * step * np.eye(len(point))[index] for sign in (1.0, -1.0)]
            high, low = (
                _fitted_temperatures(record, unknowns, network_of(shifted), record_unknowns)
                for shifted in shifted_points
            )
            derivatives[:, :, index] = (high - low) / (2.0 * step)
        elapsed = _stamps(record, unknowns, record_unknowns) - record.supply.time[0]
        remaining_shares, names = remaining_rise(network, elapsed), unknowns.names_of(record)
        derivative_of = {
            "winding_start": remaining_shares[:, 0],
            "housing_start": remaining_shares[:, 1],
            "air": np.ones((2, 1)),
            "offset_winding": np.array([[1.0], [0.0]]),
            "offset_housing": np.array([[0.0], [1.0]]),
        }
        if "lag" in names:
            derivative_of["lag"] = -_rate(record, unknowns, network, record_unknowns)
        if "heat_change" in names:
            derivative_of["heat_change"] = _response_to_heat(record, unknowns, network, record_unknowns)
        for column, name in enumerate(names, start=first_column):
            derivatives[:, :, column] = derivative_of[name]
        first_column += len(names)
        derivatives_by_record.append(derivatives)
    return derivatives_by_record


def _rate(record: HeatingRecord, unknowns: Unknowns, network: Conductances, record_unknowns: dict[str, float]) -> Array:
    """Return how fast the fitted temperatures change [K/s], shape (2, frames)."""
    rates, shapes, inverse = network.modes()
    decay = _decay_of_start(record, unknowns, network, record_unknowns)
    return _forced_response(record, unknowns, network, record_unknowns)[1] + (shapes * rates) @ inverse @ decay


def _of_valid_frames(values: Array, record: HeatingRecord) -> Array:
    """Return the values at the frames that have a temperature, those of the winding first."""
    valid = np.isfinite(camera_temperatures(record))
    return np.concatenate([values[node][valid[node]] for node in (0, 1)])


def _residual_rms(records: Sequence[HeatingRecord], unknowns: Unknowns, point: Array) -> float:
    """Return the root mean square of the residuals [K], without priors."""
    residuals = residual_vector(records, unknowns, point, 0.0)
    return math.sqrt(max(float(np.mean(residuals**2)), 1e-18))  # above zero: else the priors would have no weight
