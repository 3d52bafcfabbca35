"""Runs of a servo cut into stretches: together their scored parts hold every sample, whatever the length."""

from types import SimpleNamespace

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from leactl.gap.servo.stretches import LEAST_SCORED_RATIO, cut_runs


@given(st.integers(2, 60_000), st.integers(1, 400), st.integers(1, 3))
@example(641, 10, 1)  # a rounded length that would begin a stretch behind the end
@example(21_841, 60, 2)
def test_every_sample_is_scored(samples, forgets, runs):
    angle = np.zeros((runs, samples))
    logged = SimpleNamespace(
        angle=angle,
        memory_samples=forgets,
        enabled=np.ones_like(angle),
        gain=np.ones(runs),
        interval=0.01,
        speed=np.zeros(runs),
    )
    stretches = cut_runs(logged)
    scored = np.zeros((runs, samples), int)
    for run, first, scored_from in zip(stretches.run, stretches.first, stretches.scored_from, strict=True):
        assert 0 <= first <= scored_from < samples
        assert scored_from == first == 0 or scored_from - first == forgets
        scored[run, scored_from : first + stretches.length] += 1
    assert (scored >= 1).all()
    assert stretches.length == samples or stretches.length - forgets >= LEAST_SCORED_RATIO * forgets
