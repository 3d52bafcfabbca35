"""The experiment that would tell the members of a class apart, as a protocol that `leactl run` can execute."""

from collections.abc import Sequence


def separating_experiment(effect: str, peers: Sequence[str]) -> str | None:
    """Name of the shipped protocol for a class; None where the data already tells."""
    if not peers:
        return None
    members = {effect, *peers}
    for protocol, separates in EXPERIMENTS:
        if len(members & separates) > 1 or (members & separates and not peers):
            return protocol
    return "separate-by-grid"


EXPERIMENTS: tuple[tuple[str, frozenset[str]], ...] = (
    ("separate-sensor-timing", frozenset({"torque_sensor_lag", "time_skew", "torque_sensor_hysteresis"})),
    ("separate-drive-timing", frozenset({"transport_delay", "command_slew_limit"})),
    ("separate-slow-friction", frozenset({"stribeck", "presliding", "backlash", "friction_run_in", "quadratic_drag"})),
    ("separate-angle", frozenset({"cogging", "torque_ripple", "unbalance", "position_dependent_friction"})),
    ("separate-heat", frozenset({"third_thermal_node", "ambient_drift", "nonlinear_convection", "forced_convection"})),
)
