"""The driver through NI's own package, unmodified, on a stand-in for the C library below it."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from leactl_plugins.ni_daq.acquisition import ERRORS, OVERRUNS

HERE = Path(__file__).parent / "nidaqmx_stand_in"
COMPILER = shutil.which("cc") or shutil.which("gcc")
pytestmark = pytest.mark.skipif(
    COMPILER is None or not sys.platform.startswith("linux"), reason="no C compiler to build the stand-in library with"
)
INPUTS = [
    {"name": name, "quantity": f"phase_voltage_{name}", "channel": f"ai{place}", "scale_per_V": 2.0}
    for place, name in enumerate(("ab", "bc", "ca"))
]
COUNT = 10.0 / 32768


CASES = {
    "coerced": {"rate_Hz": 9993.0},
    "finite": {"reads": 6, "duration_s": 0.05},
    "overrun": {"reads": 5, "fail": "ReadAnalogF64:-200279:2"},
}
REFUSALS = {
    "-200220 (INVALID_DEVICE_ID): no such device": {"device": "Dev2"},
    "-200170 (PHYSICAL_CHAN_DOES_NOT_EXIST)": {"inputs": [INPUTS[0] | {"channel": "ai40"}]},
    "-200332 (SAMP_RATE_TOO_HIGH)": {"rate_Hz": 200000.0},
    "'Dev1' is a USB-6218; USB-6211 was expected": {"product": "USB-6211"},
    "-201003 (DEV_CANNOT_BE_ACCESSED): the device is gone": {"fail": "GetReadAttribute:-201003:2"},
    "-50103 (PAL_RESOURCE_RESERVED): another program holds the device": {"fail": "StartTask:-50103:1"},
    "-200999: Stand-in text.": {"fail": "StartTask:-200999:1"},
    "no sample for 1": {"samples": 0, "reads": 60},
}


def run(cases, folder):
    """What the driver tells of each case, in one process with the libraries of a folder."""
    ordered = []
    for case in cases:
        settings = {"library": "nidaqmx", "inputs": INPUTS} | case
        reads, fail, samples = settings.pop("reads", 4), settings.pop("fail", ""), settings.pop("samples", 200)
        ordered.append({"settings": settings, "reads": reads, "fail": fail, "samples": samples})
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "tests.driver.nidaqmx_stand_in"],
        input=json.dumps(ordered),
        env=os.environ | {"LD_LIBRARY_PATH": str(folder)},
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    answer = json.loads(done.stdout)
    result = answer["acquired"]
    for told in result:
        blocks = told.pop("blocks")
        told["time"] = np.array([moment for times, _ in blocks for moment in times])
        told["values"] = np.array([row for _, values in blocks for row in values], float)
    return result, answer["doctor"]


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """What the driver tells of every case, by its name."""
    folder = tmp_path_factory.mktemp("nidaqmx")
    flags = ["-shared", "-fPIC", "-Wall", "-Werror", "-Wl,-soname,libnidaqmx.so"]
    subprocess.run([COMPILER, *flags, "-o", folder / "libnidaqmx.so", HERE / "libnidaqmx.c", "-lm"], check=True)
    cases = CASES | REFUSALS
    found, doctor = run(cases.values(), folder)
    return dict(zip(cases, found, strict=True)) | {"doctor": doctor}


def test_samples_come_in_order_scaled_and_stamped_by_the_coerced_clock(told):
    told = told["coerced"]
    rate = 20e6 / 2001  # what the device makes of 9993 Hz
    number = np.arange(600)
    np.testing.assert_allclose(told["time"], number / rate, atol=1e-12)
    np.testing.assert_allclose(told["values"], 2.0 * (np.arange(1, 4) + COUNT * number[:, np.newaxis]), rtol=1e-12)
    np.testing.assert_allclose(told["skews"], [0.0, 14e-6, 28e-6])
    assert told["identity"] == ["NI USB-6218", "1A2B3C4", ""]
    assert told["notices"] == [
        "USB-6218 samples at 9995.0025 Hz, 9993 Hz were asked for, each input 14 us after the one before"
    ]


def test_a_finite_acquisition_ends_with_its_last_sample(told):
    told = told["finite"]
    assert len(told["time"]) == 500
    assert told["notices"][-1] == "the acquisition of 500 samples is complete"
    assert told["error"] == ""


def test_what_an_overrun_lost_is_nan_and_told(told):
    told = told["overrun"]
    gap = np.isnan(told["values"]).all(axis=1)
    assert np.flatnonzero(gap).tolist() == list(range(200, 400))  # from the last sample to the new start at 40 ms
    assert np.isfinite(told["values"][~gap]).all()
    np.testing.assert_allclose(told["values"][~gap][200, 0], 2.0)  # the new acquisition begins at its first sample
    assert (np.diff(told["time"]) > 0.99e-4).all()
    assert told["notices"][1].startswith("200 samples are lost, and NaN, after NI-DAQmx -200279 (SAMPLES_NO_LONGER_AV")


@pytest.mark.parametrize("said", REFUSALS)
def test_errors_are_named_with_what_to_do(told, said):
    assert told[said]["error"].startswith("5: daq: ")
    assert said in told[said]["error"]


def test_doctor_tells_the_driver_and_its_devices(told):
    assert told["doctor"] == ["24.8: Dev1 (USB-6218)"]


def test_codes_have_the_names_of_the_package():
    from nidaqmx.error_codes import DAQmxErrors

    assert {code: name for code, (name, _) in ERRORS.items()} == {code: DAQmxErrors(code).name for code in ERRORS}
    assert set(OVERRUNS) < set(ERRORS)


def test_without_the_driver_it_is_said_and_nothing_takes_its_place(tmp_path):
    (told,), doctor = run([{}], tmp_path)
    assert doctor == ["NI's driver is not installed"]
    assert told["error"].startswith("5: daq: NI-DAQmx is not installed on this machine")
    assert len(told["values"]) == 0
