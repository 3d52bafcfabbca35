"""Recording beside bare h5py appends of the same blocks to the same layout."""

import h5py
import numpy as np
import pytest

from leactl.quantities import ChannelSpec
from leactl.runfile import layout
from leactl.runfile.write.writer import LIVE_CHUNK_ROWS, RunWriter
from tests.benchmarks.rounds import compare
from tests.runfile.specimen import info

LEAST = 0.8
BLOCKS = 40
CHANNELS = [
    ChannelSpec(f"{role}_{name}", quantity, role, f"drive_{role}", dtype=dtype)
    for role in ("test", "load")
    for name, quantity, dtype in (
        ("iq_ref", "q_axis_current_reference", "f4"),
        ("omega_ref", "velocity_reference", "f4"),
        ("theta_ref", "angle_reference", "f8"),
        ("iq", "q_axis_current", "f4"),
        ("omega", "velocity", "f4"),
        ("theta", "angle", "f8"),
        ("enabled", "drive_enabled", "f4"),
    )
]


def bare_file(path):
    """One growing dataset a channel, as the recording's live file has them."""
    file = h5py.File(path, "w", libver=layout.HDF5_FORMAT)
    storage = {"shape": (0,), "maxshape": (None,), "chunks": (LIVE_CHUNK_ROWS,), "fillvalue": np.nan}
    columns = [file.create_dataset("time", dtype="f8", **storage)]
    columns += [file.create_dataset(spec.name, dtype=spec.dtype, **storage) for spec in CHANNELS]
    file.swmr_mode = True
    return file, columns


@pytest.mark.parametrize("rows", [500, 5000])
def test_recording_is_nearly_as_fast_as_bare_appends(tmp_path, figure, rows):
    block = np.random.default_rng(1).normal(size=(rows, len(CHANNELS)))
    writer = RunWriter(tmp_path, info(), {"loop": CHANNELS})
    file, columns = bare_file(tmp_path / "bare.h5")
    recorded = 0

    def recording():
        nonlocal recorded
        for _ in range(BLOCKS):
            writer.append("loop", np.arange(recorded, recorded + rows) * 1e-3, block)
            writer.flush()
            recorded += rows

    def bare():
        for _ in range(BLOCKS):
            end = len(columns[0]) + rows
            stamps = np.arange(end - rows, end) * 1e-3
            for place, column in enumerate(columns):
                column.resize((end,))
                column[end - rows :] = block[:, place - 1] if place else stamps
            file.flush()

    result = compare(bare, recording, each=BLOCKS)
    file.close()
    writer.close("complete")
    figure(f"recording blocks of {rows} rows: {result.ratio:.2f} of the speed of bare h5py appends; limit {LEAST}")
    assert result.ratio >= LEAST
