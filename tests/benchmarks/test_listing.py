"""A list of many runs beside reading from each, by bare h5py, what its line shows."""

import shutil

import h5py
import numpy as np

from leactl.quantities import ChannelSpec
from leactl.runfile.catalog.run_index import list_runs
from leactl.runfile.write.writer import RunWriter
from tests.benchmarks.rounds import compare
from tests.benchmarks.test_recording import CHANNELS
from tests.runfile.specimen import info

LIMIT = 5.0  # the whole tree of some 40 objects is checked before anything of it is read; the line shows six of them
RUNS = 300
OWN = {
    "supply": [ChannelSpec("vbus", "bus_voltage", "test", "drive_test")],
    "torque_sensor": [ChannelSpec("torque", "torque", "test", "torque_sensor")],
}


def shown(path):
    """Attributes, parameters and last stamps, as a file that is known to be sound gives them."""
    with h5py.File(path, "r") as file:
        dict(file.attrs)
        dict(file["parameters"].attrs)
        return max(group["time"][-1] for group in file["streams"].values())


def test_a_list_costs_little_beside_reading_what_it_shows(tmp_path, figure):
    with RunWriter(tmp_path, info(), {"loop": CHANNELS, **OWN}) as writer:
        for stream, specs in {"loop": CHANNELS, **OWN}.items():
            writer.append(stream, np.arange(1, 1001) * 1e-3, np.zeros((1000, len(specs))))
        writer.step("hold", 0.1, 0.9, 0.0, {"current_A": 3.0})
    paths = [shutil.copy(writer.path, tmp_path / f"run-{number:03}.h5") for number in range(RUNS)]
    writer.path.unlink()
    assert [run.duration for run in list_runs(tmp_path)] == [1.0] * RUNS
    result = compare(lambda: list_runs(tmp_path), lambda: [shown(path) for path in paths], rounds=5)
    figure(f"list of {RUNS} runs: {result} of reading what it shows by bare h5py; limit {LIMIT}")
    assert result.ratio <= LIMIT
