"""A camera's driver over files whose bytes stand in the test."""

from leactl_plugins.thermal_csv.driver import ThermalCsv
from leactl_plugins.thermal_csv.settings import ThermalCsvSettings

REGIONS = {
    "active_1": {"column": "R1 Avg", "quantity": "winding_temperature"},
    "housing_1": {"column": "R2 Avg", "quantity": "housing_temperature"},
}


def camera(regions=None, time=None, **settings):
    given = {"regions": regions or REGIONS, "time": {"column": "Time"} if time is None else time}
    return ThermalCsv("camera", "test", ThermalCsvSettings(**given, **settings), None, None)


def read(tmp_path, text, **settings):
    path = tmp_path / "export.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return camera(**settings).read_files([path])
