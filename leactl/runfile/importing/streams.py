"""Convert columns of a source to streams of a run: units converted, clocks aligned, stamps checked."""

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.quantities import ChannelSpec
from leactl.runfile.align.alignment import Alignment
from leactl.runfile.align.similarity import align_by_similarity
from leactl.runfile.importing.mapping import (
    ChannelMapping,
    FieldOf,
    Mapping,
    StepsByColumn,
    StreamMapping,
    TimeBase,
)
from leactl.runfile.importing.sources.source import LogSource, MissingColumn
from leactl.units import LINEAR, SECONDS, converter
from leactl.yamlfile import Document

Array = npt.NDArray[np.float64]


@dataclass
class Stream:
    """Channels with common stamps, in memory."""

    time: Array
    specs: list[ChannelSpec]
    values: list[Array]
    aligned: str = ""  # method and uncertainty of an estimated clock offset
    labels: list[str] | None = None  # label of each row, by which steps are named

    def channel(self, name: str) -> Array:
        """Return the values of one channel."""
        return self.values[self.specs.index(self.spec(name))]

    def spec(self, name: str) -> ChannelSpec:
        """Return the specification of one channel."""
        return next(spec for spec in self.specs if spec.name == name)

    def rows(self, start: int, stop: int) -> "Stream":
        """Return the rows `start` to `stop` (excluded)."""
        labels = self.labels[start:stop] if self.labels is not None else None
        columns = [column[start:stop] for column in self.values]
        return Stream(self.time[start:stop], self.specs, columns, self.aligned, labels)


def build_streams(source: LogSource, mapping: Mapping, document: Document) -> dict[str, Stream]:
    """Read every mapped channel of a source and put all streams on the run's clock.

    Raises
    ------
    InputError : missing columns, impossible units, stamps that do not increase, or clocks that cannot be aligned.
    """
    faults: list[str] = []
    streams: dict[str, Stream] = {}
    for name, settings in mapping.streams.items():
        try:
            steps_by_column = mapping.steps_by_column
            has_labels = steps_by_column is not None and steps_by_column.stream == name
            streams[name] = build_stream(source, name, settings, steps_by_column if has_labels else None, document)
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    for name, settings in mapping.streams.items():
        if settings.clock is not None:
            alignment = alignment_of(streams, name, settings, document)
            streams[name].time = streams[name].time + (
                alignment.offset if alignment else settings.clock.offset_s or 0.0
            )
            streams[name].aligned = alignment.describe() if alignment else ""
    begins = {name: float(s.time[0]) for name, s in streams.items()}
    ends = {name: float(s.time[-1]) for name, s in streams.items()}
    last_to_begin, first_to_end = max(begins, key=lambda n: begins[n]), min(ends, key=lambda n: ends[n])
    if begins[last_to_begin] > ends[first_to_end]:
        message = (
            f"{source.path}: it begins at {begins[last_to_begin]:.6g} s, after stream {first_to_end!r} has ended at"
            f" {ends[first_to_end]:.6g} s"
        )
        raise InputError(document.fault(("streams", last_to_begin), f"{message}; set clock.offset_s or clock.estimate"))
    start = min(begins.values())
    for stream in streams.values():
        stream.time = stream.time - start
    return streams


def build_stream(
    source: LogSource, name: str, settings: StreamMapping, label_settings: StepsByColumn | None, document: Document
) -> Stream:
    """Read one stream with the stamps of its source, and the labels of its rows if `label_settings` is given."""
    faults: list[str] = []
    specs, values, columns = [], [], []
    for channel, channel_settings in settings.channels.items():
        try:
            spec, column = build_channel(source, name, channel, channel_settings, settings.records, document)
        except InputError as error:
            faults += error.faults
            continue
        specs.append(spec)
        values.append(column)
        columns.append(channel_settings.column)
    if faults:
        raise InputError(faults)
    lengths = {len(column) for column in values}
    if len(lengths) > 1:
        counts = ", ".join(f"{spec.name} {len(column)}" for spec, column in zip(specs, values, strict=True))
        raise InputError(document.fault(("streams", name), f"{source.path}: columns of different length: {counts}"))
    time, is_kept = stamps(source, settings.time, settings.records, ("streams", name, "time"), lengths.pop(), document)
    labels = (
        labels_of(source, label_settings, settings.records, time, is_kept, document)
        if label_settings is not None
        else None
    )
    return Stream(time[is_kept], specs, [column[is_kept] for column in values], labels=labels)


