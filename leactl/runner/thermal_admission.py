"""The windings of a run: the start of their guard, the admission of a plan, and the memory for the next run.

A bench emulated in this process begins at ambient, by its own clock; every other bench has a memory.
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
from leactl.runner.state_folder import folder_of
from leactl.runner.thermal_memory import Keeper, Memory, Recalled
from leactl.runner.watchdog import time_to_end_s
from leactl.safety.limits import HOTTEST_DEGC
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.foresight import Forecast, Foresight
from leactl.safety.thermal.guard import GuardSettings, ThermalGuard

LONGEST_LABEL = 100  # characters; a label names a file, which may have 255 bytes
STOP_DELAY_S = 0.02  # a drive is without torque at the latest this long after its silence


class Windings:
    """The actuators of one bench with their temperatures at the start of a run."""

    def __init__(
        self,
        bench: BenchFile,
        devices: Sequence[CheckedDevice],
        actuator: str = "",
        emulated_here: bool = False,
        cold: bool = False,
        recalled: Mapping[str, Recalled] | None = None,
    ) -> None:
        """Recall the bounds of each actuator from its memory.

        Parameters
        ----------
        actuator : label of the actuator under test; without one, the bench's name and the role are the label. What
            is remembered of a labelled actuator is remembered for this label too: a later run may give none.
        cold : a person says that nothing has heated the actuators.
        recalled : bounds by role that replace those of the memory.

        Raises
        ------
        InputError : a motor file that cannot be used, or one without tolerances; a label that names no file, or that
            is another winding's.
        """
        check_label("--actuator", actuator)
        self.motors = motors_of(bench)
        self.fed = as_fed(self.motors, devices)
        self.settings = guard_settings(bench, devices, self.motors)
        limit, ambient = self.settings.limit, self.settings.ambient
        labels_of_bench = {role: f"{bench.name}.{role}" for role in self.motors}
        if actuator in (label for role, label in labels_of_bench.items() if role != "test"):
            raise InputError(f"--actuator {actuator}: is the label of another winding of bench '{bench.name}'")
        self.names = labels_of_bench | ({"test": actuator} if actuator else {})
        folder = folder_of(bench, emulated_here)
        memories = {
            role: Memory(self.names[role], motor, limit, ambient, folder) for role, motor in self.motors.items()
        }
        self.recalled: dict[str, Recalled] = {
            role: memory.cold() if cold or emulated_here else memory.recall(ClockReadings.now())
            for role, memory in memories.items()
        }
        if bench.emulated is not None:  # an emulated winding cannot burn: without a memory it is at ambient
            never_heated = {role for role, memory in memories.items() if not memory.known}
            self.recalled |= {role: memories[role].cold() for role in never_heated}
        self.recalled |= recalled or {}
        start = {role: recalled_bounds.nodes for role, recalled_bounds in self.recalled.items()}
        self.guard = ThermalGuard(self.fed, self.settings, start)
        self._latest_forecast: tuple[Plan, Forecast] | None = None
        self.keeper = None if emulated_here else Keeper(memories, lambda: self.guard.node_bounds, ClockReadings.now)
        if self.keeper is not None and self.names["test"] != labels_of_bench["test"]:
            unlabelled = Memory(labels_of_bench["test"], self.motors["test"], limit, ambient, folder)
            known = unlabelled.known or bench.emulated is None
            found = unlabelled.recall(ClockReadings.now()) if known and not cold else unlabelled.cold()
            if found.left_on is None:  # else it stays as it is: a supply may still be on
                self.keeper.further["test"] = unlabelled, found.nodes
        self.may_be_left_on(
            {
                role: recalled_bounds.left_on
                for role, recalled_bounds in self.recalled.items()
                if recalled_bounds.left_on is not None
            }
        )

    @contextmanager
    def remembered(self, before_writing: Callable[[], None] = lambda: None) -> Iterator[None]:
        """Write the bounds for the next run until the block is left, and once more at its end.

        `before_writing` is called before each writing, from the same thread.

        Raises
        ------
        InputError : the bounds cannot be written.
        """
        if self.keeper is None:
            yield
            return
        self.keeper.before_writing = before_writing
        self.keeper.start()
        self.guard.remember(self.keeper.fault)
        try:
            yield
        finally:
            self.keeper.stop()

    def may_be_left_on(self, reached_temperatures: Mapping[str, float]) -> None:
        """Store, in case this run dies, the temperature to which a supply left on may bring each winding [degC]."""
        if self.keeper is not None:
            for role, hottest in reached_temperatures.items():
                self.keeper.left_on[role] = max(min(hottest, HOTTEST_DEGC), self.keeper.left_on.get(role, -math.inf))

    def end(self, confirmed: bool) -> None:
        """Note the end of a run; unless all devices are `confirmed` safe, the windings count as after a crash."""
        if self.keeper is not None:
            self.keeper.doubted, self.keeper.seen_off = not confirmed, confirmed

    def forecast(self, plan: Plan) -> Forecast:
        """Return the forecast of a plan; the latest forecast is cached."""
        if self._latest_forecast is None or self._latest_forecast[0] is not plan:
            self._latest_forecast = plan, self._foresight().forecast(plan)
        return self._latest_forecast[1]

    def rest_before(self, plan: Plan) -> float | None:
        """Return the rest [s] that a plan needs before it: 0 if none is needed, None if no rest suffices."""
        if any(
            recalled_bounds.left_on is not None for recalled_bounds in self.recalled.values()
        ):  # no rest counts while a supply may be on
            return 0.0 if self.forecast(plan).passing is None else None
        return self._foresight().rest_before(plan)

    def keep_as_found(self) -> None:
        """Write the bounds unchanged for later runs, also those of windings that a person says are cold.

        Raises
        ------
        InputError : the bounds cannot be written.
        """
        if self.keeper is not None:
            self.keeper.start()
            self.keeper.stop()

    def admit(self, plan: Plan, insert_cooldown: bool = False) -> Plan:
        """Return the plan, or the plan with waits if `insert_cooldown` and they keep it below the limit.

        Raises
        ------
        InputError : a winding may pass its limit; with the step, the time, and the wait that would help.
        """
        forecast = self.forecast(plan)
        if forecast.passing is None:
            return plan
        plan_with_waits, forecast_with_waits = self._foresight().with_waits(plan)
        if insert_cooldown and forecast_with_waits.passing is None:
            self._latest_forecast = plan_with_waits, forecast_with_waits
            return plan_with_waits
        passing = forecast.passing
        if forecast_with_waits.passing is None:
            waits = plan_with_waits.duration_s - plan.duration_s
            remedy = f"--insert-cooldown adds {waits:.0f} s of waiting, which is enough"
        elif insert_cooldown:
            remedy = "no wait helps"
        else:
            remedy = "no wait between its steps helps: shorten or lower them"
        if forecast.turning_from_hz is not None:
            remedy += f", or raise rate_Hz, {plan.rate_Hz:g} now: {standing_text(forecast.turning_from_hz)}"
        starts = "; ".join(
            f"{role} {start.known}, at most {start.nodes[0]:.0f} degC" for role, start in self.recalled.items()
        )
        raise InputError(
            f"protocol '{plan.name}': step '{passing.step}' may take the {passing.role} winding to its limit of"
            f" {self.settings.limit:g} degC after {passing.time_s:.0f} s; {remedy}"
            f" ({starts}; --cold where nothing has heated them)"
        )

    def _foresight(self) -> Foresight:
        """Return the forecasts from the bounds that were recalled."""
        start = {role: recalled_bounds.nodes for role, recalled_bounds in self.recalled.items()}
        return Foresight(self.fed, self.settings, start)


def standing_text(turning_from_hz: float) -> str:
    """Return the sentence on rotors that a slow loop counts as standing."""
    return f"below about {turning_from_hz:g} Hz more than a tenth of the heat of a rotor that turns counts as standing"


def check_label(option: str, label: str) -> None:
    """Raise InputError if a label is too long or not printable.

    option : name of the option that gave the label, for the message.
    """
    if len(label) > LONGEST_LABEL:
        raise InputError(f"{option}: {len(label)} characters; at most {LONGEST_LABEL} were expected")
    if not label.isprintable():
        raise InputError(f"{option} {label!r}: printable text was expected")


def motors_of(bench: BenchFile) -> dict[str, Motor]:
    """Return the motors of a bench by role; without `motors.load`, the load is like the motor under test.

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
    """Return the motors by role; without a drive, the tolerance of the current is that of the supply's reading."""
    driven = {device.entry.role for device in devices if hasattr(registry.load(device.entry.driver), "engage")}
    return {role: motor if role in driven else _with_line_current_tolerance(motor) for role, motor in motors.items()}


