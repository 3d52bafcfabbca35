"""The network that follows a run: noise stays out, hidden samples stay hidden, and nonsense does not end it."""

import numpy as np
import pytest

from leactl.gap.signals.derived import fitted_temperatures
from leactl.model.motor_schema import Thermal
from leactl.model.thermal_network import ThermalNetwork

from .synthetic import THERMAL

NOMINAL = Thermal(**THERMAL)
AMBIENT = np.full(1500, 24.0)
HEAT = np.where(np.arange(1500) < 900, 18.0, 0.0)
FACTORS = (1.1, 0.9, 1.05, 1.2, 0.95)
TRUE = Thermal(**{name: value * factor for (name, value), factor in zip(THERMAL.items(), FACTORS, strict=True)})


@pytest.fixture
def measured():
    return ThermalNetwork(TRUE, 1.0).temperatures(HEAT, AMBIENT, (24.0, 24.0))


def everything(values):
    return np.ones(values.shape, bool)


def test_a_network_of_other_parameters_is_followed_and_its_noise_is_not(measured):
    noisy = measured + np.random.default_rng(3).normal(0.0, 0.15, measured.shape)
    result = fitted_temperatures(NOMINAL, 1.0, HEAT, AMBIENT, noisy, everything(noisy))
    assert np.sqrt(np.mean((result - measured) ** 2)) < 0.03


def test_samples_that_were_not_measured_do_not_count(measured):
    valid = everything(measured)
    valid[:, 400:500] = False
    spoilt = np.where(valid, measured, 90.0)
    whole, part = (fitted_temperatures(NOMINAL, 1.0, HEAT, AMBIENT, values, valid) for values in (measured, spoilt))
    np.testing.assert_allclose(part, whole)


@pytest.mark.parametrize("share", [0.0, 1e-3, -1.0])
def test_a_heat_that_cannot_be_ends_in_finite_temperatures(measured, share):
    result = fitted_temperatures(NOMINAL, 1.0, share * HEAT, AMBIENT, measured, everything(measured))
    assert np.isfinite(result).all()