def labels_of(
    source: LogSource,
    label_settings: StepsByColumn,
    records: str | None,
    time: Array,
    is_row_kept: npt.NDArray[np.bool_],
    document: Document,
) -> list[str]:
    """Return the label of each kept row: its own label, or the latest label if labels have stamps of their own.

    `is_row_kept` is the mask of the kept rows. Rows before the first label have an empty label.

    Raises
    ------
    InputError : the source has no such column, labels and rows differ in number, or a label has no stamp.
    """
    try:
        raw = source.labels(label_settings.column, None if label_settings.time else records)
    except MissingColumn as lacking:
        raise InputError(document.fault(("steps_by_column", "column"), str(lacking))) from None
    if label_settings.time is None:
        if len(raw) != len(is_row_kept):
            message = f"{source.path}: {len(raw)} labels for {len(is_row_kept)} rows"
            hint = "; give steps_by_column.time where labels have stamps of their own"
            raise InputError(document.fault(("steps_by_column", "column"), message + hint))
        return [label for label, is_kept in zip(raw, is_row_kept, strict=True) if is_kept]
    label_stamps, is_label_kept = stamps(
        source, label_settings.time, None, ("steps_by_column", "time"), len(raw), document
    )
    labels_by_count = ["", *(label for label, is_kept in zip(raw, is_label_kept, strict=True) if is_kept)]
    return [
        labels_by_count[row] for row in np.searchsorted(label_stamps[is_label_kept], time[is_row_kept], side="right")
    ]


def build_channel(
    source: LogSource, stream: str, name: str, settings: ChannelMapping, records: str | None, document: Document
) -> tuple[ChannelSpec, Array]:
    """Read one channel in the units of its quantity.

    Raises
    ------
    InputError : no such column, values that are texts or infinite, or no finite value.
    """
    keys = ("streams", stream, "channels", name)
    try:
        column = source.column(settings.column, records)
    except MissingColumn as lacking:
        raise InputError(document.fault((*keys, "column"), str(lacking))) from None
    if isinstance(column, list):
        raise InputError(f"{source.location(settings.column, 0)}: {column[0]!r} is not a number")
    scale = number_value(source, settings.scale, (*keys, "scale"), document)
    offset = number_value(source, settings.offset, (*keys, "offset"), document)
    conversion = converter(settings.units or "", settings.quantity)
    units = conversion.target if conversion else ""
    values = settings.sign * (scale * column + offset)
    if conversion:
        values = conversion.factor * (values - conversion.zero)
    infinite_rows = np.flatnonzero(np.isinf(values))
    if len(infinite_rows):
        raise InputError(
            [f"{source.location(settings.column, int(infinite_rows[0]))}: infinite; a missed sample is NaN or empty"]
        )
    if not np.isfinite(values).any():
        raise InputError(f"{source.path}: column {settings.column!r} holds no number at all")
    spec = ChannelSpec(
        name=name,
        quantity=settings.quantity,
        role=settings.role,
        device=settings.device or source.path.name,
        long_name=settings.long_name,
        location=settings.location,
        sampling=settings.sampling or "",
        units=units if units in LINEAR else "",
        dtype="f8",
        scale_std=settings.scale_std,
    )
    return spec, np.asarray(values, np.float64)


def number_value(source: LogSource, value: float | FieldOf, keys: tuple[str | int, ...], document: Document) -> float:
    """Return a number of the mapping, or the scaled value of the source's field that the mapping names.

    Raises
    ------
    InputError : the source has no such field, or its value is not a finite number.
    """
    if not isinstance(value, FieldOf):
        return value
    try:
        field_value = source.field(value.field)
    except MissingColumn as lacking:
        raise InputError(document.fault((*keys, "field"), str(lacking))) from None
    if isinstance(field_value, str) or not np.isfinite(field_value):
        raise InputError(document.fault((*keys, "field"), f"{source.path}: {field_value!r} is not a number"))
    return value.scale * field_value + value.offset


