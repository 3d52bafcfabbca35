"""Requirements on every power supply: the output is what was set, no more, and off when it confirms to be off."""

import math
from contextlib import suppress

from leactl.driver.contract import PowerSupply, ProtectedSupply
from leactl.driver.far_end import FailingSupply
from leactl.emulation.trial.drives import call_safe_state
from leactl.emulation.trial.known_bench import LOAD_OHM
from leactl.emulation.trial.stand import Broken, Stand
from leactl.errors import DeviceError, InputError

# V and A; with either pair the load takes 2 A at 1.2 V: the first is limited by the current, the second by the voltage
CURRENT_LIMITED, VOLTAGE_LIMITED = (3.0, 2.0), (1.2, 3.0)
PROTECTION_V = 1.5  # level of the protection
OVERSHOOT_FACTOR = 2.0  # output of a failing supply over its set levels
LONGEST_SWITCH_S = 5.0  # time for an output to switch
LEVEL_TOLERANCE, ABSOLUTE_TOLERANCE = 0.02, 0.05  # error of an output, as a share; of a reading, V or A beside it
POLL_S = 0.01  # time between two calls of `take`


def supply_of(stand: Stand) -> PowerSupply:
    """Return the driver, typed as that of a supply."""
    assert isinstance(stand.driver, PowerSupply)
    return stand.driver


def listen(stand: Stand, seconds: float) -> list[float]:
    """Take rows for a time [s], as the control loop does; return the newest value of each channel."""
    end, newest_values = stand.clock.now() + seconds, list[float]()
    while stand.clock.now() < end:
        for row in stand.driver.take():
            newest_values = list(getattr(row, "values", ()))
        stand.wait(POLL_S)
    return newest_values


def open_and_switch_on(stand: Stand) -> None:
    """Open the supply and switch its output on."""
    stand.driver.open()
    listen(stand, 0.2)
    switch_on(stand, *CURRENT_LIMITED)


def switch_on(stand: Stand, volts: float, amperes: float) -> None:
    """Set voltage [V] and current [A] of an open supply, and switch its output on."""
    supply = supply_of(stand)
    supply.supply(volts, amperes)
    supply.switch_on()
    end = stand.clock.now() + LONGEST_SWITCH_S
    while not supply.supplying:
        if stand.clock.now() >= end:
            raise Broken(f"supplying is false {LONGEST_SWITCH_S:g} s after switch_on()")
        listen(stand, 0.05)


def outputs_its_set_levels(stand: Stand) -> None:
    """The set voltage in V or current in A is at the terminals, and is measured correctly."""
    supply = supply_of(stand)
    open_and_switch_on(stand)
    for volts, amperes in (CURRENT_LIMITED, VOLTAGE_LIMITED):
        supply.supply(volts, amperes)
        newest_values = listen(stand, 2.0)
        load_current = min(amperes, volts / LOAD_OHM)
        expect_output(stand, newest_values, (load_current * LOAD_OHM, load_current))
        if not supply.supplying:
            raise Broken("supplying is false while the output is on")


def expect_output(stand: Stand, newest_values: list[float], expected: tuple[float, float]) -> None:
    """Raise Broken if the output differs from `expected` (V, A), or a reading from the output."""
    volts, amperes = stand.bench.load.fed
    if any(
        abs(actual - level) > LEVEL_TOLERANCE * level for actual, level in zip((volts, amperes), expected, strict=True)
    ):
        raise Broken(
            f"{volts:.4g} V and {amperes:.4g} A at the terminals; {expected[0]:g} V and {expected[1]:g} A were expected"
        )
    for channel, value in zip(stand.driver.streams[0].channels, newest_values, strict=False):
        true_value = {"voltage": volts, "current": amperes}.get(
            channel.quantity.removeprefix("line_").removeprefix("bus_")
        )
        if true_value is not None and not abs(value - true_value) <= LEVEL_TOLERANCE * true_value + ABSOLUTE_TOLERANCE:
            raise Broken(f"{channel.quantity} reads {value:.4g} where {true_value:.4g} is true")


def keeps_below_its_protection(stand: Stand) -> None:
    """A voltage above the level of `protect` is refused; if the supply's own regulation fails, the output trips."""
    supply = supply_of(stand)
    if not isinstance(supply, ProtectedSupply):
        return
    stand.driver.open()
    listen(stand, 0.2)
    supply.protect(PROTECTION_V)
    highest_trip_voltage = PROTECTION_V * (1.0 + supply.trip_accuracy.share) + supply.trip_accuracy.beside
    switch_on(stand, *VOLTAGE_LIMITED)
    with suppress(InputError):
        supply.supply(1.5 * highest_trip_voltage, min(supply.most[1], 2.0 * highest_trip_voltage / LOAD_OHM))
        expect_voltage_below(stand, highest_trip_voltage, "as asked for,")
    if isinstance(stand.far_end, FailingSupply):
        supply.supply(0.9 * PROTECTION_V, 3.0)
        listen(stand, 1.0)
        stand.far_end.lose_regulation(OVERSHOOT_FACTOR)
        expect_voltage_below(stand, highest_trip_voltage, "by a failure,")


