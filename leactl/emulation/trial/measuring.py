"""Requirements on every device that measures at its own rate, or whose readings come in files."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from leactl.driver.contract import Row, SampleBlock
from leactl.driver.file_records import BatchSource
from leactl.emulation.trial.drives import confirmed
from leactl.emulation.trial.known_bench import RISE
from leactl.emulation.trial.stand import Broken, Stand
from leactl.errors import DeviceError
from leactl.quantities import FLAGS

MEASURED_S = 5.0  # at least, in which a quantity rises by `RISE`, and within `LATE_S` by at most `NEAR` of a value
RECORDED_S = 20.0
SAMPLES = 10  # that are to be measured at least
SLOWEST_S = 60.0  # between two samples of the slowest channel
LOOKS, LOOKS_S = 500, 0.002  # readings of a device while it measures, and the shortest time between two of them
STEP_S = 0.01  # between two values of a machine while it is recorded
FEWEST_ROWS, NEAR_SLOPE = 4, 0.05  # of a record, and how near its rise in a second has to be to the true one
UNLIKE_MULTIPLE = 0.01  # largest difference of a value from a multiple of the step, as a share of the step
COARSEST = 0.25  # of a quantity's rise: the largest step between two values that an instrument may show
NEAR = 0.01  # of the range of what was measured, and of a value
LATE_S = 0.1  # by which a stamp may be earlier than the reading of its row
OF_MACHINE = ("q_axis_current", "velocity", "angle", "bus_voltage")  # what a drive's own recorder may have
Samples = dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]  # by channel, times and values


def take_samples(stand: Stand, seconds: float, looks_s: float = LOOKS_S) -> tuple[Samples, list[tuple[float, float]]]:
    """Read a device while time passes.

    Returns the samples of each channel, and for each row its stamp and the time at which it was read.
    """
    gathered: dict[str, tuple[list[float], list[float]]] = {}
    moments: list[tuple[float, float]] = []
    names = {spec.name: [channel.name for channel in spec.channels] for spec in stand.driver.streams}
    end = stand.clock.now() + seconds
    while stand.clock.now() < end:
        for item in stand.driver.take():
            rows: Sequence[Row] = list(item.rows()) if isinstance(item, SampleBlock) else [item]
            for row in rows:
                moments.append((row.time, stand.clock.now()))
                for name, value in zip(names[row.stream], row.values, strict=True):
                    times, values = gathered.setdefault(name, ([], []))
                    times.append(row.time)
                    values.append(float(value))
        stand.wait(looks_s)
    return {name: (np.asarray(times), np.asarray(values)) for name, (times, values) in gathered.items()}, moments


def interval_of(stand: Stand) -> float:
    """Time [s] between two samples of the slowest channel, from the first two stamps of each."""
    names = [channel.name for spec in stand.driver.streams for channel in spec.channels]
    stamps: dict[str, list[float]] = {name: [] for name in names}
    end, seconds = stand.clock.now() + 2.0 * SLOWEST_S, 2.0 * LOOKS_S
    while stand.clock.now() < end:
        for name, (times, _) in take_samples(stand, seconds)[0].items():
            stamps[name] += times.tolist()
        if all(len(times) > 1 for times in stamps.values()):
            return max(times[1] - times[0] for times in stamps.values())
        seconds = min(2.0 * seconds, 1.0)
    slowest, count = min(((name, len(times)) for name, times in stamps.items()), key=lambda item: item[1])
    raise Broken(f"{slowest}: {count} samples in {2.0 * SLOWEST_S:g} s")


def measures_what_is_there(stand: Stand) -> None:
    """Every channel measures the quantity of its name, in its unit, at the time of its stamp, each sample once."""
    stand.driver.open()
    interval = interval_of(stand)
    seconds = max(MEASURED_S, SAMPLES * interval)
    stand.bench.rise(seconds, interval)
    began, looks_s = stand.clock.now(), max(LOOKS_S, min(seconds / LOOKS, 0.5 * LATE_S))
    samples, moments = take_samples(stand, seconds, looks_s)
    early = [read_at - stamp for stamp, read_at in moments] or [0.0]
    if min(early) < -1e-9 or max(early) > LATE_S + seconds / max(len(moments), 1):
        raise Broken(f"stamps lie {min(early):.3g} to {max(early):.3g} s before the moment at which a sample is taken")
    channels = {channel.name: channel for spec in stand.driver.streams for channel in spec.channels}
    for name, channel in channels.items():
        times, values = samples.get(name, (np.empty(0), np.empty(0)))
        if np.any(np.diff(times) <= 0.0):
            raise Broken(f"{name}: stamps do not increase: a sample comes twice, or out of order")
        times, values = times[times >= began], values[times >= began]
        if len(times) < 2:
            raise Broken(f"{name}: {len(times)} samples in {seconds:g} s, although two came {interval:g} s apart")
        if channel.quantity in FLAGS:
            settled = has_not_switched(stand, channel.quantity, times)
            times, values = times[settled], values[settled]
        compare(name, values, np.asarray(stand.bench.true_value(channel.quantity, times), np.float64))


def has_not_switched(stand: Stand, quantity: str, times: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether a flag is constant for `LATE_S` after each time, as an instrument may read it a little later."""
    before, after = (stand.bench.true_value(quantity, times + late) for late in (0.0, LATE_S))
    return np.asarray(before == after, np.bool_)


