"""The thermal fit of 150 minutes at 30 Hz beside least squares over an ODE solver: the same optimum, much sooner.

The peer is scipy's `solve_ivp` (RK45) under scipy's `least_squares`. Heat is read with noise, so that the solver has to
go from reading to reading. For its optimum all parameter sets of a Jacobian are integrated side by side; its time is
that of one plain integration, taken in the same run, times as many as one after the other would have been.
"""

import itertools
import time

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from leactl.analysis.heating.first_guess import frames_with_known_heat
from leactl.analysis.heating.network import Unknowns, camera_temperatures, drive_of, fit_network
from leactl.analysis.heating.record import heating_records
from leactl.runfile.read.reader import Run
from tests.analysis.heated import HeatedBench

RATE = 30.0  # Hz
STEP = 1e-5  # of the peer's differences
TIMES, AGREES = 100.0, 1e-6


def temperatures(sets, drive, stamps):
    """Winding and housing [degC] at stamps, by the solver; `sets` of shape (count, 7)."""
    wa, wh, ha = 1 / sets[:, 0], 1 / sets[:, 1], 1 / sets[:, 2]
    interval = 1 / RATE

    def rates(now, state):
        piece = min(max(int(np.searchsorted(drive.time, now, side="right")) - 1, low), high)
        share = (now - drive.time[piece]) / (drive.time[piece + 1] - drive.time[piece])
        heat = drive.begin[piece] + share * (drive.end[piece] - drive.begin[piece])
        air = drive.ambient[piece] + share * (drive.ambient[piece + 1] - drive.ambient[piece])
        winding, housing = state[: len(sets)], state[len(sets) :]
        across = (winding - housing) * wh
        return np.concatenate(
            [
                (heat - (winding - air) * wa - across) / sets[:, 3],
                (across - (housing - air) * ha) / sets[:, 4],
            ]
        )

    state = np.concatenate([sets[:, 5], sets[:, 6]])
    steps = np.diff(drive.time)
    odd = np.flatnonzero(np.abs(steps - interval) > 1e-6)  # where the current is switched between readings
    cuts = sorted({0, *odd.tolist(), *(odd + 1).tolist(), len(steps)})
    out = []
    for low, after in itertools.pairwise(cuts):
        high, begin, end = after - 1, float(drive.time[low]), float(drive.time[after])
        asked = stamps[(stamps >= begin) & (stamps < end)]
        step = min(interval, end - begin)
        result = solve_ivp(
            rates,
            (begin, end),
            state,
            t_eval=np.append(asked, end),
            first_step=step,
            max_step=step,
            rtol=1e-6,
            atol=1e-6,
        )
        out.append(result.y[:, :-1])
        state = result.y[:, -1]
    return np.concatenate(out, axis=1).reshape(2, len(sets), -1)


@pytest.mark.long
def test_the_optimum_of_an_ode_solver_a_hundred_times_sooner(tmp_path, figure):
    path = HeatedBench(tmp_path).run(rate_Hz=RATE, heat_s=4470.0, cool_s=4470.0, moment=0.0)
    with Run.open(path) as run:
        [record] = heating_records(run).value
    unknowns = Unknowns(0.0, 0.0)
    began = time.process_time()
    fit = fit_network([record], unknowns, "benchmark")
    own = time.process_time() - began
    wa, wh, ha, cw, ch = fit.point[0], *np.exp(fit.point[1:5])
    ours = np.array([1 / wa, wh, ha, cw, ch, *fit.point[5:]])

    record = frames_with_known_heat(record, 0.0)
    seen, drive, count = camera_temperatures(record), drive_of(record), 0

    def together(point):
        nonlocal count
        count += 1 + len(point)
        sets = np.vstack([point, point + np.diag(STEP * point)])
        return temperatures(sets, drive, record.time)

    kept = {}

    def left(point):
        kept[point.tobytes()] = result = together(point)
        return (result[:, 0] - seen).ravel()

    def slopes(point):
        result = kept[point.tobytes()]
        return np.stack(
            [((result[:, k + 1] - result[:, 0]) / (STEP * point[k])).ravel() for k in range(len(point))], axis=1
        )

    start = np.array([5.7, 0.305, 1.68, 23.2, 465.0, 25.0, 25.0])
    theirs = least_squares(left, start, slopes, method="lm", x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12).x

    began = time.process_time()
    temperatures(theirs[None], drive, record.time)
    each = time.process_time() - began
    apart = float(np.max(np.abs(ours / theirs - 1.0)))
    ratio = each * count / own
    figure(
        f"thermal fit of {seen.shape[1]} frames: {own:.2f} s; {count} integrations of {each:.1f} s: {ratio:.0f} times"
    )
    figure(f"largest difference of both optima: {apart:.1e} of a parameter")
    assert apart < AGREES
    assert ratio > TIMES
