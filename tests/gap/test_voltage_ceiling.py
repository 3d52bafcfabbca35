"""Samples at the ceiling of the voltage: the same for a wye and for the delta that has its leads."""

import math

import numpy as np

from leactl.gap.signals.voltage_ceiling import CEILING_SHARE, at_ceiling
from tests.gap.synthetic import clocked, model


def test_a_delta_is_at_its_ceiling_where_the_wye_with_its_leads_is():
    volts = np.linspace(-1.1, 1.1, 221) * 29.6 / math.sqrt(2.0)
    expected = np.abs(volts) > CEILING_SHARE * 29.6 / math.sqrt(2.0)
    for winding, root in (("wye", 1.0), ("delta", math.sqrt(3.0))):
        clock = clocked(len(volts), 1e-3, {("q_axis_voltage", "test"): root * volts})
        np.testing.assert_array_equal(at_ceiling(clock, model(winding=winding)), expected)