def compare(name: str, values: NDArray[np.float64], true: NDArray[np.float64]) -> None:
    """Raise Broken if the measured values differ from the true ones."""
    if np.isnan(values).any():
        raise Broken(f"{name}: {int(np.isnan(values).sum())} of {len(values)} samples are NaN although all is well")
    allowed = NEAR * float(np.max(np.abs(true))) + 1e-3 + shown_step(values, true)
    difference = np.abs(values - true)
    if float(np.max(difference)) > allowed:
        worst = int(np.argmax(difference))
        ratio = float(np.sum(values * true) / max(float(np.sum(true * true)), 1e-12))
        raise Broken(
            f"{name} reads {values[worst]:.6g} where {true[worst]:.6g} is true; all together {ratio:.4g} times"
        )


def shown_step(values: NDArray[np.float64], true: NDArray[np.float64]) -> float:
    """Step of which all values of a display are multiples; 0 if there is none, or if it hides the rise."""
    steps = np.diff(np.unique(values))
    step = float(np.min(steps)) if len(steps) else 0.0
    if not 0.0 < step <= COARSEST * float(np.ptp(true)):
        return 0.0
    counts = values / step
    return step if float(np.max(np.abs(counts - np.round(counts)))) < UNLIKE_MULTIPLE else 0.0


def tells_silence(stand: Stand) -> None:
    """The driver of an unplugged device reports it, or gives no more readings."""
    stand.driver.open()
    take_samples(stand, 0.2)
    stand.cut()
    if stand.driver.transport == "none":
        return
    try:
        samples, _ = take_samples(stand, 1.0)
    except DeviceError:
        return
    late_readings = sum(
        int(np.sum(np.isfinite(values[times > stand.clock.now() - 0.5]))) for times, values in samples.values()
    )
    if late_readings:
        raise Broken(f"{late_readings} readings of the last half second have come although the device is unplugged")


def is_harmless(stand: Stand) -> None:
    """`safe_state` of a device that only measures is confirmed, before `open` and in operation, and does not raise."""
    for when in ("before open()", "in operation"):
        if not confirmed(stand):
            raise Broken(f"safe_state {when} is not confirmed although the device only measures")
        if when == "before open()":
            stand.driver.open()


def comes_and_goes(stand: Stand) -> None:
    """The driver may be closed before it is opened, closed twice, and opened again."""
    stand.driver.close()
    stand.driver.open()
    stand.driver.close()
    stand.driver.close()
    stand.driver.open()


def reads_its_own_files(stand: Stand) -> None:
    """The driver reads a file that the device's program wrote, with the true quantities and their true rise in time."""
    source, bench, machine = stand.driver, stand.bench, stand.machine
    assert isinstance(source, BatchSource)
    stand.driver.open()
    bench.rise(RECORDED_S)
    end = stand.clock.now() + RECORDED_S
    while (now := stand.clock.now()) < end:
        machine.current, machine.velocity, machine.angle, machine.bus_voltage = (
            float(bench.true_value(quantity, now)) for quantity in OF_MACHINE
        )
        stand.wait(STEP_S)
    files = source.exports.fresh()
    if not files:
        raise Broken(f"its far end has left no file after {RECORDED_S:g} s")
    record = source.read_files(files)
    if len(record.time) < FEWEST_ROWS:
        raise Broken(f"{len(record.time)} rows are read of {RECORDED_S:g} s; {FEWEST_ROWS} were expected at least")
    if np.any(np.diff(record.time) <= 0.0):
        raise Broken("stamps of a record do not increase")
    for column, channel in enumerate(record.channels):
        low, high = (float(bench.true_value(channel.quantity, time)) for time in (0.0, end))
        compare_record(channel.name, record.time, record.values[:, column], low, high)


def compare_record(name: str, time: NDArray[np.float64], values: NDArray[np.float64], low: float, high: float) -> None:
    """Raise Broken if a recorded channel differs from a linear rise; a record may begin before the rise."""
    if np.isnan(values).any() or values.min() < low - NEAR * low or values.max() > high + NEAR * high:
        raise Broken(f"{name} reads {values.min():.5g} to {values.max():.5g}; {low:.5g} to {high:.5g} is true")
    second_half = slice(len(time) // 2, None)
    slope, true = float(np.polyfit(time[second_half] - time[-1], values[second_half], 1)[0]), RISE * low / RECORDED_S
    if abs(slope - true) > NEAR_SLOPE * true:
        raise Broken(
            f"{name} rises by {slope:.4g} in a second of its record where {true:.4g} is true: its unit of time?"
        )


STREAMS = (measures_what_is_there, tells_silence, is_harmless, comes_and_goes)
RECORDS = (reads_its_own_files, is_harmless, comes_and_goes)
