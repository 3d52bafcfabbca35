"""A camera's whole thermal record: 150 min at 30 Hz, nine regions, read from text."""

import time
from datetime import datetime, timedelta

import numpy as np
from leactl_plugins.thermal_csv.emulator import series

from leactl.tables.writing import TableDialect
from tests.driver.camera import camera

ROWS, REGIONS, LIMIT_S = 270_000, 9, 10.0


def test_a_thermal_record_is_read_in_seconds(tmp_path, figure):
    began = datetime(2026, 11, 20, 9, 0)
    stamps = [(began + timedelta(seconds=k / 30)).strftime("%d.%m.%Y %H:%M:%S,%f")[:-3] for k in range(ROWS)]
    rng = np.random.default_rng(0)
    values = np.round(25 + np.linspace(0, 90, ROWS)[:, None] + rng.normal(0, 0.1, (ROWS, REGIONS)), 2)
    columns = {f"R{k}": list(values[:, k]) for k in range(REGIONS)}
    path = tmp_path / "export.csv"
    path.write_bytes(series(stamps, columns, TableDialect("utf-16-le", True, ";", ",")))
    regions = {f"r{k}": {"column": f"R{k}", "quantity": "winding_temperature"} for k in range(REGIONS)}
    source = camera(regions=regions, time={"column": "Time", "zone": "Europe/Berlin"})
    before = time.process_time()
    record = source.read_files([path])
    taken = time.process_time() - before
    np.testing.assert_array_equal(record.values, values)
    figure(f"{ROWS} rows of {REGIONS} regions, {path.stat().st_size / 1e6:.0f} MB: read in {taken:.2f} s of one core")
    assert taken < LIMIT_S
