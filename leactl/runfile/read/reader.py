"""Open a run and read its channels by quantity and role; the file is checked when it is opened.

After `Run.open`, stamps increase strictly, every channel has a value for each stamp, and units are those of the
quantity. Values are float64; a missed sample is NaN.
"""

import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError, MissingChannel
from leactl.quantities import ChannelSpec
from leactl.runfile import layout, seal
from leactl.runfile.hdf5.opening import open_run_file, reading
from leactl.runfile.read.stream_checks import faults_of_streams, faults_of_table, whole_rows
from leactl.runfile.summary import RECORDING
from leactl.yamlfile import shown

if TYPE_CHECKING:
    import xarray

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Channel:
    """One measured quantity over time; numpy converts it to the array of its values."""

    time: Array  # s since the run's start, of this channel's samples: the stream's stamps plus the channel's skew
    values: Array
    quantity: str
    role: str
    units: str
    device: str
    long_name: str
    location: str
    sampling: str  # "instant", or "mean" over the interval that ends at the stamp; empty where the file does not say
    stream: str
    scale_std: float = 0.0  # relative standard uncertainty of the calibration, shared by the device's channels

    def __len__(self) -> int:
        return len(self.values)

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.array(self.values, dtype) if copy else np.asarray(self.values, dtype)

    def __repr__(self) -> str:
        location = f" at {self.location}" if self.location else ""
        span = f", {self.time[0]:.6g} to {self.time[-1]:.6g} s" if len(self.time) else ""
        return f"<Channel {self.quantity} of {self.role}{location} [{self.units}]: {len(self)} values{span}>"


@dataclass(frozen=True)
class Step:
    """A part of the run, times in s since its start; analyses leave out its first `settle` seconds."""

    name: str
    start: float
    stop: float
    settle: float
    parameters: dict[str, Any]


@dataclass(frozen=True)
class Event:
    """A logged event of the run, such as a warning or a stop."""

    time: float  # s since the run's start
    level: str
    source: str
    message: str


@dataclass(frozen=True)
class Note:
    """A note that a person added after the run."""

    time: str
    author: str
    text: str


