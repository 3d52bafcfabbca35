"""A diagnosis made by hand, with everything that one can say."""

from itertools import pairwise

import numpy as np

from leactl.gap.diagnosis import (
    CalibratedParameter,
    Cause,
    DiagnosisResult,
    EffectParameter,
    Near,
    Picture,
    Region,
    ResidualBin,
    Rest,
    Shrinkage,
    Where,
)
from leactl.gap.verdict.shrinkage import Trace
from leactl.gap.verdict.where import Profile

TEST, LOAD, LOCKED = ("velocity", "test", "coupled"), ("velocity", "load", "coupled"), ("torque", "test", "locked")


def answer(**changed):
    said = {
        "verdict": "effect",
        "unexplained_probability": 0.024,
        "where": (
            Where(*LOCKED, "N*m", 0.4118, 0.3327, 0.009123, Region("q_axis_current", 14.02, 24.51, "A"), 0.834),
            Where(*TEST, "rad/s", 0.466, 0.2077, 0.02161, Region("direction", -1.0, -1.0, "1"), 0.91),
            Where(*LOAD, "rad/s", 0.4641, 0.0236, 0.02263),
        ),
        "calibration": (
            CalibratedParameter("viscous_damping", 0.0238, 0.025137, 0.000212, "N*m*s/rad"),
            CalibratedParameter("ambient_offset", 0.0, 0.0029, 0.0024, "K"),
        ),
        "causes": (
            Cause(
                "saturation",
                0.981,
                0.97,
                (EffectParameter("knee", 21.37, 0.24, "A"), EffectParameter("order", 82.0, 0.0, "1")),
                ("torque_sensor_gain",),
                "separate-by-grid",
                picture=picture(),
            ),
            Cause("torque_sensor_gain", 0.981, 0.0, (), ("saturation",)),
            Cause("cogging", 0.012, 0.0, ()),
        ),
        "shrinkage": (
            Shrinkage(*TEST, "rad/s", 0.466, 0.2077, 0.04535, 0.02161, 0.8725, 0.837, 0.905),
            Shrinkage(*LOAD, "rad/s", 0.4641, 0.0236, 0.0231, 0.02263),
            Shrinkage(*LOCKED, "N*m", 0.4118, 0.3327, 0.0101, 0.009123, 0.997, 0.98, 1.003),
        ),
        "notes": ("not answered: the bus; it needs the bus voltage",),
        "extra": {"traces": (trace(TEST), trace(LOCKED)), "profiles": (profile(LOCKED), profile(TEST, "direction"))},
    }
    return DiagnosisResult(**(said | changed))


def picture(variable="q_axis_current", periods=None, along=None):
    edges = np.linspace(-24.0, 24.0, 13).tolist()
    bins = []
    for low, high in pairwise(edges):
        before, after = 1e-5 * (low + high) ** 3, 1e-4 * low
        bins.append(
            ResidualBin(low, high, 120, before, before - 0.02, before + 0.02, after, after - 0.01, after + 0.01)
        )
    bins[3] = ResidualBin(-12.0, -8.0, 2, *[np.nan] * 6)
    shown = ("torque", "test", "locked", "swung_torque", "N*m")
    return Picture(variable, "A", periods, along, *shown, 0.4127, 0.0013, 10, 1, tuple(bins))


def rest(**changed):
    said = {
        "depends_on": ("velocity", "q_axis_current"),
        "repeats_Hz": None,
        "closable": 0.973,
        "quantity": "torque",
        "role": "test",
        "mechanical": "coupled",
        "equation": "coupled_torque",
        "shapes": (picture("velocity"), picture()),
        "nearest": (Near("quadratic_drag", "the set explains 11 % of the gap where it acts"),),
        "experiment": "separate-by-grid",
    }
    return Rest(**(said | changed))


def trace(key, points=200, run="locked_staircase-b"):
    time = np.linspace(3.0, 4.5, points)
    measured = 5.0 * np.sin(time)
    return Trace(run, *key, "N*m", time, measured, measured + 0.4, measured + 0.3, measured + 0.01)


def profile(key, variable="q_axis_current"):
    low = np.array([-1.25, 0.75]) if variable == "direction" else np.linspace(-24.0, 22.0, 24)
    high = low + (0.5 if variable == "direction" else 2.0)
    mean = np.array([[0.4], [0.3], [0.0]]) * np.ones(len(low))
    return Profile(*key, "N*m", variable, "1" if variable == "direction" else "A", low, high, mean, mean / 4 + 0.01)
