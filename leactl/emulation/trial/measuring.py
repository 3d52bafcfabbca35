"""What every device must keep that measures at its own pace, or whose readings come in files."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from leactl.driver.contract import Row, SampleBlock
from leactl.driver.far_end import PAIRS
from leactl.driver.file_records import BatchSource
from leactl.emulation.trial.drives import confirmed
from leactl.emulation.trial.stand import Broken, Stand
from leactl.errors import DeviceError

MEASURED_S, RECORDED_S = 1.0, 20.0
LOOKS_S = 0.002
NEAR = 0.01  # of the range of what was measured, and of a value
LATE_S = 0.1  # by which a stamp may lie before the moment at which its row is taken
Samples = dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]  # by channel, times and values


def taken(stand: Stand, seconds: float) -> tuple[Samples, list[tuple[float, float]]]:
    """What a device gives while time passes; stamps with the moments at which they were taken."""
    gathered: dict[str, tuple[list[float], list[float]]] = {}
    moments: list[tuple[float, float]] = []
    names = {spec.name: [channel.name for channel in spec.channels] for spec in stand.driver.streams}
    end = stand.clock.now() + seconds
    while stand.clock.now() < end:
        for one in stand.driver.take():
            rows: Sequence[Row] = list(one.rows()) if isinstance(one, SampleBlock) else [one]
            for row in rows:
                moments.append((row.time, stand.clock.now()))
                for name, value in zip(names[row.stream], row.values, strict=True):
                    times, values = gathered.setdefault(name, ([], []))
                    times.append(row.time)
                    values.append(float(value))
        stand.wait(LOOKS_S)
    return {name: (np.asarray(times), np.asarray(values)) for name, (times, values) in gathered.items()}, moments


def truth(stand: Stand, quantity: str, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a quantity truly was."""
    if quantity in PAIRS:
        return stand.bench.leads.voltages(times, PAIRS.index(quantity))
    return np.asarray(stand.bench.true_value(quantity, times), np.float64)


def measures_what_is_there(stand: Stand) -> None:
    """Every channel has the quantity that it is named for, in its unit, at the time of its stamp, each sample once."""
    stand.driver.open()
    samples, moments = taken(stand, MEASURED_S)
    early = [taken_at - stamp for stamp, taken_at in moments] or [0.0]
    if min(early) < -1e-9 or max(early) > LATE_S + MEASURED_S / max(len(moments), 1):
        raise Broken(f"stamps lie {min(early):.3g} to {max(early):.3g} s before the moment at which a sample is taken")
    channels = {channel.name: channel for spec in stand.driver.streams for channel in spec.channels}
    for name, channel in channels.items():
        times, values = samples.get(name, (np.empty(0), np.empty(0)))
        if len(times) < 2:
            raise Broken(f"{name}: {len(times)} samples in {MEASURED_S:g} s")
        if np.any(np.diff(times) <= 0.0):
            raise Broken(f"{name}: stamps do not increase: a sample comes twice, or out of order")
        true = truth(stand, channel.quantity, times)
        compare(name, values, true)


def compare(name: str, values: NDArray[np.float64], true: NDArray[np.float64]) -> None:
    """Hold what was measured against the truth."""
    if np.isnan(values).any():
        raise Broken(f"{name}: {int(np.isnan(values).sum())} of {len(values)} samples are NaN although all is well")
    allowed = NEAR * float(np.max(np.abs(true))) + 1e-3
    off = np.abs(values - true)
    if float(np.max(off)) > allowed:
        worst = int(np.argmax(off))
        ratio = float(np.sum(values * true) / max(float(np.sum(true * true)), 1e-12))
        raise Broken(
            f"{name} reads {values[worst]:.6g} where {true[worst]:.6g} is true; all together {ratio:.4g} times"
        )


def tells_silence(stand: Stand) -> None:
    """A device that is unplugged is told, or gives nothing more."""
    stand.driver.open()
    taken(stand, 0.2)
    stand.cut()
    if stand.driver.transport == "none":
        return
    try:
        samples, _ = taken(stand, 1.0)
    except DeviceError:
        return
    late = sum(int(np.sum(np.isfinite(values[times > stand.clock.now() - 0.5]))) for times, values in samples.values())
    if late:
        raise Broken(f"{late} readings of the last half second have come although the device is unplugged")


def is_harmless(stand: Stand) -> None:
    """`safe_state` is confirmed by a device that only measures, before `open` and in operation, and never raises."""
    for when in ("before open()", "in operation"):
        if not confirmed(stand):
            raise Broken(f"safe_state {when} is not confirmed although the device only measures")
        if when == "before open()":
            stand.driver.open()


def comes_and_goes(stand: Stand) -> None:
    """It may be closed twice, unopened too, and opened again."""
    stand.driver.close()
    stand.driver.open()
    stand.driver.close()
    stand.driver.close()
    stand.driver.open()


def reads_its_own_files(stand: Stand) -> None:
    """A record that its program has written is read with the quantities that were there, and increasing stamps."""
    source = stand.driver
    assert isinstance(source, BatchSource)
    machine = stand.machine
    machine.current, machine.velocity, machine.angle = 2.0, 3.0, 0.5
    stand.driver.open()
    stand.wait(RECORDED_S)
    files = source.exports.fresh()
    if not files:
        raise Broken(f"its far end has left no file after {RECORDED_S:g} s")
    record = source.read_files(files)
    if np.any(np.diff(record.time) <= 0.0):
        raise Broken("stamps of a record do not increase")
    known = {"q_axis_current": 2.0, "velocity": 3.0, "angle": 0.5, "bus_voltage": machine.bus_voltage}
    of_drive = {channel.quantity for channel in record.channels} & {"q_axis_current", "velocity", "angle"}
    for place, channel in enumerate(record.channels):
        values = record.values[:, place]
        if of_drive:
            compare(channel.name, values, np.full(len(values), known[channel.quantity]))
            continue
        low, high = (float(stand.bench.true_value(channel.quantity, at)) for at in (-RECORDED_S, RECORDED_S))
        if np.isnan(values).any() or values.min() < low - 1.0 or values.max() > high + 1.0:
            raise Broken(f"{channel.name} reads {values.min():.5g} to {values.max():.5g}; {low:g} to {high:g} is true")


STREAMS = (measures_what_is_there, tells_silence, is_harmless, comes_and_goes)
RECORDS = (reads_its_own_files, is_harmless, comes_and_goes)
