"""Loss of the drives: power of their DC link minus the power at the terminals of both actuators."""

from collections.abc import Sequence

import numpy as np

from leactl.analysis.efficiency.operating_points import OTHER_ROLE, OperatingPoints
from leactl.analysis.efficiency.power_balance import PowerCalibration, balance
from leactl.analysis.estimate import Estimate, Noted
from leactl.analysis.signals.levels import settled_mean
from leactl.analysis.statistics.regression import t_quantile
from leactl.runfile.read.reader import Channel, Run

FEWEST_HOLDS = 2  # with a current of the DC link


def drive_losses(runs: Sequence[Run], points: OperatingPoints, calibration: PowerCalibration) -> Noted[list[Estimate]]:
    """Estimate the loss of both drives together [W] as the mean over the holds.

    The list is empty if q-axis voltages or the current of the DC link were not measured, or if too few holds remain.
    Holds in which the DC link shows no power are left out: a supply that cannot take power back hides the power that
    the drives return.
    """
    link_channels = [dc_link_channels(run) for run in runs]
    if (
        not calibration.by_measured_voltage
        or not all(link_channels)
        or not all(("q_axis_current", role) in points.value for role in OTHER_ROLE)
    ):
        note = (
            "losses of the drives are not known: they need q-axis voltages of both actuators and the current of the DC"
            " link"
        )
        return Noted([], (note,))
    terminal_powers = np.sum(
        [balance(points, role, driving=True, calibration=calibration).electrical for role in OTHER_ROLE], axis=0
    )
    losses = []
    for grid_hold, terminal_power in zip(points.holds, terminal_powers, strict=True):
        channels = link_channels[grid_hold.run]
        assert channels is not None
        means = [settled_mean(channel, grid_hold.hold.start, grid_hold.hold.stop) for channel in channels]
        if np.isfinite(terminal_power) and all(mean is not None and mean.value > 0.0 for mean in means):
            voltage, current = (mean.value for mean in means if mean is not None)
            losses.append(voltage * current - terminal_power)
    if len(losses) < FEWEST_HOLDS:
        return Noted([], ("losses of the drives are not known: too few holds with a current of the DC link",))
    mean_loss, std = float(np.mean(losses)), float(np.std(losses, ddof=1)) / np.sqrt(len(losses))
    half_width = t_quantile(len(losses) - 1) * std
    return Noted([Estimate("drives_loss", mean_loss, std, mean_loss - half_width, mean_loss + half_width, "W")])


def dc_link_channels(run: Run) -> tuple[Channel, Channel] | None:
    """Return voltage and current of the drives' DC link, measured by one device; None if the run lacks one of them."""
    for role in ("bench", *OTHER_ROLE):
        for current in run.channels("bus_current", role):
            for voltage in run.channels("bus_voltage", role):
                if voltage.device == current.device:
                    return voltage, current
    return None
