"""A motor file that heated runs have narrowed keeps its promise, whatever camera and supply were off by meanwhile."""

import math
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leactl.analysis.heating.narrowing import Accuracy, narrow_tolerances
from leactl.errors import AcceptanceFailed, InputError, NotIdentifiable
from leactl.model.motor import load_motor
from leactl.runfile.read.reader import Run
from leactl.runner.commission import MOST_HEAT_GROWTH
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.temperature_bound import ThermalBound
from tests.analysis.heated import HeatedBench, Plant, temperatures

LEA = load_motor("lea")[0]
TOLD, LIMIT, HOLD_S, READ_A = 25.0, 130.0, 4500.0, 8.5
ONE, TWO = (700.0,), (700.0, 1400.0)  # heats that a file is made of [s]
NEEDLESS_K = 20.0  # by which a promise may be too hot; what the air may be off by makes 8 K of it


def drawn(seed):
    """An actuator and instruments in corners of what they may be, and the air then and later."""
    rng = np.random.default_rng(seed)

    def off(most):
        return most * rng.choice([-1.0, 1.0])

    nominal = Plant()
    names = ("Rwa", "Rwh", "Rha", "Cw", "Ch", "line_resistance", "alpha")
    plant = replace(nominal, **{name: getattr(nominal, name) * (1.0 + off(0.1)) for name in names})
    return plant, off(0.02), off(2.0), off(0.02), off(0.005), off(3.0), rng


def heated(folder, seed, heats_s=(700.0,)):
    """Runs of an actuator whose camera and supply are off, with the true current over what the supply reads later.

    From the first run to the second and to later ones, what the supply reads changes by as much as it may.
    """
    plant, gain, zero, supply, repeats, air, rng = drawn(seed)
    bench = HeatedBench(folder, rng, plant)

    def as_read(time, camera, columns):
        for place in camera:
            camera[place] = camera[place] + zero  # the sensor of the air as well
        changed = 1.0 + (repeats if bench.count == 2 else 0.0)
        columns["line_current"] = columns["line_current"] / (1.0 + supply) * changed
        columns["line_voltage"] = columns["line_voltage"] * changed

    paths = [
        bench.run(
            rate_Hz=2.0, heat_s=heat_s, cool_s=1600.0, current=8.0, ambient=TOLD - air, gain=1.0 + gain, edit=as_read
        )
        for heat_s in heats_s
    ]
    return paths, plant, (1.0 + supply) * (1.0 + repeats), TOLD + air


def narrowed_by(paths, accuracy=None):
    with ExitStack() as files:
        return narrow_tolerances(LEA, [files.enter_context(Run.open(path)) for path in paths], accuracy or Accuracy())


def bound_of(motor):
    """Bound of the hottest phase [degC] after a hold at the current that the supply reads."""
    own = motor.tolerances
    box = Box.of(motor.model_copy(update={"tolerances": own.model_copy(update={"current": own.line_current})}))
    bound = ThermalBound([box], TOLD + own.ambient_K)
    bound.step(HOLD_S, np.array([2.0 * READ_A**2]), np.array([0.5]), np.zeros(1), TOLD, delay=0.0)
    return float(bound.hottest()[0]), box


@pytest.mark.parametrize(
    ("seed", "heats_s"),  # among the seeds both signs of each of the instruments' errors
    [(0, ONE), (1, ONE), (3, ONE), (5, ONE), *(pytest.param(seed, TWO, marks=pytest.mark.long) for seed in range(8))],
)
def test_no_actuator_passes_its_limit_at_a_current_that_its_narrowed_file_admits(tmp_path, seed, heats_s):
    paths, plant, true_over_read, air = heated(tmp_path, seed, heats_s)
    bound, box = bound_of(narrowed_by(paths))
    rows = round(HOLD_S / 10.0) + 1
    hottest = temperatures(plant, np.full(rows, READ_A * true_over_read), np.full(rows, air), 10.0)[-1].max()
    stops = box.limit(math.inf, TOLD)  # the bound, at which the true temperature may be at the limit
    may_be = LIMIT + (bound - stops) / (1.0 - box.temperature_rise)
    assert may_be - NEEDLESS_K < hottest <= may_be


def test_the_current_of_another_instrument_bears_the_tolerance_of_the_supply_as_well(tmp_path):
    own = narrowed_by(heated(tmp_path, 0)[0]).tolerances
    assert own.line_current == 0.005
    assert 1.0 + own.current == pytest.approx(1.02 / 0.98, abs=0.001)
    assert (own.viscous_damping, own.ambient_K) == (LEA.tolerances.viscous_damping, LEA.tolerances.ambient_K)


def narrowed_by_two(folder, volts, amperes):
    """The file by two runs of one supply, whose voltage and current in the second are off by these shares."""
    bench = HeatedBench(folder, np.random.default_rng(4))

    def as_read(_time, _camera, columns):
        if bench.count == 2:
            columns["line_voltage"] = columns["line_voltage"] * (1.0 + volts)
            columns["line_current"] = columns["line_current"] * (1.0 + amperes)

    paths = [bench.run(rate_Hz=1.0, heat_s=heat_s, cool_s=1600.0, edit=as_read) for heat_s in (700.0, 1400.0)]
    return narrowed_by(paths)


