"""Folders in which programs leave their exports: checked at the door, placed beside the runs, held by one run."""

import os
from copy import deepcopy
from pathlib import Path

import pytest
import yaml

from leactl.bench import benchfile
from leactl.bench.records import with_run_folders
from leactl.errors import DeviceError, InputError
from leactl.runner import locks
from tests.cli.terminal import leactl

REST = """
name: rest
setup: free
rate_Hz: 20
steps:
  - hold: {name: rest, duration_s: 0.3}
"""


def written(tmp_path, change):
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated-heated.yaml").read_text())
    change(bench["devices"])
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(bench, sort_keys=False))
    return str(path)


def second_camera(folder):
    def add(devices):
        devices["other"] = deepcopy(devices["camera"])
        devices["other"]["settings"]["exports_folder"] = folder

    return add


@pytest.mark.parametrize("folder", ["camera", "./camera/", "x/../camera"])
def test_two_programs_have_two_folders(tmp_path, folder):
    with pytest.raises(InputError, match=r"other\.settings\.exports_folder: .* is that of camera; a folder of its own"):
        benchfile.load(written(tmp_path, second_camera(folder)))
    benchfile.load(written(tmp_path, second_camera("other")))


@pytest.mark.parametrize("wrong", ["", 7])
def test_a_folder_without_a_name_is_refused(tmp_path, wrong):
    path = written(tmp_path, lambda devices: devices["camera"]["settings"].update(exports_folder=wrong))
    with pytest.raises(InputError, match=r"devices\.camera\.settings\.exports_folder"):
        benchfile.load(path)


def test_a_relative_folder_lies_where_the_runs_do(tmp_path):
    _file, devices, _document = benchfile.load("emulated-heated")
    folder = {device.name: device for device in with_run_folders(devices, tmp_path, "r7")}[
        "camera"
    ].settings.exports_folder
    assert folder == str(tmp_path / "camera" / "r7")
    _file, devices, _document = benchfile.load(written(tmp_path, second_camera("/elsewhere")))
    folder = {device.name: device for device in with_run_folders(devices, Path("runs"))}[
        "other"
    ].settings.exports_folder
    assert folder == "/elsewhere"


def test_a_folder_is_held_by_one_run(tmp_path, monkeypatch):
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    file, devices, _document = benchfile.load("emulated-heated")
    cameras = [device for device in with_run_folders(devices, tmp_path) if device.name == "camera"]
    words = rf"the folder {tmp_path}/camera of 'camera' is driven by another run, process {os.getpid()}"
    with locks.held(file.model_copy(update={"name": "one"}), cameras):
        other = file.model_copy(update={"name": "other"})
        with pytest.raises(DeviceError, match=words), locks.held(other, cameras):
            raise AssertionError
        with locks.held(
            other, with_run_folders(benchfile.devices_of_run(devices, ["winding_temperature"]), tmp_path / "b")[1:]
        ):
            pass


def test_a_camera_is_left_alone_by_protocols_that_ask_for_no_temperature():
    _file, devices, _document = benchfile.load("emulated-heated")
    assert [device.name for device in benchfile.devices_of_run(devices, ["line_voltage"])] == ["supply"]
    assert [device.name for device in benchfile.devices_of_run(devices, ["housing_temperature"])] == [
        "supply",
        "camera",
    ]


def test_a_folder_that_is_not_there_is_told_before_and_after_the_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated-heated.yaml").read_text())
    del bench["emulated"], bench["devices"]["supply"], bench["setup"]
    bench["buses"] = {}
    bench["devices"]["camera"] |= {"on_demand": False}
    (tmp_path / "real.yaml").write_text(yaml.safe_dump(bench, sort_keys=False))
    (tmp_path / "rest.yaml").write_text(REST)
    done = leactl("run", "rest.yaml", "--bench", "real.yaml", "--cold", **os.environ)
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    assert any("warning: camera: there is no folder runs/camera for its exports yet" in line for line in lines)
    assert any(
        "camera: its record is not in the run: no export has come into runs/camera, which" in line for line in lines
    )
