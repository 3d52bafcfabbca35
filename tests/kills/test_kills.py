"""A handful of the kills whose hundreds are `python -m tests.kills`."""

import pytest

from tests.driver.transports import CAN
from tests.kills.trial import ServedBench, strike_once

BUSES = ["pty", *(["udp_multicast"] if "udp_multicast" in CAN else [])]
CONSUMER_MS = 1000  # other load on the machine may hold up either process
ATTEMPTS = 3  # a run may end by itself, for the same reason, before it is struck


@pytest.fixture
def struck(tmp_path, monkeypatch):
    """What became of a run that was struck so."""
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path))

    def strike(bus, names, *changes):
        served = ServedBench(tmp_path, bus, CONSUMER_MS, *changes)
        try:
            for number in range(ATTEMPTS):
                result = strike_once(served, number, names, 0.3)
                if "void" not in result:
                    return result
            raise AssertionError(result["void"])
        finally:
            served.close()

    return strike


@pytest.mark.parametrize(
    ("bus", "way"),
    [
        (BUSES[-1], ["SIGSTOP, watchdog too"]),
        (BUSES[0], ["SIGSTOP"]),
        (BUSES[-1], ["driver call holding the GIL"]),
        (BUSES[-1], ["no room for the file"]),
        *(
            pytest.param(bus, way, marks=pytest.mark.long)  # two strikes at once
            for bus, way in (
                (BUSES[-1], ["latch a pipe", "driver call broken"]),
                (BUSES[-1], ["watchdog killed", "driver call spinning"]),
                (BUSES[0], ["watchdog stopped", "driver call holding the GIL"]),
            )
        ),
    ],
)
def test_a_struck_run_leaves_no_torque_a_readable_file_and_its_bench_latched(struck, bus, way):
    result = struck(bus, way)
    assert result["faults"] == []
    assert all(0.0 <= seconds <= 1.02 for seconds in result["stop_s"].values())


@pytest.mark.parametrize("bus", [*(pytest.param(bus, marks=pytest.mark.long) for bus in BUSES[:-1]), BUSES[-1]])
def test_a_killed_run_is_stopped_by_its_watchdog_where_the_drives_dead_man_fails(struck, bus):
    assert struck(bus, ["kill -9"], "without-dead-man")["faults"] == []


def test_a_hung_run_is_stopped_by_its_watchdog_where_the_drives_dead_man_fails(struck):
    result = struck(BUSES[-1], ["driver call sleeping"], "without-dead-man")
    assert all(1.0 <= seconds <= 3.0 for seconds in result["stop_s"].values())