def test_a_supply_may_read_otherwise_in_the_next_run_by_what_is_told_of_it(tmp_path):
    steady, changed = (
        narrowed_by_two(tmp_path / str(volts), volts, amperes) for volts, amperes in ((0.0, 0.0), (0.004, -0.005))
    )
    assert changed.tolerances == steady.tolerances
    for name, value in steady.thermal.model_dump().items():
        assert getattr(changed.thermal, name) == pytest.approx(value, rel=1e-4)
    assert changed.phase_resistance == pytest.approx(steady.phase_resistance, rel=1e-4)


@pytest.mark.parametrize(("volts", "amperes", "quantity"), [(0.01, 0.01, "heat"), (0.01, -0.01, "resistance")])
def test_another_supply_in_the_second_run_is_told_by_what_it_changes(tmp_path, volts, amperes, quantity):
    told = rf"0002.h5: the {quantity} by the supply's readings is [+-][12].\d\d% off that"
    with pytest.raises(InputError, match=told):
        narrowed_by_two(tmp_path, volts, amperes)


def test_a_camera_is_off_by_a_share_of_the_rise_or_by_kelvins_whichever_is_more(tmp_path):
    [path] = heated(tmp_path, 1)[0]
    with Run.open(path) as run:
        rise = max(np.ptp(channel.values) for channel in run.channels("winding_temperature"))
    assert 2.0 / rise > 0.02
    for accuracy, share in (
        (Accuracy(), 2.0 / rise),
        (Accuracy(camera_offset=0.1), 0.02),
        (Accuracy(camera_gain=0.005, camera_offset=0.1), 0.005),
    ):
        assert narrowed_by([path], accuracy).tolerances.temperature_rise == pytest.approx(share, abs=0.0021)


def test_what_the_camera_s_zero_does_to_the_resistance_is_in_its_tolerance(tmp_path):
    [path] = heated(tmp_path, 1)[0]
    plain, sure = narrowed_by([path]), narrowed_by([path], Accuracy(camera_offset=0.1))
    widened = plain.tolerances.phase_resistance - sure.tolerances.phase_resistance
    assert widened == pytest.approx(1.9 * LEA.resistance_coefficient, abs=0.0015)


def test_what_two_bodies_do_not_explain_widens_the_rise(tmp_path):
    path = HeatedBench(tmp_path).run(rate_Hz=2.0, heat_s=700.0, cool_s=1600.0, current=8.0, drift=0.2)
    quiet = Accuracy(camera_offset=0.1)
    assert narrowed_by([path], quiet).tolerances.temperature_rise > quiet.camera_gain + 0.005


def test_an_actuator_outside_of_its_tolerances_is_refused_with_the_figure(tmp_path):
    bench = HeatedBench(tmp_path, plant=Plant(Rha=2.3))
    path = bench.run(rate_Hz=2.0, heat_s=700.0, cool_s=2400.0, current=7.0)
    with pytest.raises(AcceptanceFailed, match=r"housing_ambient_resistance 2\.\d+, 1\.428 to 1\.972 was expected"):
        narrowed_by([path])


def test_a_run_that_is_too_short_narrows_nothing(tmp_path):
    path = HeatedBench(tmp_path).run(rate_Hz=2.0, heat_s=200.0, cool_s=200.0, current=8.0)
    with pytest.raises(NotIdentifiable, match=r"housing_ambient_resistance.*; heat and cool for longer"):
        narrowed_by([path])


def test_what_two_leads_of_a_delta_heat_is_not_known(tmp_path):
    [path] = heated(tmp_path, 2)[0]
    with Run.open(path) as run, pytest.raises(InputError, match="a delta; how two leads heat it"):
        narrow_tolerances(LEA.model_copy(update={"winding": "delta"}), [run], Accuracy())


def test_a_motor_file_without_tolerances_has_none_to_narrow(tmp_path):
    [path] = heated(tmp_path, 2)[0]
    with Run.open(path) as run, pytest.raises(InputError, match="no `tolerances:` to narrow"):
        narrow_tolerances(LEA.model_copy(update={"tolerances": None}), [run], Accuracy())


def test_the_shares_that_the_page_tells_are_those_of_the_code():
    text = " ".join((Path(__file__).parents[2] / "docs" / "explanation" / "thermal.md").read_text().split())
    own, told = LEA.tolerances, Accuracy()
    shifted = 100.0 * LEA.resistance_coefficient * told.camera_offset
    assert f"what {told.camera_offset:g} K of the camera's zero do to it ({shifted:g} %)" in text
    assert f"the camera's gain ({100.0 * told.camera_gain:g} %, and no less than {told.camera_offset:g} K" in text
    assert f"changes by from run to run ({100.0 * told.current_repeats:g} %)" in text
    both = 100.0 * ((1.0 + own.current) / (1.0 - own.current) - 1.0)
    assert f"{both:.1f} % for {100.0 * own.current:g} % and {100.0 * own.current:g} %" in text
    lowered = replace(Box.of(LEA), temperature_rise=told.camera_gain).limit(math.inf, TOLD)
    assert f"by {100.0 * told.camera_gain:g} % the guard stops at {lowered:.1f} degC in place of {LIMIT:g}" in text
    assert f"more than {MOST_HEAT_GROWTH:g} times as long as the longest before it" in text