class Run:
    """A run file, open for reading: `with Run.open(path) as run: ...`."""

    def __init__(self, path: Path, file: Any, live: bool) -> None:
        self.path = path
        self.attributes = layout.attributes(file)
        self.setup = layout.attributes(file["setup"]) if "setup" in file else {}
        self.unfinished = live or self.status == RECORDING
        self._file = file
        self._streams = file.get("streams", {})
        self.condemned: dict[str, str] = {}  # by `stream/name`: reason why reading the channel raises InputError
        if faults := faults_of_streams(self._streams, self.unfinished):
            raise InputError([f"{path}: {fault}" for fault in faults])
        self.rows = {name: whole_rows(group) for name, group in self._streams.items()}
        self.streams = {name: channel_specs(group) for name, group in self._streams.items()}

    @classmethod
    def open(cls, path: Path | str) -> Self:
        """Open and check a run file, also one that is being written or was left by a kill.

        Raises
        ------
        InputError : not a run file, cut short, or breaking the format; one line for each fault.
        """
        file_path = Path(path)
        file, live = open_run_file(file_path)
        try:
            with reading(file_path):
                return cls(file_path, file, live)
        except InputError:
            file.close()
            raise

    @property
    def status(self) -> str:
        """How the run ended; `recording` while it has not, or where its writer was killed."""
        return str(self.attributes.get("status", ""))

    @property
    def mechanical(self) -> str:
        """Mechanical set-up: free, locked, coupled or heated; empty if the file does not say."""
        return str(self.setup.get("mechanical", ""))

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the protocol with the values of the run; empty if the file has none."""
        with reading(self.path, "/parameters"):
            return layout.parameters(self._file)

    @property
    def instruments(self) -> dict[str, dict[str, str]]:
        """Model, serial number, firmware and calibration dates of each device, by its name, as far as known."""
        with reading(self.path, "/instruments"):
            return layout.instruments(self._file)

    @property
    def steps(self) -> list[Step]:
        """The steps of the run, in the order of recording."""
        rows = self._table("steps", layout.TABLES["steps"])
        return [
            Step(name, start, stop, settle, self._parameters(index, text))
            for index, (name, start, stop, settle, text) in enumerate(rows)
        ]

    @property
    def events(self) -> list[Event]:
        """The events of the run, in the order of recording."""
        return [Event(*row) for row in self._table("events", layout.TABLES["events"])]

    @property
    def notes(self) -> list[Note]:
        """The notes that people added after the run."""
        return [Note(*row) for row in self._table("notes", layout.NOTES)]

    def source(self, name: str) -> str | None:
        """Return the YAML text of the `protocol`, the `bench` or the `model` of the run; None if the file has none."""
        hdf5_path = f"{name}/source"
        with reading(self.path, hdf5_path):
            return str(layout.to_python(self._file[hdf5_path][()])) if hdf5_path in self._file else None

    def has(self, quantity: str, role: str = "test") -> bool:
        """Return whether the run has a channel of this quantity and role."""
        return bool(self._find(quantity, role))

    def channels(self, quantity: str, role: str = "test") -> list[Channel]:
        """Return every channel of this quantity and role, one for each location; empty if there is none."""
        return [self._read(stream, spec) for stream, spec in self._find(quantity, role)]

    def channel(self, quantity: str, role: str = "test", location: str | None = None) -> Channel:
        """Return the one channel of this quantity and role.

        Raises
        ------
        MissingChannel : the run has none.
        InputError : it has several; ask for a location.
        """
        matches = self._find(quantity, role)
        if location is not None:
            matches = [(stream, spec) for stream, spec in matches if spec.location == location]
        if not matches:
            location_text = f" at {location!r}" if location is not None else ""
            raise MissingChannel(f"{self.path}: no {quantity} of {role}{location_text}; the run has {self._contents()}")
        if len(matches) > 1:
            locations = ", ".join(spec.location or f"{stream}/{spec.name}" for stream, spec in matches)
            raise InputError(
                f"{self.path}: several channels of {quantity} of {role}: {locations}; ask for one location"
            )
        return self._read(*matches[0])

    def __getitem__(self, wanted: str | tuple[str, ...]) -> Channel:
        """`run["torque"]`, `run["torque", "load"]` and `run["torque", "load", location]` call `channel`."""
        return self.channel(*((wanted,) if isinstance(wanted, str) else wanted))

    def __repr__(self) -> str:
        return f"<Run {self.path.name}, {self.status}: {self._contents()}>"

    def to_xarray(self) -> "xarray.Dataset":
        """Convert the run to a dataset with every channel as a variable over its stream's time, all in memory.

        Needs the extra `xarray`. Dimensions are the streams, coordinates their stamps in s; variables are named by
        role, quantity and location, and have units and the other attributes of the file.

        Raises
        ------
        InputError : xarray is not installed.
        """
        from leactl.runfile.read.xarray_dataset import dataset

        return dataset(self)

    def channel_at(self, channel_path: str) -> Channel:
        """Return the channel with the path `stream/name`.

        Raises
        ------
        MissingChannel : there is none.
        """
        stream, _, name = channel_path.partition("/")
        for spec in self.streams.get(stream, ()):
            if spec.name == name:
                return self._read(stream, spec)
        paths = ", ".join(f"{stream}/{spec.name}" for stream, specs in self.streams.items() for spec in specs)
        raise MissingChannel(f"{self.path}: no channel {channel_path}; the run has {paths or 'none'}")

    def attached(self, stream: str) -> dict[str, Any]:
        """Return provenance and clock alignment of a stream that was attached later; empty for a recorded one."""
        attributes = layout.attributes(self._streams[stream])
        return {name: value for name, value in attributes.items() if name.startswith(("record_", "alignment_"))}

    @property
    def checked(self) -> bool:
        """Whether any dataset has a checksum; files of other programs may have none."""
        return any("sha256" in item.attrs for _, item in layout.datasets(self._file))

    @property
    def sealed(self) -> bool:
        """Whether names and attributes are sealed too; files of other programs may not be."""
        return seal.SEAL in self._file.attrs

    def time(self, stream: str) -> Array:
        """Return the stamps of one stream."""
        return self.values(stream, "time", 0, self.rows[stream])

    def values(self, stream: str, name: str, start: int, stop: int) -> Array:
        """Return the rows `start` to `stop` (excluded) of a channel of one stream, or of its `time`, as float64."""
        return np.asarray(self._column(stream, name, start, stop), np.float64)

    def blocks(self, stream: str, rows: int = layout.BLOCK_ROWS) -> Iterator[dict[str, npt.NDArray[Any]]]:
        """Yield the stream's columns in their stored types, `time` first, in blocks of `rows` rows.

        Raises
        ------
        InputError : the run has no such stream, or a block would have no row.
        """
        if stream not in self.streams:
            raise InputError(f"{self.path}: no stream '{stream}'; the run has {', '.join(self.streams) or 'none'}")
        if rows < 1:
            raise InputError(f"blocks of {rows} rows: 1 or more was expected")
        names = ["time", *(spec.name for spec in self.streams[stream])]
        edges = [*range(0, self.rows[stream], rows), self.rows[stream]]
        return (
            {name: self._column(stream, name, start, stop) for name in names}
            for start, stop in itertools.pairwise(edges)
        )

    def close(self) -> None:
        """Close the file; arrays that were read stay valid."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()

    def _find(self, quantity: str, role: str) -> list[tuple[str, ChannelSpec]]:
        """Return stream and specification of each channel of this quantity and role."""
        all_specs = ((stream, spec) for stream, specs in self.streams.items() for spec in specs)
        return [(stream, spec) for stream, spec in all_specs if (spec.quantity, spec.role) == (quantity, role)]

    def _contents(self) -> str:
        """Return the quantities and roles that the run has, as text for a message."""
        descriptions = {
            f"{spec.quantity} of {spec.role}" for specs in self.streams.values() for spec in specs if spec.quantity
        }
        return ", ".join(sorted(descriptions)) or "no channel"

    def _read(self, stream: str, spec: ChannelSpec) -> Channel:
        """Return all rows of a channel."""
        return self.section(stream, spec, 0, self.rows[stream])

    def section(self, stream: str, spec: ChannelSpec, start: int, stop: int) -> Channel:
        """Return the rows `start` to `stop` (excluded) of a channel.

        Raises
        ------
        InputError : the channel is in `condemned`.
        """
        if reason := self.condemned.get(f"{stream}/{spec.name}"):
            raise InputError(reason)
        return Channel(
            time=self.values(stream, "time", start, stop) + spec.skew_s,
            values=self.values(stream, spec.name, start, stop),
            quantity=spec.quantity,
            role=spec.role,
            units=spec.units,
            device=spec.device,
            long_name=spec.long_name,
            location=spec.location,
            sampling=spec.sampling,
            stream=stream,
            scale_std=spec.scale_std,
        )

    def _column(self, stream: str, name: str, start: int, stop: int) -> npt.NDArray[Any]:
        """Return the rows `start` to `stop` (excluded) of a column in its stored type."""
        with reading(self.path, f"/streams/{stream}/{name}"):
            values: npt.NDArray[Any] = self._streams[stream][name][start:stop]
        return values

    def _parameters(self, index: int, text: str) -> dict[str, Any]:
        """Parse the parameters of the step with this index.

        Raises
        ------
        InputError : the text is not a JSON object.
        """
        try:
            parameters = json.loads(text or "{}")
        except (ValueError, RecursionError):  # RecursionError for thousands of nested brackets
            parameters = None
        if not isinstance(parameters, dict):
            raise InputError(f"{self.path}: /steps/parameters[{index}]: {shown(text)} is not a JSON object")
        return parameters

    def _table(self, name: str, columns: dict[str, int | None]) -> list[tuple[Any, ...]]:
        """Return the rows of a table of parallel arrays, cut to the shortest column if the file is unfinished.

        Empty if the file has no such table.

        Raises
        ------
        InputError : the table lacks a column, or the columns of a closed file differ in length.
        """
        if name not in self._file:
            return []
        with reading(self.path, f"/{name}"):
            group = self._file[name]
            if missing_columns := [column for column in columns if column not in group]:
                raise InputError(f"{self.path}: /{name}: no {', '.join(missing_columns)}")
            if name in layout.TABLES and not self.unfinished and (faults := faults_of_table(group, name)):
                raise InputError([f"{self.path}: {fault}" for fault in faults])
            columns_of_cells = [
                layout.texts(group[c]) if layout.is_text(group[c]) else group[c][()].tolist() for c in columns
            ]
        return list(zip(*columns_of_cells, strict=False))


def channel_specs(group: Any) -> list[ChannelSpec]:
    """Return the specifications of a stream's channels, from their attributes."""
    specs = []
    for name in group:
        if name != "time":
            attributes = layout.attributes(group[name])
            texts = {key: str(value) for key, value in attributes.items()}
            keys = ("quantity", "role", "device", "long_name", "location", "sampling", "units")
            fields = {key: texts.get(key, "") for key in keys}
            skew, scale_std = (float(attributes.get(key, 0.0)) for key in ("skew", "scale_std"))
            dtype = group[name].dtype.str[1:]
            specs.append(ChannelSpec(name, **fields, dtype=dtype, skew_s=skew, scale_std=scale_std))
    return specs
