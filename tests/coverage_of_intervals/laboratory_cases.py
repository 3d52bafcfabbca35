"""What each seed of `laboratory` measures: runs from equations at the shipped protocols' levels, lengths and rates.

`noise` has what a good bench has: noise, steps of readings, zeros and scatter of friction. In `instruments` readings
are off by what the analysis is told of their uncertainty. Other cases are named after what is special about them.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests.analysis import back_driven, envelopes, free_rotors, open_leads, pulses, run_outs, warmed, weights
from tests.analysis.synthetic import Bench

CURRENT_STEP = 11186e-6 * math.sqrt(1.5)  # A, a thousandth of the drive's rated current
SPEED_STEP = 2.0 * math.pi / 40_000  # rad/s, a count a second
TORQUE_STEP = 6.144 / 32768 * 3.0  # N*m, an ADS1115 at +-6.144 V and 3 N*m/V
STEPS = {"q_axis_current": CURRENT_STEP, "velocity": SPEED_STEP, "torque": TORQUE_STEP}
NOISE = {"q_axis_current": 0.015, "velocity": 0.002, "torque": 0.004}
KT_STD, TORQUE_STD, CURRENT_STD = 0.01, 0.01, 0.005  # relative


@dataclass(frozen=True)
class Made:
    """A run, what is true of it, and what its analysis is told.

    A truth of NaN is none, as the phase of a harmonic that is not there; `bounds` are results of which one end counts.
    """

    path: Path
    true: Mapping[str, float]
    told: Mapping[str, float] = field(default_factory=dict)
    bounds: frozenset[str] = frozenset()


def steps_of(*quantities: str) -> dict[str, float]:
    return {name: STEPS[name] for name in quantities}


def drawn(rng: np.random.Generator, *sizes: float) -> list[float]:
    """An actuator of its own for each seed: steps of readings fall elsewhere."""
    return [size * rng.uniform(0.9, 1.1) for size in sizes]


def no_load_loss(bench: Bench, *, off=0.0, coarse=False) -> Made:
    """`off` is the standard uncertainty of what the analysis is told; `coarse`: steps of current, hardly any noise."""
    rng = bench.rng
    f, b, c = drawn(rng, free_rotors.F, free_rotors.B, free_rotors.C)
    speeds = (2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0)
    path = free_rotors.turned(
        bench,
        f=f,
        b=b,
        c=c,
        speeds=speeds + speeds[::-1],
        trials=3,
        zero_A=rng.normal(0.0, 0.02),
        gain=1.0 + rng.normal(0.0, off),
        scatter=0.0 if coarse else 0.003,
        noise=NOISE | ({"q_axis_current": 0.001} if coarse else {}),
        resolution=steps_of("q_axis_current", "velocity"),
        rate_Hz=100,
        hold_s=2.0,
        settle_s=1.0,
    )
    true = {"coulomb_friction": f, "viscous_damping": b, "quadratic_drag": c}
    true |= {"no_load_loss": 35 * f + 35**2 * b + 35**3 * c, "hysteresis_torque": f, "eddy_damping": b}
    if not off:
        return Made(path, true, bounds=frozenset({"hysteresis_torque", "eddy_damping"}))
    told = {"torque_constant": free_rotors.KT, "torque_constant_std": off * free_rotors.KT}
    for name, alone, std in (("friction", 0.9 * f, 0.004), ("damping", 0.8 * b, 0.0004)):
        told |= {f"mechanical_{name}": alone + rng.normal(0.0, std), f"mechanical_{name}_std": std}
    return Made(path, true | {"hysteresis_torque": 0.1 * f, "eddy_damping": 0.2 * b}, told)


def coast_down(bench: Bench, *, off=0.0, trials=5, coarse=False) -> Made:
    rng = bench.rng
    j, f, b, c = drawn(rng, run_outs.J, run_outs.F, run_outs.B, run_outs.C)
    path = run_outs.coasting(
        bench,
        j=j,
        f=f,
        b=b,
        c=c,
        trials=trials,
        zero_A=rng.normal(0.0, 0.02),
        gain=1.0 + rng.normal(0.0, off),
        scatter=0.0 if coarse else 0.003,
        noise=NOISE["velocity"],
        current_noise=0.001 if coarse else NOISE["q_axis_current"],
        held_s=1.5,
        resolution=steps_of("q_axis_current", "velocity"),
    )
    true = {"rotor_inertia": j, "coulomb_friction": f, "viscous_damping": b, "quadratic_drag": c}
    true |= {"coulomb_over_inertia": f / j, "damping_over_inertia": b / j, "quadratic_over_inertia": c / j}
    told = {"torque_constant": run_outs.KT, "torque_constant_std": off * run_outs.KT} if off else {}
    return Made(path, true, told)


def back_drive(bench: Bench, *, off=0.0, cogging=back_driven.COG) -> Made:
    rng = bench.rng
    path = back_driven.driven(
        bench,
        trials=3,
        cogging=cogging,
        ripple=0.05 * cogging / back_driven.COG,
        zero=rng.normal(0.0, 0.02),
        gain=1.0 + rng.normal(0.0, off),
        breakaway_scatter=0.004,
        scatter=0.002,
        inertia=back_driven.J * (1.0 + rng.normal(0.0, 0.1)),  # a drawing's, as the analysis takes it to be
        resolution=steps_of("torque", "velocity"),
    )
    true = {"breakaway_torque": 0.25, "coulomb_friction": back_driven.F, "viscous_damping": back_driven.B}
    true |= {"quadratic_drag": back_driven.C, "cogging_amplitude": cogging, "cogging_peak_to_peak": 2.0 * cogging}
    seen = cogging == back_driven.COG
    bounds = frozenset() if seen else frozenset({"cogging_amplitude", "cogging_peak_to_peak"})
    return Made(path, true, {"torque_gain_std": off} if off else {}, bounds)


def torque_pulses(bench: Bench, *, off=(0.0, 0.0), loss=0.1) -> Made:
    rng, sticking = bench.rng, 0.1
    path = pulses.pulsed(
        bench,
        loss=loss,
        sticking=sticking,
        ringing=rng.uniform(-0.03, 0.03),
        offset=rng.normal(0.0, 0.02),
        trials=3,
        scatter=0.01,
        gains=tuple(1.0 + rng.normal(0.0, std) for std in off),
        noise=NOISE,
        resolution=steps_of("q_axis_current", "torque"),
        rate_Hz=200,
        hold_s=0.2,
        settle_s=0.05,
    )
    straight = 28.0 * math.sqrt((0.98**-2 - 1.0) / ((1.0 - loss) ** -2 - 1.0))
    true = {"torque_constant": pulses.KT, "torque_at_peak": pulses.KT * 28.0 * (1.0 - loss), "loss_at_peak": loss}
    true |= {"straight_up_to": straight, "sticking_torque": sticking}
    told = dict(zip(("torque_gain_std", "current_gain_std"), off, strict=True)) if any(off) else {}
    return Made(path, true, told, frozenset({"torque_at_peak"} | ({"straight_up_to"} if straight > 28.0 else set())))


def torque_speed_envelope(bench: Bench, *, off=0.0, trials=2, kelvin=0.0) -> Made:
    """`kelvin` is by how much more each trial finds the winding warm at rest; a hold at 28 A takes it further."""
    rng, kt, f, b = bench.rng, envelopes.KT, envelopes.F, envelopes.B
    speeds = (5.0, 10.0, 15.0, 20.0, 24.0, 27.0, 30.0, 33.0, 36.0)
    hold = kelvin * rng.uniform(0.9, 1.1)  # by the same heat into the same copper in each trial
    heat = [(kelvin * trial * rng.uniform(0.8, 1.2), hold) for trial in range(trials)]
    path = envelopes.driven(
        bench,
        speeds=speeds,
        trials=trials,
        warmed=heat,
        scatter=0.002,
        slowing=rng.uniform(0.1, 0.6),
        zero=rng.normal(0.0, NOISE["torque"] / 10.0),  # tared by 100 readings
        gain=1.0 + rng.normal(0.0, off),
        model=envelopes.model_of(*(size * (1.0 + rng.normal(0.0, 0.1)) for size in (envelopes.J, envelopes.L))),
        noise=NOISE | {"bus_voltage": 0.0},
        resolution=STEPS,
        rate_Hz=100,
        hold_s=1.0,
        settle_s=0.8,
        before_s=1.0,
    )
    currents = [envelopes.current_at(27.0, warmed=lambda i, own=own: own[0] + own[1] * (i / 28.0) ** 2) for own in heat]
    true = {
        "highest_torque": kt * 28.0 - f - 5.0 * b,
        "highest_power": 27.0 * (kt * float(np.mean(currents)) - f - 27.0 * b),
        "corner_speed": float(np.mean([envelopes.true_corner(sum(own)) for own in heat])),
    }
    bounds = {"corner_speed"} if trials == 1 else set()  # too few holds for more than its neighbours
    bounds |= {"highest_power"} if kelvin else set()  # repeats differ by the warmth of the winding, and do not scatter
    return Made(path, true, {"torque_gain_std": off} if off else {}, frozenset(bounds))


def torque_sensor_calibration(bench: Bench, *, told=weights.KNOWN_STDS) -> Made:
    """Nothing told: the weights' torque is off by anything that the analysis then takes it to be."""
    rng = bench.rng
    if told:
        stds = np.array([told["gravity_std"] / 9.81, told["mass_relative_std"], told["arm_std_m"] / weights.ARM])
        off = float(rng.normal(0.0, 1.0, 3) @ stds)
    else:
        off = float(rng.uniform(-1.0, 1.0, 3) @ np.array([0.026 / 9.80665, 5e-4, 0.2e-3 / weights.ARM]))
        off += 9.80665 / weights.GRAVITY - 1.0
    drift = rng.normal(0.0, 0.002)
    path = weights.weighed(
        bench,
        masses=(0.56, 1.12, 1.68, 2.24, 2.8),
        gain=1.01,
        zero=0.02,
        scatter=0.003,
        drift=drift,
        hysteresis=0.004,
        noise=NOISE["torque"],
        step=TORQUE_STEP,
        off=off,
        hold_s=8.0,
        rate_Hz=50,
    )
    true = {"sensitivity": 1.01, "zero": 0.02 + 0.5 * drift}
    return Made(path, true, {"gravity": weights.GRAVITY, **told} if told else {})