def expect_voltage_below(stand: Stand, highest_voltage: float, cause: str) -> None:
    """Raise Broken if more than `highest_voltage` [V] is at the terminals after a second."""
    with suppress(DeviceError):  # a protection that trips is reported as a fault
        listen(stand, 1.0)
    volts = stand.bench.load.fed[0]
    if volts > highest_voltage:
        raise Broken(
            f"{volts:.4g} V stay at the terminals, {cause} after protect({PROTECTION_V:g}); no output was expected"
        )


def is_off_until_switched_on(stand: Stand) -> None:
    """The output is off until it is switched on, and `supplying` is false."""
    stand.driver.open()
    listen(stand, 1.0)
    if stand.bench.load.fed[1] > 0.0 or supply_of(stand).supplying:
        raise Broken("its output is on, or said to be, before switch_on()")


def switches_off(stand: Stand) -> None:
    """`switch_off` switches the output off, and `supplying` becomes false once the instrument reports it."""
    supply = supply_of(stand)
    open_and_switch_on(stand)
    supply.switch_off()
    listen(stand, LONGEST_SWITCH_S)
    if stand.bench.load.fed[1] > 0.0:
        raise Broken(f"{stand.bench.load.fed[1]:.4g} A still flow {LONGEST_SWITCH_S:g} s after switch_off()")
    if supply.supplying:
        raise Broken(f"supplying is true {LONGEST_SWITCH_S:g} s after switch_off()")


def refuses_levels_out_of_range(stand: Stand) -> None:
    """A setting that is not finite, negative or above `most` is refused."""
    supply = supply_of(stand)
    stand.driver.open()
    volts, amperes = supply.most
    for limits in (
        (math.nan, 1.0),
        (1.0, math.inf),
        (-1.0, 1.0),
        (1.0, -1.0),
        (1.1 * volts, 1.0),
        (1.0, 1.1 * amperes),
    ):
        try:
            supply.supply(*limits)
        except InputError:
            continue
        raise Broken(f"supply{limits} is taken; InputError was expected")


def is_off_when_confirmed_safe(stand: Stand) -> None:
    """`safe_state` switches the output off, before `open` too, and when it is called again."""
    for when in ("before open()", "in operation", "the second time"):
        if when == "in operation":
            open_and_switch_on(stand)
        if not call_safe_state(stand):
            raise Broken(f"safe_state {when} is not confirmed although the supply answers")
        if stand.bench.load.fed[1] > 0.0:
            raise Broken(f"safe_state {when} is confirmed while {stand.bench.load.fed[1]:.4g} A flow")


def never_confirms_an_output_that_is_on(stand: Stand) -> None:
    """An output that is stuck on, or behind an unplugged cable, is not confirmed to be off."""
    open_and_switch_on(stand)
    if isinstance(stand.far_end, FailingSupply):
        stand.far_end.stuck_on()
    else:
        stand.cut()
    if call_safe_state(stand) and stand.bench.load.fed[1] > 0.0:
        raise Broken(f"safe_state is confirmed while {stand.bench.load.fed[1]:.4g} A flow")


def never_confirms_over_a_cut_cable(stand: Stand) -> None:
    """`safe_state` is not confirmed if the cable is unplugged."""
    open_and_switch_on(stand)
    stand.cut()
    if call_safe_state(stand) and stand.bench.load.fed[1] > 0.0:
        raise Broken("safe_state is confirmed although the cable is unplugged")


def is_cut_by_stop_now(stand: Stand) -> None:
    """`stop_now` sends the command that switches the output off, and does not wait."""
    open_and_switch_on(stand)
    start_time = stand.clock.now()
    stand.driver.stop_now()
    if stand.clock.now() > start_time:
        raise Broken(f"stop_now waits for {stand.clock.now() - start_time:.3f} s; it must not wait")
    stand.wait(1.0)
    if stand.bench.load.fed[1] > 0.0:
        raise Broken(f"{stand.bench.load.fed[1]:.4g} A still flow a second after stop_now()")


def reports_disconnection(stand: Stand) -> None:
    """The driver reports within three seconds that a supply has stopped answering, or gives no more readings."""
    open_and_switch_on(stand)
    stand.cut()
    end, reading_count = stand.clock.now() + 3.0, 0
    with suppress(DeviceError):
        while stand.clock.now() < end:
            rows = list(stand.driver.take())
            if stand.clock.now() > end - 1.0:
                reading_count += sum(
                    1 for row in rows if not all(math.isnan(value) for value in getattr(row, "values", ()))
                )
            stand.wait(POLL_S)
        if reading_count:
            raise Broken(
                f"{reading_count} readings have come in the last second of three although the cable is unplugged"
            )


TRIALS = (
    is_off_until_switched_on,
    outputs_its_set_levels,
    keeps_below_its_protection,
    switches_off,
    refuses_levels_out_of_range,
    is_off_when_confirmed_safe,
    never_confirms_an_output_that_is_on,
    never_confirms_over_a_cut_cable,
    is_cut_by_stop_now,
    reports_disconnection,
)
