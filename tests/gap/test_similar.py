"""One bench at another size or another rate gets the same answer: nothing in a diagnosis has a unit of its own."""

from dataclasses import replace

import numpy as np
import pytest

from leactl.emulation.blind.make import make
from leactl.gap.diagnose import Case, diagnose, read_case
from leactl.gap.equations import equations
from leactl.gap.signals.record import smallest_step

SIZES = [(20.0, 2.0, 1.6), (0.02, 0.4, 0.5)]  # torque, current and time over those of the bench
EFFECTS = ("torque_ripple", "velocity_filter_lag", "third_thermal_node", "current_sensor_offset", "stribeck")


def factor(units, torque, current, time):
    volt = torque / (current * time)
    return {"A": current, "V": volt, "rad": 1.0, "degC": 1.0, "rad/s": 1.0 / time, "N*m": torque}[units]


def rescaled_clock(clock, torque, current, time):
    if clock is None:
        return None
    units = {key: "A" if key[0].endswith("_current") else "V" for key in clock.values} | clock.units
    by = {key: factor(units[key], torque, current, time) for key in clock.values}
    between = {key: (stamps * time, values * by[key]) for key, (stamps, values) in clock.between.items()}
    values = {key: values * by[key] for key, values in clock.values.items()}
    return replace(clock, time=clock.time * time, interval=clock.interval * time, values=values, between=between)


def rescaled_model(model, torque, current, time):
    volt, power = torque / (current * time), torque / time
    thermal = {
        name: value * (power * time if name.endswith("capacitance") else 1.0 / power)
        for name, value in model.thermal.model_dump().items()
    }
    bench = {
        "bus_voltage": volt,
        "current_loop_bandwidth": 1.0 / time,
        "velocity_filter_bandwidth": 1.0 / time,
        "torque_filter_bandwidth": 1.0 / time,
        "setpoint_lead_time": time,
        "shaft_stiffness": torque,
    }
    own = {
        "phase_resistance": volt / current,
        "phase_inductance": volt * time / current,
        "torque_constant": torque / current,
        "back_emf_constant": torque / current,
        "rotor_inertia": torque * time**2,
        "viscous_damping": torque * time,
        "coulomb_friction": torque,
    }
    return model.model_copy(
        update={
            **{name: getattr(model, name) * by for name, by in own.items()},
            "thermal": type(model.thermal)(**thermal),
            "bench": model.bench.model_copy(
                update={
                    name: getattr(model.bench, name) * by for name, by in bench.items() if getattr(model.bench, name)
                }
            ),
        }
    )


def rescaled(case, *size):
    records = [
        [replace(run, fast=rescaled_clock(run.fast, *size), slow=rescaled_clock(run.slow, *size)) for run in runs]
        for runs in (case.fitted, case.held_out)
    ]
    return Case(rescaled_model(case.model, *size), *records)


def thinned_clock(clock):
    """Every second sample; means over two."""
    if clock is None:
        return None
    rows = len(clock.time) // 2 * 2

    def half(key, values):
        if key in clock.means:
            return values[:rows].reshape(-1, 2).mean(axis=1)
        return values[1:rows:2]

    values = {key: half(key, column) for key, column in clock.values.items()}
    return replace(
        clock,
        time=clock.time[1:rows:2],
        interval=2.0 * clock.interval,
        values=values,
        valid={key: mask[1:rows:2] for key, mask in clock.valid.items()},
        counts={key: smallest_step(values[key]) for key in clock.counts},
    )


def thinned(case):
    records = [[replace(run, fast=thinned_clock(run.fast)) for run in runs] for runs in (case.fitted, case.held_out)]
    return Case(case.model, *records)


def read(folder):
    return read_case(sorted(folder.glob("*-a.h5")), sorted(folder.glob("*-b.h5")), folder / "nominal.yaml")


@pytest.fixture(scope="module")
def sound(sound_bench):
    return read(sound_bench)


@pytest.fixture(scope="module")
def with_effects(tmp_path_factory):
    folder = tmp_path_factory.mktemp("effects")
    count, key = len(EFFECTS), folder / "key"
    make(count, folder / "cases", key, 41, ("single",), EFFECTS, strengths=("plain",), prefix="one")
    return [read(path) for path in sorted((folder / "cases").iterdir()) if path.is_dir()]


def named(case):
    diagnosis = diagnose(case)
    return diagnosis.verdict, {cause.effect for cause in diagnosis.causes if cause.probability >= 0.5}


def test_a_sound_bench_of_another_size_is_sound(sound):
    assert named(rescaled(sound, *SIZES[0])) == ("calibration", set())


def test_a_sound_bench_at_half_the_rate_is_sound(sound):
    assert named(thinned(sound)) == ("calibration", set())


@pytest.mark.parametrize("size", SIZES)
def test_what_an_equation_leaves_to_chance_scales_with_the_machine(sound, size):
    """Stamps, lags, swings and zeros, each as large as its prior has it, in the units of the equation."""
    other = rescaled(sound, *size)
    for one, alike in zip(sound.fitted, other.fitted, strict=True):
        pairs = zip(
            equations(replace(one, slow=None), sound.model),
            equations(replace(alike, slow=None), other.model),
            strict=True,
        )
        for first, second in pairs:
            by = factor(first.units, *size)
            np.testing.assert_array_equal(second.mask, first.mask, err_msg=first.name)
            for name, (column, prior) in (first.nuisance | first.shared).items():
                again, own = (second.nuisance | second.shared)[name]
                tiny = 1e-6 * prior * float(np.max(np.abs(column)))
                np.testing.assert_allclose(own * again / by, prior * column, atol=tiny, err_msg=name)


@pytest.mark.long
@pytest.mark.parametrize("number", range(len(EFFECTS)))
@pytest.mark.parametrize("change", [*(lambda case, size=size: rescaled(case, *size) for size in SIZES), thinned])
def test_an_effect_is_named_at_any_size_and_at_half_the_rate(with_effects, number, change):
    case = with_effects[number]
    assert named(change(case)) == named(case)