def winding_rise(bench: Bench, *, off=(0.0, 0.0), noise=0.0) -> Made:
    """The display's steps of 10 mV are most of it; the coefficient of copper is within 10 %, the air within 1 K."""
    rng = bench.rng
    alpha, cold = warmed.ALPHA * (1.0 + rng.uniform(-0.1, 0.1)), rng.normal(25.0, 1.0)
    gains = tuple(1.0 + rng.normal(0.0, std) for std in off)
    amperes = rng.uniform(7.5, 8.5)
    leads = warmed.LEADS * rng.uniform(0.9, 1.1)
    path = warmed.warmed(
        bench,
        amperes=amperes,
        alpha=alpha,
        cold=cold,
        leads=leads,
        gains=gains,
        noise=noise,
        air=[25.0] * 10,
        model=warmed.MODEL.replace("resistance_coefficient: 0.0}", "resistance_coefficient: 0.1}"),
    )
    kelvin, minute = warmed.rise(np.arange(4470.0, 4500.0)), np.arange(4440.0, 4500.0)
    last = warmed.rise(minute)
    true = {
        "cold_resistance": leads * (1.0 + alpha * (cold - 25.0)),
        "hot_resistance": leads * float(np.mean(1.0 + alpha * (cold - 25.0 + kelvin))),
        "winding_rise": float(np.mean(kelvin)),
        "change_in_last_30_min": float(np.mean(last - warmed.rise(minute - 1800.0))),
    }
    return Made(path, true, dict(zip(("voltage_gain_std", "current_gain_std"), off, strict=True)) if any(off) else {})


