"""Records of a first-order lag under excitations, from its equation alone."""

import numpy as np


def first_order(kind, corner_hz, rate, length_s=60.0):
    """Times, setpoint and answer of a lag that was excited from 0.5 to 30 Hz."""
    time = np.arange(round(length_s * rate)) / rate
    rng = np.random.default_rng(3)
    if kind == "noise":
        given = rng.normal(0.0, 1.0, len(time))
    elif kind == "chirp":
        ratio = np.log(30.0 / 0.5)
        given = np.sin(2 * np.pi * 0.5 * length_s / ratio * (np.exp(time / length_s * ratio) - 1.0))
    else:
        given = sum(np.sin(2 * np.pi * f * time + rng.uniform(0, 6.28)) for f in np.arange(0.5, 30.0, 0.25))
    spectrum = np.fft.rfft(given)
    answer = np.fft.irfft(spectrum / (1.0 + 1j * np.fft.rfftfreq(len(time), 1 / rate) / corner_hz), len(time))
    return time, given, answer + rng.normal(0.0, 0.01, len(time))
