"""The windings of a run: what their guard starts from, whether the plan keeps them below the limit, and what is kept.

An emulated bench of this process is at ambient whenever it begins, by its own clock; every other bench has a memory.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

from leactl.bench.benchfile import BenchFile, CheckedDevice, host_silences
from leactl.driver import registry
from leactl.driver.contract import SAFE_STATE_S
from leactl.errors import InputError
from leactl.model.motor import Motor, load_motor
from leactl.protocol.plan import Plan
from leactl.runner.boot_time import ClockReadings
from leactl.runner.state_folder import place_of
from leactl.runner.thermal_memory import Keeper, Memory, Recalled
from leactl.runner.watchdog import time_to_end_s
from leactl.safety.limits import HOTTEST_DEGC
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.foresight import Forecast, Foresight
from leactl.safety.thermal.guard import GuardSettings, ThermalGuard

LONGEST_LABEL = 100  # characters; a label names a file, which may have 255 bytes
STOPS_WITHIN_S = 0.02  # after its silence, by which a drive is without torque


class Windings:
    """The actuators of one bench as a run finds them."""

    def __init__(
        self,
        bench: BenchFile,
        devices: Sequence[CheckedDevice],
        actuator: str = "",
        emulated_here: bool = False,
        cold: bool = False,
        recalled: Mapping[str, Recalled] | None = None,
    ) -> None:
        """Recall what is known of them.

        Parameters
        ----------
        actuator : label of the one under test; the bench's name and the role stand for one without.
        cold : a person says that nothing has heated them.
        recalled : bounds of each role that hold, in place of what is remembered.

        Raises
        ------
        InputError : a motor file that cannot be used, or one without tolerances; a label that names no file.
        """
        check_label("--actuator", actuator)
        self.motors = motors_of(bench)
        self.fed = as_fed(self.motors, devices)
        self.settings = guard_settings(bench, devices, self.motors)
        limit, ambient = self.settings.limit, self.settings.ambient
        self.names = {role: actuator if role == "test" and actuator else f"{bench.name}.{role}" for role in self.motors}
        place = place_of(bench, emulated_here)
        memories = {role: Memory(self.names[role], motor, limit, ambient, place) for role, motor in self.motors.items()}
        self.recalled: dict[str, Recalled] = {
            role: memory.cold() if cold or emulated_here else memory.recall(ClockReadings.now())
            for role, memory in memories.items()
        }
        if bench.emulated is not None:  # nothing burns that is emulated: what nothing is known of is at ambient
            fresh = {role for role, memory in memories.items() if not memory.known}
            self.recalled |= {role: memories[role].cold() for role in fresh}
        self.recalled |= recalled or {}
        start = {role: known.nodes for role, known in self.recalled.items()}
        self.guard = ThermalGuard(self.fed, self.settings, start)
        self._foreseen: tuple[Plan, Forecast] | None = None
        self.keeper = None if emulated_here else Keeper(memories, lambda: self.guard.node_bounds, ClockReadings.now)
        self.may_be_left_on({role: one.left_on for role, one in self.recalled.items() if one.left_on is not None})

    @contextmanager
    def remembered(self, beside: Callable[[], None] = lambda: None) -> Iterator[None]:
        """Keep the bounds for the next run while the block lasts, and once more at its end.

        `beside` is called as often, from the same thread.

        Raises
        ------
        InputError : there is no place to keep them.
        """
        if self.keeper is None:
            yield
            return
        self.keeper.beside = beside
        self.keeper.start()
        self.guard.remember(self.keeper.fault)
        try:
            yield
        finally:
            self.keeper.stop()

    def may_be_left_on(self, reached: Mapping[str, float]) -> None:
        """Have the next run know what a supply may bring each winding to [degC], by role, if this run dies before."""
        if self.keeper is not None:
            for role, hottest in reached.items():
                self.keeper.left_on[role] = max(min(hottest, HOTTEST_DEGC), self.keeper.left_on.get(role, -math.inf))

    def end(self, confirmed: bool) -> None:
        """A run has ended; where a device is not confirmed safe, the next run takes the windings as after a crash."""
        if self.keeper is not None:
            self.keeper.doubted, self.keeper.seen_off = not confirmed, confirmed

    def forecast(self, plan: Plan) -> Forecast:
        """What a plan would do to the windings; that of the plan that was admitted is at hand."""
        if self._foreseen is None or self._foreseen[0] is not plan:
            self._foreseen = plan, self._foresight().forecast(plan)
        return self._foreseen[1]

    def rest_before(self, plan: Plan) -> float | None:
        """Rest [s] before a plan that keeps it below the limit: 0 where it needs none, None where none is enough."""
        if any(one.left_on is not None for one in self.recalled.values()):  # no rest counts before a supply is seen off
            return 0.0 if self.forecast(plan).passing is None else None
        return self._foresight().rest_before(plan)

    def keep_as_found(self) -> None:
        """Have the runs to come find the windings as this one did, a person's word that they are cold included.

        Raises
        ------
        InputError : there is no place to keep it.
        """
        if self.keeper is not None:
            self.keeper.start()
            self.keeper.stop()

    def admit(self, plan: Plan, insert_cooldown: bool = False) -> Plan:
        """The plan, or one with waits where that was asked for.

        Raises
        ------
        InputError : a winding may pass its limit; with the step, the time, and the wait that would help.
        """
        forecast = self.forecast(plan)
        if forecast.passing is None:
            return plan
        longer, later = self._foresight().with_waits(plan)
        if insert_cooldown and later.passing is None:
            self._foreseen = longer, later
            return longer
        at = forecast.passing
        if later.passing is None:
            waits = longer.duration_s - plan.duration_s
            helps = f"--insert-cooldown adds {waits:.0f} s of waiting, which is enough"
        elif insert_cooldown:
            helps = "no wait helps"
        else:
            helps = "no wait between its steps helps: shorten or lower them"
        if forecast.turning_from_hz is not None:
            helps += f", or raise rate_Hz, {plan.rate_Hz:g} now: {standing(forecast.turning_from_hz)}"
        known = "; ".join(f"{role} {one.known}, at most {one.nodes[0]:.0f} degC" for role, one in self.recalled.items())
        raise InputError(
            f"protocol '{plan.name}': step '{at.step}' may take the {at.role} winding to its limit of"
            f" {self.settings.limit:g} degC after {at.time_s:.0f} s; {helps}"
            f" ({known}; --cold where nothing has heated them)"
        )

    def _foresight(self) -> Foresight:
        start = {role: known.nodes for role, known in self.recalled.items()}
        return Foresight(self.fed, self.settings, start)


def standing(turning_from_hz: float) -> str:
    """What a slow loop makes of rotors that turn."""
    return f"below about {turning_from_hz:g} Hz more than a tenth of the heat of a rotor that turns counts as standing"


def check_label(option: str, label: str) -> None:
    """Refuse a label that is no short printable text.

    Raises
    ------
    InputError : with the option that gave it.
    """
    if len(label) > LONGEST_LABEL:
        raise InputError(f"{option}: {len(label)} characters; at most {LONGEST_LABEL} were expected")
    if not label.isprintable():
        raise InputError(f"{option} {label!r}: printable text was expected")


def motors_of(bench: BenchFile) -> dict[str, Motor]:
    """The motors of a bench by role; a load that the file does not tell is like the one under test.

    Raises
    ------
    InputError : a motor that is not known, or faults in its file.
    """
    test = load_motor(bench.motors["test"])[0]
    if "load" not in bench.motors and test.tolerances is not None and test.tolerances.line_current is not None:
        raise InputError(
            f"bench '{bench.name}': motors.test names a file that is narrowed to one actuator; motors.load was expected"
            " beside it, with the motor file that holds for the other one"
        )
    return {"test": test, "load": load_motor(bench.motors["load"])[0] if "load" in bench.motors else test}


def as_fed(motors: Mapping[str, Motor], devices: Sequence[CheckedDevice]) -> dict[str, Motor]:
    """The motors with the tolerance of the current reading that each has: a supply's own where no drive feeds it."""
    driven = {device.entry.role for device in devices if hasattr(registry.load(device.entry.driver), "engage")}
    return {role: motor if role in driven else _supplied(motor) for role, motor in motors.items()}


def _supplied(motor: Motor) -> Motor:
    own = motor.tolerances
    if own is None or own.line_current is None:
        return motor
    return motor.model_copy(update={"tolerances": own.model_copy(update={"current": own.line_current})})


def guard_settings(bench: BenchFile, devices: Sequence[CheckedDevice], motors: Mapping[str, Motor]) -> GuardSettings:
    """What a bench file tells the guard; the lowest limit of bench and motors counts."""
    limits, ambient = bench.limits, bench.limits.ambient_temperature_degC
    silences = [s for s in host_silences(devices).values() if s is not None]
    # a supply waits for no sign of life: the run's watchdog sees that the loop stands still, and switches it off; where
    # the run holds its line, once the run has been ended
    supplied = any(hasattr(registry.load(device.entry.driver), "switch_on") for device in devices)
    to_end = SAFE_STATE_S + time_to_end_s(len(devices)) if supplied else 0.0
    return GuardSettings(
        limit=min(Box.of(motor).limit(limits.winding_temperature_degC, ambient) for motor in motors.values()),
        ambient=ambient,
        most_current=limits.current_A,
        most_speed=limits.velocity_rad_s,
        reserve_s=max(silences, default=SAFE_STATE_S) + to_end + STOPS_WITHIN_S,
    )
