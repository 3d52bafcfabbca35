"""What the drives themselves lose: power of their DC link less that of both actuators' terminals."""

from collections.abc import Sequence

import numpy as np

from leactl.analysis.efficiency.balance import Calibration, balance
from leactl.analysis.efficiency.operating_points import OTHER, Points
from leactl.analysis.estimate import Estimate
from leactl.analysis.signals.levels import settled_mean
from leactl.analysis.statistics.regression import t_quantile
from leactl.runfile.read.reader import Channel, Run

FEWEST = 2


def drives_loss(runs: Sequence[Run], points: Points, told: Calibration, notes: list[str]) -> list[Estimate]:
    """Loss of both drives together [W], mean over the holds; none without measured voltages and DC link current.

    A supply that takes nothing back shows no power where the drives give some; those holds are left out.
    """
    links = [link_of(run) for run in runs]
    if (
        not told.by_measured_voltage
        or not all(links)
        or not all(("q_axis_current", role) in points.value for role in OTHER)
    ):
        notes.append(
            "losses of the drives are not told: that takes q-axis voltages of both and the current of the DC link"
        )
        return []
    taken = np.sum([balance(points, role, True, told).electrical for role in OTHER], axis=0)
    found = []
    for one, power in zip(points.holds, taken, strict=True):
        channels = links[one.run]
        assert channels is not None
        means = [settled_mean(channel, one.hold.start, one.hold.stop) for channel in channels]
        if np.isfinite(power) and all(mean is not None and mean.value > 0.0 for mean in means):
            voltage, current = (mean.value for mean in means if mean is not None)
            found.append(voltage * current - power)
    if len(found) < FEWEST:
        notes.append("losses of the drives are not told: too few holds with a current of the DC link")
        return []
    value, std = float(np.mean(found)), float(np.std(found, ddof=1)) / np.sqrt(len(found))
    half = t_quantile(len(found) - 1) * std
    return [Estimate("drives_loss", value, std, value - half, value + half, "W")]


def link_of(run: Run) -> tuple[Channel, Channel] | None:
    """Voltage and current of the supply that feeds the drives, of one device; None where there is none."""
    for role in ("bench", *OTHER):
        for current in run.channels("bus_current", role):
            for voltage in run.channels("bus_voltage", role):
                if voltage.device == current.device:
                    return voltage, current
    return None