def _with_line_current_tolerance(motor: Motor) -> Motor:
    """Return a motor whose tolerance of the current is that of the line current, if the file has one."""
    tolerances = motor.tolerances
    if tolerances is None or tolerances.line_current is None:
        return motor
    return motor.model_copy(update={"tolerances": tolerances.model_copy(update={"current": tolerances.line_current})})


def guard_settings(bench: BenchFile, devices: Sequence[CheckedDevice], motors: Mapping[str, Motor]) -> GuardSettings:
    """Return the settings of the guard by a bench file; the lowest limit of bench and motors counts."""
    limits, ambient = bench.limits, bench.limits.ambient_temperature_degC
    silences = [silence for silence in host_silences(devices).values() if silence is not None]
    # a supply expects no sign of life: the run's watchdog switches it off when the loop stands still, or, if the run
    # holds the line to the supply, after it has ended the run
    has_supply = any(hasattr(registry.load(device.entry.driver), "switch_on") for device in devices)
    switch_off_s = SAFE_STATE_S + time_to_end_s(len(devices)) if has_supply else 0.0
    return GuardSettings(
        limit=min(Box.of(motor).limit(limits.winding_temperature_degC, ambient) for motor in motors.values()),
        ambient=ambient,
        most_current=limits.current_A,
        most_speed=limits.velocity_rad_s,
        reserve_s=max(silences, default=SAFE_STATE_S) + switch_off_s + STOP_DELAY_S,
    )
