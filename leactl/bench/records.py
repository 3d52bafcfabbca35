"""Read records from files of the devices of a bench, and attach the records to runs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

from pydantic import ValidationError

from leactl import yamlfile
from leactl.bench.benchfile import CheckedDevice, Device
from leactl.driver import registry
from leactl.driver.clock import MonotonicClock
from leactl.driver.contract import Driver, DriverSettings
from leactl.driver.file_records import BatchSource, FileRecord, RecordSettings
from leactl.errors import InputError
from leactl.runfile.attach import AlignedRecord, align_record, attach
from leactl.runfile.read.reader import Run


class RecordDevice:
    """A device whose readings come in files, created from `devices.NAME` of a bench file; its other keys are not used.

    Raises
    ------
    InputError : the file has no such device, its readings do not come in files, or its settings have faults.
    """

    def __init__(self, document: yamlfile.Document, name: str) -> None:
        devices = document.data.get("devices") if isinstance(document.data, dict) else None
        if not isinstance(devices, dict) or name not in devices:
            known = ", ".join(devices) if isinstance(devices, dict) else "no devices"
            raise InputError(document.fault(("devices",), f"no device '{name}'; the file has {known}"))
        keys: tuple[str | int, ...] = ("devices", name)
        try:
            self.entry = Device.model_validate(devices[name])
            driver = registry.load(self.entry.driver)
            self.settings: DriverSettings = driver.Settings.model_validate(self.entry.settings)
        except ValidationError as error:
            location = keys if error.title == Device.__name__ else (*keys, "settings")
            raise InputError(document.explain(error, location)) from None
        except InputError as error:
            raise InputError(document.fault((*keys, "driver"), str(error))) from None
        if not hasattr(driver, "read_files"):
            raise InputError(
                document.fault((*keys, "driver"), f"{self.entry.driver}: its readings do not come in files")
            )
        self._document, self._location = document, keys
        self.source = cast(BatchSource, driver(name, self.entry.role, self.settings, None, MonotonicClock()))

    def read(self, files: list[Path]) -> FileRecord:
        """Read one record from its files.

        Raises
        ------
        InputError : all faults of the files.
        """
        return self.source.read_files(files)

    def join(self, record: FileRecord, run: Path) -> AlignedRecord:
        """Align a record with the clock of a run.

        Raises
        ------
        InputError : the settings have no method of alignment, or the clocks cannot be aligned.
        """
        clock = self.source.clock
        if clock is None:
            message = "is missing: wall_within_s, offset_s, estimate or onset ties the record's clock to the run's"
            raise InputError(self._document.fault((*self._location, "settings", "clock"), message))
        with Run.open(run) as opened_run:
            return align_record(record, clock, opened_run)

    def attach(self, record: AlignedRecord, run: Path, replace: bool = False) -> None:
        """Store an aligned record in its run, with the settings that it was read with.

        Raises
        ------
        InputError : the run already has such a stream, and `replace` is false.
        """
        settings = self.settings.model_dump(mode="json", exclude_none=True)
        attach(run, record, settings, self.entry.driver, replace)


def bench_of_run(run: Path) -> yamlfile.Document:
    """Return the bench file that a run stores.

    Raises
    ------
    InputError : the run stores no bench file.
    """
    with Run.open(run) as opened_run:
        text = opened_run.source("bench")
    if text is None:
        raise InputError(f"{run}: the run keeps no bench file; give one with --bench")
    return yamlfile.parse(text, f"{run}: bench")


def with_run_folders(devices: Sequence[CheckedDevice], runs: Path, run_id: str = "") -> list[CheckedDevice]:
    """Return the devices, with relative folders of exports changed to folders below the directory of the runs.

    run_id : if given, the name of a further folder below, because emulated runs may execute at the same time.
    """
    relocated = []
    for device in devices:
        settings = device.settings
        if isinstance(settings, RecordSettings) and settings.exports_folder is not None:
            folder = {"exports_folder": str(runs / settings.exports_folder / run_id)}
            device = device.model_copy(update={"settings": settings.model_copy(update=folder)})
        relocated.append(device)
    return relocated


def devices_with_exports(drivers: Mapping[str, Driver]) -> dict[str, BatchSource]:
    """Return the devices of a bench whose exports are attached to a run at its end, by name."""
    sources = {name: driver for name, driver in drivers.items() if isinstance(driver, BatchSource)}
    return {name: source for name, source in sources.items() if source.exports.folder is not None}


def attach_exports(drivers: Mapping[str, Driver], document: yamlfile.Document, run: Path) -> list[str]:
    """Attach to a run all exports since the bench was opened; return one line for each device that failed.

    A failure is no error of the run, which is closed and complete: a person can attach the record later.
    """
    failures = []
    for name, source in devices_with_exports(drivers).items():
        try:
            _attach_new_exports(source, RecordDevice(document, name), run)
        except Exception as error:  # noqa: BLE001 (a fault of one plug-in must not lose the records of the others)
            failures.append(
                f"{name}: its record is not in the run: {error}; leactl runs attach {run} FILE --device {name}"
            )
    return failures


def _attach_new_exports(source: BatchSource, device: RecordDevice, run: Path) -> None:
    """Attach the exports of one device since the bench was opened.

    Raises
    ------
    InputError : there are no exports, or they cannot be read, aligned or attached.
    """
    files = source.exports.fresh()
    if not files:
        absent = ", which is no folder that can be looked into" * source.exports.absent
        raise InputError(f"no export has come into {source.exports.folder}{absent}")
    device.attach(device.join(device.read(files), run), run)
