"""Starting values of a thermal fit, from records of which the truth is known."""

import numpy as np
import pytest

from leactl.analysis.heating.first_guess import LAG_RESOLUTION_S, starting_lag, thin_record
from leactl.analysis.heating.record import HeatingRecord, SupplyRecord

CAPACITANCE, RESISTANCE = 40.0, 0.5  # J/K, ohm


def record(lag_s=0.0, end_s=600.0):
    """A winding that keeps all its heat, heated by a strong and a weak pulse, by a camera whose clock is late."""
    stamps = np.arange(0.0, end_s, 0.05)
    current = np.where((stamps > 100.0) & (stamps < 220.0), 8.0, 0.0)
    current += np.where((stamps > 380.0) & (stamps < 500.0), 2.4, 0.0)  # 30 % of the current, 9 % of the heat
    supply = SupplyRecord(stamps, current, RESISTANCE * current, False)
    frames = np.arange(0.0, end_s, 0.1)
    heat = np.concatenate([[0.0], np.cumsum(0.5 * (supply.heat[1:] + supply.heat[:-1]) * np.diff(stamps))])
    winding = 22.0 + np.interp(frames - lag_s, stamps, heat) / CAPACITANCE
    return HeatingRecord("run", frames, winding, np.full(len(frames), 22.0), winding, supply, None)


@pytest.mark.parametrize("lag_s", [0.0, 3.0, -7.5, 20.0])
def test_the_lag_of_a_clock_to_its_own_pace(lag_s):
    assert starting_lag(record(lag_s)) == pytest.approx(lag_s, abs=0.5 * LAG_RESOLUTION_S)


def test_readings_that_are_averaged_keep_what_is_switched_on():
    whole, thin = record(), thin_record(record())
    assert np.trapezoid(thin.supply.heat, thin.supply.time) == pytest.approx(
        np.trapezoid(whole.supply.heat, whole.supply.time), rel=0.02
    )
    share = [np.mean(item.supply.on) for item in (whole, thin)]
    assert share[1] == pytest.approx(share[0], abs=0.02)
