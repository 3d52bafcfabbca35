"""Requirements on every device that measures at its own rate, or whose readings come in files.

A trial states its requirement in its docstring, and raises `Broken` if the device does not meet it.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from leactl.driver.contract import Row, SampleBlock
from leactl.driver.file_records import BatchSource
from leactl.emulation.trial.drives import call_safe_state
from leactl.emulation.trial.known_bench import RISE
from leactl.emulation.trial.stand import Broken, Stand
from leactl.errors import DeviceError
from leactl.quantities import FLAGS

MOST_DELAY_S = 0.1  # from the stamp of a row to the time at which it is read
STAMP_ROUNDING_S = 1e-9  # by which a stamp may lie after the time at which its row is read
VALUE_TOLERANCE = 0.01  # largest error of a reading, as a share of the largest true value
# largest error in addition to VALUE_TOLERANCE, in the channel's unit: for rounding where every true value is 0, as of a
# flag that is off; 0.2 % of the smallest value of `BASES`
ABSOLUTE_TOLERANCE = 1e-3
LEAST_MEASURED_S = 5.0  # for a rise by RISE, so that a quantity changes by less than VALUE_TOLERANCE in MOST_DELAY_S
FEWEST_SAMPLES = 10  # of the slowest channel
LONGEST_INTERVAL_S = 60.0  # between two samples of the slowest channel
FEWEST_POLLS = 500  # calls of `take` in a measurement, unless they would be less than LEAST_POLL_S apart
LEAST_POLL_S = 0.002  # shortest time between two calls of `take`
MOST_STEP_SHARE = 0.25  # largest step between two values of a display, as a share of the quantity's rise
MULTIPLE_TOLERANCE = 0.01  # largest difference of a value from a multiple of the step, as a share of the step
RECORDED_S = 20.0  # duration for which the machine is recorded into files
MACHINE_STEP_S = 0.01  # time between two values of the machine while it is recorded
FEWEST_ROWS = 4  # of a record
SLOPE_TOLERANCE = 0.05  # largest error of a record's slope, as a share of the true one
UNPLUGGED_S = 1.0  # duration for which an unplugged device is polled
LOST_AFTER_S = 0.5  # time after which an unplugged device gives no reading
MACHINE_QUANTITIES = ("q_axis_current", "velocity", "angle", "bus_voltage")  # channels of a drive's own recorder
SamplesByChannel = dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]  # by channel, times and values


def take_samples(
    stand: Stand, seconds: float, poll_s: float = LEAST_POLL_S
) -> tuple[SamplesByChannel, list[tuple[float, float]]]:
    """Poll a device for a time [s].

    Returns
    -------
    samples : times [s] and values of each channel.
    row_times : of each row, its stamp and the time at which it was read [s].
    """
    gathered: dict[str, tuple[list[float], list[float]]] = {}
    row_times: list[tuple[float, float]] = []
    names = {spec.name: [channel.name for channel in spec.channels] for spec in stand.driver.streams}
    end = stand.clock.now() + seconds
    while stand.clock.now() < end:
        for item in stand.driver.take():
            rows: Sequence[Row] = list(item.rows()) if isinstance(item, SampleBlock) else [item]
            for row in rows:
                row_times.append((row.time, stand.clock.now()))
                for name, value in zip(names[row.stream], row.values, strict=True):
                    times, values = gathered.setdefault(name, ([], []))
                    times.append(row.time)
                    values.append(float(value))
        stand.wait(poll_s)
    return {name: (np.asarray(times), np.asarray(values)) for name, (times, values) in gathered.items()}, row_times


def longest_interval(stand: Stand) -> float:
    """Return the time [s] between two samples of the slowest channel, from the first two stamps of each channel.

    Raises
    ------
    Broken : a channel has fewer than two samples in twice `LONGEST_INTERVAL_S`.
    """
    names = [channel.name for spec in stand.driver.streams for channel in spec.channels]
    stamps: dict[str, list[float]] = {name: [] for name in names}
    end, seconds = stand.clock.now() + 2.0 * LONGEST_INTERVAL_S, 2.0 * LEAST_POLL_S
    while stand.clock.now() < end:
        for name, (times, _) in take_samples(stand, seconds)[0].items():
            stamps[name] += times.tolist()
        if all(len(times) > 1 for times in stamps.values()):
            return max(times[1] - times[0] for times in stamps.values())
        seconds = min(2.0 * seconds, 1.0)
    slowest, count = min(((name, len(times)) for name, times in stamps.items()), key=lambda item: item[1])
    raise Broken(f"{slowest}: {count} samples in {2.0 * LONGEST_INTERVAL_S:g} s")


def measures_true_values(stand: Stand) -> None:
    """Every channel measures the quantity of its name, in its unit, at the time of its stamp, each sample once."""
    stand.driver.open()
    interval = longest_interval(stand)
    seconds = max(LEAST_MEASURED_S, FEWEST_SAMPLES * interval)
    stand.bench.rise(seconds, interval)
    began, poll_s = stand.clock.now(), max(LEAST_POLL_S, min(seconds / FEWEST_POLLS, 0.5 * MOST_DELAY_S))
    samples, row_times = take_samples(stand, seconds, poll_s)
    reading_delays = [read_at - stamp for stamp, read_at in row_times] or [0.0]
    shortest, longest = min(reading_delays), max(reading_delays)
    if shortest < -STAMP_ROUNDING_S or longest > MOST_DELAY_S + seconds / max(len(row_times), 1):
        raise Broken(f"stamps lie {shortest:.3g} to {longest:.3g} s before the moment at which a sample is taken")
    channels = {channel.name: channel for spec in stand.driver.streams for channel in spec.channels}
    for name, channel in channels.items():
        times, values = samples.get(name, (np.empty(0), np.empty(0)))
        if np.any(np.diff(times) <= 0.0):
            raise Broken(f"{name}: stamps do not increase: a sample comes twice, or out of order")
        times, values = times[times >= began], values[times >= began]
        if len(times) < 2:
            raise Broken(f"{name}: {len(times)} samples in {seconds:g} s, although two came {interval:g} s apart")
        if channel.quantity in FLAGS:
            constant = constant_flag_mask(stand, channel.quantity, times)
            times, values = times[constant], values[constant]
            if not len(times):
                raise Broken(f"{name}: all samples come less than {MOST_DELAY_S:g} s before the flag switches")
        expect_true_values(name, values, np.asarray(stand.bench.true_value(channel.quantity, times), np.float64))


def constant_flag_mask(stand: Stand, quantity: str, times: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask of the times [s] after which a flag is constant for `MOST_DELAY_S`, shape (samples,).

    An instrument may read the flag that much later.
    """
    before, after = (stand.bench.true_value(quantity, times + delay) for delay in (0.0, MOST_DELAY_S))
    return np.asarray(before == after, np.bool_)


