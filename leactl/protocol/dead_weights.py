"""Expand `weigh` steps to prompts to hang dead weights on an arm of the torque sensor, and a hold for each weight."""

from leactl.driver.contract import Mode
from leactl.protocol.plan import Hang
from leactl.protocol.steps import ProtocolStep, WeighStep
from leactl.protocol.timeline import Timeline

STANDARD_GRAVITY = 9.80665  # m/s^2 (CGPM 1901); local gravity is left to the analysis


def weighing_order(masses: tuple[float, ...]) -> list[tuple[float, str]]:
    """Return masses [kg] with directions: 0 and all masses rising, then all but the largest falling, and 0."""
    rising = sorted(masses)
    falling = [(mass, "falling") for mass in reversed([0.0, *rising[:-1]])]
    return [(mass, "rising") for mass in (0.0, *rising)] + falling


def weigh(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    """Write the actions of a `weigh` step; `pass_number` counts the passes of the enclosing repeats."""
    content: WeighStep = step.content
    timeline.check_times(step, ("settle_s", "hold_s"), content.hold_s, content.settle_s)
    engaged_roles = [role for role, role_setpoint in timeline.roles.items() if role_setpoint.mode is not Mode.OFF]
    if engaged_roles and timeline.modes_known:
        timeline.add_fault(
            step, (), f"{' and '.join(engaged_roles)} engaged while a person is at the shaft; off was expected"
        )
    weighings = weighing_order(content.masses_kg)
    timeline.check_limits(step, content.repeats * 2 * len(weighings), content.repeats * len(weighings) * content.hold_s)
    side = "positive" if content.sign > 0 else "negative"
    for repeat in range(1, content.repeats + 1):
        for mass, direction in weighings:
            torque = content.sign * mass * STANDARD_GRAVITY * content.arm_m
            request = (
                f"Hang {mass:g} kg at {content.arm_m:g} m, pulling in the {side} sense of the shaft, and let it rest"
            )
            timeline.add(step, Hang(request if mass else "Take all weights off the arm", torque))
            parameters: dict[str, float | str] = {"weight_Nm": torque, "mass_kg": mass, "arm_m": content.arm_m}
            parameters |= {
                "role": "bench",
                "direction": direction,
                "repeat": (pass_number - 1) * content.repeats + repeat,
            }
            timeline.segment(step, "hold", content.hold_s, {}, parameters, content.settle_s)