def back_emf(bench: Bench, *, uneven=True, harmonics=True) -> Made:
    """The converter's scale and quartz are off by what the analysis takes them to be."""
    rng, scale, clock = bench.rng, 150e-6, 50e-6
    pairs = rng.permutation([1.002, 1.0, 0.998]) if uneven else np.ones(3)
    common, fast = 1.0 + rng.normal(0.0, scale), 1.0 + rng.uniform(-clock, clock)
    shares = {5: (0.03, rng.uniform(-3.0, 3.0)), 7: (0.01, rng.uniform(-3.0, 3.0))} if harmonics else {}
    speed, kb = open_leads.SPEED, open_leads.KB
    path = open_leads.OpenLeads(bench.directory, rng).run(
        kb=kb * fast,
        speeds=(speed / fast,),
        seconds=5.0,
        gains=tuple(common * pairs),
        scale_std=scale,
        harmonics=[(order, share, phase) for order, (share, phase) in shares.items()],
    )
    line = math.sqrt(2.0) * kb
    true = {"back_emf_constant": kb, "line_to_line_constant": line, "unevenness": float(np.ptp(pairs))}
    true |= {
        f"line_to_line_constant_{name}": line * float(pair) for name, pair in zip(open_leads.PAIRS, pairs, strict=True)
    }
    true |= {"pole_pairs": 41.0, "electrical_frequency": 41.0 * speed / (2.0 * math.pi), "torque_constant_ratio": 1.0}
    true["total_harmonic_distortion"] = math.hypot(*(share for share, _ in shares.values())) if shares else 0.0
    true |= {f"harmonic_{order}": shares.get(order, (0.0, 0.0))[0] for order in (2, 3, 5, 7, 11, 13)}
    true |= {f"harmonic_{order}_phase": shares.get(order, (0.0, math.nan))[1] for order in (2, 3, 5, 7, 11, 13)}
    bounds = {name for name, value in true.items() if value == 0.0} | {"pole_pairs"}
    told = {"torque_constant": kb * (1.0 + rng.normal(0.0, 0.002)), "torque_constant_std": 0.002 * kb}
    return Made(path, true, told, frozenset(bounds))