def expect_true_values(name: str, values: NDArray[np.float64], true_values: NDArray[np.float64]) -> None:
    """Raise Broken if the measured values differ from the true ones."""
    if missing := int(np.isnan(values).sum()):
        raise Broken(f"{name}: {missing} of {len(values)} samples are NaN although the device works")
    largest = float(np.max(np.abs(true_values)))
    tolerance = VALUE_TOLERANCE * largest + ABSOLUTE_TOLERANCE + display_step(values, true_values)
    difference = np.abs(values - true_values)
    if float(np.max(difference)) > tolerance:
        worst = int(np.argmax(difference))
        reading, expected = values[worst], true_values[worst]
        ratio = float(np.sum(values * true_values) / max(float(np.sum(true_values * true_values)), 1e-12))
        raise Broken(f"{name} reads {reading:.6g} where {expected:.6g} is true; {ratio:.4g} times the true values")


def display_step(values: NDArray[np.float64], true_values: NDArray[np.float64]) -> float:
    """Return the step of which all values of a display are multiples.

    Return 0 if there is none, or if it exceeds `MOST_STEP_SHARE` of the rise.
    """
    steps = np.diff(np.unique(values))
    step = float(np.min(steps)) if len(steps) else 0.0
    if not 0.0 < step <= MOST_STEP_SHARE * float(np.ptp(true_values)):
        return 0.0
    counts = values / step
    return step if float(np.max(np.abs(counts - np.round(counts)))) < MULTIPLE_TOLERANCE else 0.0


