"""A handful of the kills whose hundreds are `python -m tests.kills`."""

import pytest

from tests.driver.transports import CAN
from tests.kills.trial import ServedBench, strike_once

BUSES = ["pty", *(["udp_multicast"] if "udp_multicast" in CAN else [])]
CONSUMER_MS = 1000  # other load on the machine may hold up either process
ATTEMPTS = 3


@pytest.mark.parametrize(
    ("bus", "way"),
    [(BUSES[-1], "kill -9"), (BUSES[0], "SIGSTOP"), (BUSES[-1], "driver call holding the GIL")],
)
def test_a_struck_run_leaves_no_torque_and_a_readable_file(tmp_path, bus, way, monkeypatch):
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path))
    served = ServedBench(tmp_path, bus, CONSUMER_MS)
    try:
        for number in range(ATTEMPTS):
            found = strike_once(served, number, way, 0.3)
            if "void" not in found:
                break
        assert found["faults"] == []
        assert all(0.0 <= seconds <= 1.02 for seconds in found["stop_s"].values())
    finally:
        served.close()