def torque_constant(bench: Bench, *, off=(0.0, 0.0)) -> Made:
    """`off`: standard uncertainties of the readings of torque and current."""
    rng = bench.rng
    kt, stuck = drawn(rng, 0.49, 0.2)
    of_torque, of_current = (1.0 + rng.normal(0.0, std) for std in off)
    offset = rng.normal(0.0, 0.05)
    path = bench.torque(
        kt=of_torque / of_current * kt,
        sticking=of_torque * stuck,
        offset=offset,
        trials=5,
        scatter=0.005,
        noise=NOISE,
        resolution=steps_of("q_axis_current", "torque"),
        rate_Hz=100,
    )
    true = {"torque_constant": kt, "torque_constant_rising": kt, "torque_constant_falling": kt}
    told = dict(zip(("torque_gain_std", "current_gain_std"), off, strict=True)) if any(off) else {}
    return Made(path, true | {"sticking_torque": stuck, "offset": offset}, told)


def friction(bench: Bench, *, off=0.0) -> Made:
    rng = bench.rng
    f, b = drawn(rng, 0.208, 0.0238)
    zero = rng.normal(0.0, 0.01)
    gain = 1.0 + rng.normal(0.0, off)
    path = bench.friction(
        b=b,
        f=f,
        kt=0.49 / gain,
        zero_A=zero,
        trials=5,
        scatter=0.001,
        noise=NOISE,
        resolution=steps_of("q_axis_current", "velocity"),
        rate_Hz=100,
    )
    true = {"offset": 0.49 * zero}
    for suffix, share in {"": 0.0, "_forward": 0.49 * zero, "_backward": -0.49 * zero}.items():
        true |= {f"viscous_damping{suffix}": b, f"coulomb_friction{suffix}": f + share}
    return Made(path, true, {"current_gain_std": off} if off else {})


CASES: dict[str, dict[str, Callable[[Bench], Made]]] = {
    "no-load-loss": {
        "noise": no_load_loss,
        "coarse": lambda bench: no_load_loss(bench, coarse=True),
        "instruments": lambda bench: no_load_loss(bench, off=KT_STD),
    },
    "coast-down": {
        "noise": coast_down,
        "two trials": lambda bench: coast_down(bench, trials=2),
        "coarse": lambda bench: coast_down(bench, coarse=True),
        "instruments": lambda bench: coast_down(bench, off=KT_STD),
    },
    "back-drive": {
        "noise": back_drive,
        "smooth": lambda bench: back_drive(bench, cogging=2e-4),
        "instruments": lambda bench: back_drive(bench, off=TORQUE_STD),
    },
    "torque-pulses": {
        "noise": torque_pulses,
        "straight": lambda bench: torque_pulses(bench, loss=0.005),
        "instruments": lambda bench: torque_pulses(bench, off=(TORQUE_STD, CURRENT_STD)),
    },
    "torque-speed-envelope": {
        "noise": torque_speed_envelope,
        "one trial": lambda bench: torque_speed_envelope(bench, trials=1),
        "warming": lambda bench: torque_speed_envelope(bench, kelvin=8.0),
        "instruments": lambda bench: torque_speed_envelope(bench, off=TORQUE_STD),
    },
    "torque-sensor-calibration": {
        "noise": torque_sensor_calibration,
        "not told": lambda bench: torque_sensor_calibration(bench, told={}),
        "instruments": lambda bench: torque_sensor_calibration(
            bench, told={"gravity_std": 1e-3, "mass_relative_std": 3e-4, "arm_std_m": 1e-4}
        ),
    },
    "winding-rise": {
        "steps": winding_rise,
        "noise": lambda bench: winding_rise(bench, noise=0.02),
        "instruments": lambda bench: winding_rise(bench, off=(0.002, 0.003)),
    },
    "back-emf": {
        "noise": back_emf,
        "even": lambda bench: back_emf(bench, uneven=False),
        "sine": lambda bench: back_emf(bench, harmonics=False),
    },
    "torque-constant": {
        "noise": torque_constant,
        "instruments": lambda bench: torque_constant(bench, off=(TORQUE_STD, CURRENT_STD)),
    },
    "friction": {"noise": friction, "instruments": lambda bench: friction(bench, off=CURRENT_STD)},
}