def reports_disconnection(stand: Stand) -> None:
    """The driver of an unplugged device reports it, or gives no more readings."""
    stand.driver.open()
    take_samples(stand, 0.2)
    stand.cut()
    try:
        samples, _ = take_samples(stand, UNPLUGGED_S)
    except DeviceError:
        return
    late_readings = sum(
        int(np.sum(np.isfinite(values[times > stand.clock.now() - LOST_AFTER_S]))) for times, values in samples.values()
    )
    if late_readings:
        raise Broken(f"{late_readings} readings of the last half second have come although the device is unplugged")


def confirms_safe_state(stand: Stand) -> None:
    """`safe_state` of a device that only measures is confirmed, before `open` and in operation, and does not raise."""
    for when in ("before open()", "in operation"):
        if not call_safe_state(stand):
            raise Broken(f"safe_state {when} is not confirmed although the device only measures")
        if when == "before open()":
            stand.driver.open()


def can_be_closed_and_reopened(stand: Stand) -> None:
    """The driver may be closed before it is opened, closed twice, and opened again."""
    stand.driver.close()
    stand.driver.open()
    stand.driver.close()
    stand.driver.close()
    stand.driver.open()


def reads_exported_files(stand: Stand) -> None:
    """The driver reads a file that the device's program wrote, with the true quantities and their true rise in time."""
    source, bench, machine = stand.driver, stand.bench, stand.machine
    assert isinstance(source, BatchSource)
    stand.driver.open()
    bench.rise(RECORDED_S)
    end = stand.clock.now() + RECORDED_S
    while (now := stand.clock.now()) < end:
        machine.current, machine.velocity, machine.angle, machine.bus_voltage = (
            float(bench.true_value(quantity, now)) for quantity in MACHINE_QUANTITIES
        )
        stand.wait(MACHINE_STEP_S)
    files = source.exports.fresh()
    if not files:
        raise Broken(f"the emulated instrument has written no file within {RECORDED_S:g} s")
    record = source.read_files(files)
    if len(record.time) < FEWEST_ROWS:
        raise Broken(f"{len(record.time)} rows are read of {RECORDED_S:g} s; {FEWEST_ROWS} were expected at least")
    if np.any(np.diff(record.time) <= 0.0):
        raise Broken("stamps of a record do not increase")
    for column, channel in enumerate(record.channels):
        low, high = (float(bench.true_value(channel.quantity, time)) for time in (0.0, end))
        expect_true_rise(channel.name, record.time, record.values[:, column], low, high)


def expect_true_rise(
    name: str, time: NDArray[np.float64], values: NDArray[np.float64], low: float, high: float
) -> None:
    """Raise Broken if a recorded channel differs from a linear rise; a record may begin before the rise."""
    lowest, highest = (1.0 - VALUE_TOLERANCE) * low, (1.0 + VALUE_TOLERANCE) * high
    if np.isnan(values).any() or values.min() < lowest or values.max() > highest:
        raise Broken(f"{name} reads {values.min():.5g} to {values.max():.5g}; {low:.5g} to {high:.5g} is true")
    second_half = slice(len(time) // 2, None)
    slope = float(np.polyfit(time[second_half] - time[-1], values[second_half], 1)[0])
    true_slope = RISE * low / RECORDED_S
    if abs(slope - true_slope) > SLOPE_TOLERANCE * true_slope:
        raise Broken(
            f"{name} rises by {slope:.4g} in a second of its record where {true_slope:.4g} is true: its unit of time?"
        )


STREAM_TRIALS = (measures_true_values, confirms_safe_state, can_be_closed_and_reopened)
CABLE_TRIALS = (reports_disconnection,)  # only of a device on a bus: the stand can unplug no other
RECORD_TRIALS = (reads_exported_files, confirms_safe_state, can_be_closed_and_reopened)
