"""Upload of a device's own recording into a text table that its importer reads and `leactl runs attach` takes."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from leactl.bench import benchfile
from leactl.bench.bench import Bench
from leactl.bench.wire_trace import WireTrace, bench_with_trace
from leactl.bench.wiring import MachineWiring
from leactl.driver import registry
from leactl.driver.contract import OwnRecording, RecordingDevice
from leactl.driver.safe_state import make_safe, unconfirmed_devices
from leactl.errors import DeviceError, InputError
from leactl.runfile.publish import new_file, refuse_existing
from leactl.runner import locks
from leactl.runner.checked_bench import load_checked

NUMBER_DIGITS = 9  # enough for single precision


class SavedRecording(NamedTuple):
    """A recording that has become a file."""

    file: Path
    headings: tuple[str, ...]
    rows: int
    interval: float  # s


def save_recording(
    name_or_path: str,
    device: str,
    target: Path,
    changed_buses: Sequence[str] = (),
    trace: WireTrace | None = None,
) -> SavedRecording:
    """Switch a bench's device off, upload its recording, and save it; no other device is touched.

    Parameters
    ----------
    device : its name in the bench file; it needs a recorder (`RecordingDevice`).
    target : a path that is not taken.
    changed_buses : each as `NAME=INTERFACE:CHANNEL`.
    trace : receives every byte on the device's wire.

    Raises
    ------
    InputError : no such device, none with a recorder, a bench without buses of this machine, or a name that is taken.
    DeviceError : a run holds the bench, or the recorder holds nothing: nothing was written. Or the device is not
        confirmed safe after a finished upload, which was saved.
    """
    refuse_existing(target)
    file, devices, _document = load_checked(name_or_path)
    new_buses = benchfile.changed_buses(file, changed_buses)
    chosen_devices = [entry for entry in devices if entry.name == device]
    if not chosen_devices:
        raise InputError(
            f"bench '{file.name}' has no device '{device}'; it has {', '.join(entry.name for entry in devices)}"
        )
    if not hasattr(registry.load(chosen_devices[0].entry.driver), "recorded"):
        raise InputError(
            f"{device} ({chosen_devices[0].entry.driver}) has no recorder of its own that could be uploaded"
        )
    if file.emulated is not None and chosen_devices[0].entry.bus not in new_buses:
        raise InputError(
            f"bench '{file.name}' is emulated: nothing has been recorded there; serve it (leactl bench serve), and say"
            " by --bus where"
        )
    file = file.model_copy(update={"buses": {**file.buses, **new_buses}})
    with locks.held(file, chosen_devices):
        recording, doubt = _upload(bench_with_trace(file, chosen_devices, MachineWiring(), trace), device)
    try:
        with new_file(target) as path:
            path.write_text(_table(recording), encoding="utf-8")
    except BaseException as error:
        if doubt:
            error.add_note(doubt)
        raise
    if doubt:
        raise DeviceError(f"{doubt}; its recording is complete and was saved: {target}")
    return SavedRecording(target, recording.headings, len(recording.values), recording.interval)


def _upload(bench: Bench, name: str) -> tuple[OwnRecording, str]:
    """Open the device, which switches it off, upload its recording, make it safe again and close it.

    Return the recording, and what could not be confirmed of the device's safe state; an empty string if it is safe.
    """
    device = bench.drivers[name]
    assert isinstance(device, RecordingDevice)
    bench.open()
    try:
        recording = device.recorded()
    except BaseException as error:
        if doubt := _make_safe_and_close(bench, name):
            error.add_note(doubt)
        raise
    return recording, _make_safe_and_close(bench, name)


def _make_safe_and_close(bench: Bench, name: str) -> str:
    """Make the device safe and close it; return what could not be confirmed, or an empty string."""
    try:
        return unconfirmed_devices(make_safe([bench.drivers[name]]))
    finally:
        bench.close()


def _table(recording: OwnRecording) -> str:
    """Return a recording as comma-separated text, with a column of times [s] before its own."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")  # quotes a heading with a comma
    table.writerow(("Time (s)", *recording.headings))
    for number, row in enumerate(recording.values.tolist()):
        table.writerow([f"{value:.{NUMBER_DIGITS}g}" for value in (number * recording.interval, *row)])
    return text.getvalue()