def stamps(
    source: LogSource, base: TimeBase, records: str | None, keys: tuple[str, ...], rows: int, document: Document
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the stamps of all rows [s] and a mask of the rows that are kept, whose stamps increase strictly.

    Raises
    ------
    InputError : no such column, a row without a stamp, or stamps that do not increase.
    """
    all_rows: npt.NDArray[np.bool_] = np.ones(rows, bool)
    if base.column is None:
        step = base.step_s or 1.0 / (base.rate_Hz or 1.0)
        return np.asarray(base.start_s + step * np.arange(rows), np.float64), all_rows
    try:
        raw = source.column(base.column, records)
    except MissingColumn as lacking:
        raise InputError(document.fault((*keys, "column"), str(lacking))) from None
    if len(raw) != rows:
        raise InputError(document.fault((*keys, "column"), f"{len(raw)} stamps for {rows} rows"))
    time = seconds(source, base, raw)
    rows_without_stamp = np.flatnonzero(~np.isfinite(time))
    if len(rows_without_stamp):
        raise InputError(
            f"{source.location(base.column, int(rows_without_stamp[0]))}: no stamp;"
            f" {len(rows_without_stamp)} rows have none"
        )
    is_kept = np.concatenate([[True], np.diff(time) != 0]) if base.repeated == "drop" else all_rows
    kept_rows = np.flatnonzero(is_kept)
    wrong_positions = np.flatnonzero(np.diff(time[kept_rows]) <= 0)
    if len(wrong_positions):
        row = int(kept_rows[wrong_positions[0] + 1])
        previous, stamp = time[kept_rows[wrong_positions[0]]], time[row]
        finding = "stands twice" if stamp == previous else f"goes back from {previous:.9g} s"
        hint = "; time.repeated: drop leaves the later rows out" if stamp == previous else ""
        count_text = f" ({len(wrong_positions)} such rows)" if len(wrong_positions) > 1 else ""
        raise InputError(f"{source.location(base.column, row)}: stamp {stamp:.9g} s {finding}{count_text}{hint}")
    return time, is_kept


def seconds(source: LogSource, base: TimeBase, raw: Array | list[str]) -> Array:
    """Convert stamps to seconds.

    Raises
    ------
    InputError : a stamp is neither a number nor, for `iso8601`, an ISO 8601 moment.
    """
    assert base.column is not None
    if base.units != "iso8601":
        if isinstance(raw, list):
            raise InputError(
                f"{source.location(base.column, 0)}: {raw[0]!r} is not a number; time.units may be iso8601"
            )
        return raw * SECONDS[base.units]
    stamps_s = np.empty(len(raw))
    for row, text in enumerate(raw):
        try:
            moment = datetime.fromisoformat(str(text))
        except ValueError:
            raise InputError(f"{source.location(base.column, row)}: {text!r} is no ISO 8601 date and time") from None
        stamps_s[row] = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    return stamps_s


def alignment_of(
    streams: dict[str, Stream], name: str, settings: StreamMapping, document: Document
) -> Alignment | None:
    """Estimate the alignment of a stream's clock with the run's; None if the mapping asks for no estimate.

    Raises
    ------
    InputError : the two channels that the mapping names cannot be aligned.
    """
    clock = settings.clock
    if clock is None or clock.estimate is None:
        return None
    reference_stream, channel = clock.estimate.against.split("/")
    stream, reference = streams[name], streams[reference_stream]
    channels_text = f"{clock.estimate.channel} and {clock.estimate.against}"
    try:
        return align_by_similarity(
            (stream.time, stream.channel(clock.estimate.channel)),
            (reference.time, reference.channel(channel)),
            within_s=clock.estimate.within_s,
            channels_text=channels_text,
        )
    except InputError as fault:
        hint = "clock.offset_s or another within_s decides"
        raise InputError(document.fault(("streams", name, "clock", "estimate"), f"{fault}; {hint}")) from None
