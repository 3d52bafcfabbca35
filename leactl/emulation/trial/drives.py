"""Requirements on every drive: true readings, the commanded motion, and off when it confirms to be off."""

import math
from collections.abc import Callable
from contextlib import suppress

from leactl.driver.contract import SAFE_STATE_S, Mode, Row, SampleBlock
from leactl.driver.far_end import Breakable
from leactl.emulation.trial.stand import ANSWER_S, PERIOD_S, Broken, Stand
from leactl.errors import DeviceError, InputError, LeactlError

ENGAGE_S = 5.0  # time for a drive to enter operation or to report that it cannot
NOTICE_S = 3.0  # time for the driver to report a drive that has stopped answering
CHANGE_PER_CYCLE = {"q_axis_current": 0.2, "velocity": 0.5, "angle": 0.05}  # A, rad/s, rad
# largest error of a reading: a share of the true value, plus a resolution in A, rad/s, rad or V
VALUE_TOLERANCE = 0.01
RESOLUTIONS = {"q_axis_current": 0.05, "velocity": 0.02, "angle": 0.002}
VOLTAGE_RESOLUTION = 0.1  # V
SETPOINT_RESOLUTION = 0.05  # A, rad/s or rad: largest difference of a setpoint at the machine
SETPOINTS = {
    Mode.CURRENT: ("current", 1.5),
    Mode.TORQUE_PROFILE: ("current", 1.5),
    Mode.VELOCITY: ("velocity", 2.0),
    Mode.ANGLE: ("angle", 0.5),
}
LONGEST_RAMP_S, RAMP_CYCLES = 10.0, 5  # time of a ramp; cycles of a constant setpoint, from which it has ended
FEWEST_ROWS, LONGEST_ROWS_S = 2, 20.0  # of a stream since the machine has changed; time for them to arrive
UNIT_MISTAKES = {
    "turns for radians": 1 / (2 * math.pi),
    "radians for turns": 2 * math.pi,
    "degrees for radians": 180 / math.pi,
    "radians for degrees": math.pi / 180,
    "revolutions a minute for rad/s": 30 / math.pi,
    "rad/s for revolutions a minute": math.pi / 30,
    "the other sense": -1.0,
    "milli-units": 1000.0,
    "amplitude for power-invariant current": math.sqrt(2 / 3),
    "power-invariant for amplitude current": math.sqrt(3 / 2),
    "r.m.s. for power-invariant current": math.sqrt(1 / 3),
    "power-invariant for r.m.s. current": math.sqrt(3),
}
TRUE_VALUES = ((3.0, 2.0, 0.75), (-1.5, -4.0, 1.5), (0.5, 1.0, -0.5))  # A, rad/s, rad


def modes_of(stand: Stand) -> list[Mode]:
    """Return the modes that the drive accepts; raise Broken if there are none."""
    modes = []
    for mode in SETPOINTS:
        with suppress(InputError):
            stand.motion.engage(mode)
            stand.motion.release()
            modes.append(mode)
    if not modes:
        raise Broken(f"engages in none of {', '.join(SETPOINTS)}")
    return modes


def engage(stand: Stand, mode: Mode) -> None:
    """Bring the drive into operation; raise Broken if it takes longer than `ENGAGE_S`."""
    stand.motion.engage(mode)
    for _ in stand.cycles(ENGAGE_S):
        if stand.motion.engaged:
            return
    raise Broken(f"engage({mode}) has not led to operation after {ENGAGE_S:g} s, and no error was raised")


def enter_operation(stand: Stand) -> Mode:
    """Open the drive and let it follow a setpoint; return the mode."""
    stand.driver.open()
    mode = modes_of(stand)[0]
    engage(stand, mode)
    stand.motion.command(SETPOINTS[mode][1])
    stand.cycle()
    stand.cycle()
    return mode


def reads_si_units(stand: Stand) -> None:
    """The q-axis current in power-invariant A, the velocity in rad/s and the angle in rad equal those of the machine.

    The drive is in operation, because a drive that is off may report no current.
    """
    enter_operation(stand)
    for true_values in TRUE_VALUES:
        machine = stand.machine
        machine.current, machine.velocity, machine.angle = true_values
        for _ in range(3):
            stand.cycle()
        for quantity, true_value in zip(RESOLUTIONS, true_values, strict=True):
            expect_true_value(quantity, stand.read(quantity), true_value)


def expect_true_value(quantity: str, reading: float, true_value: float) -> None:
    """Raise Broken if a reading is missing or differs from the true value."""
    if math.isnan(reading):
        raise Broken(f"{quantity} is missing, or NaN although the drive answers")
    if abs(reading - true_value) <= VALUE_TOLERANCE * abs(true_value) + RESOLUTIONS[quantity]:
        return
    raise Broken(f"{quantity} reads {reading:.6g} where {true_value:g} is true{unit_hint(reading, true_value)}")


def unit_hint(reading: float, true_value: float) -> str:
    """Return a question that names the likely mistake of units; empty if no known factor explains the reading."""
    for mistake, factor in UNIT_MISTAKES.items():
        if abs(reading - factor * true_value) <= 2.0 * VALUE_TOLERANCE * abs(factor * true_value):
            return f": {mistake}?"
    return ""


def reads_each_sample_once(stand: Stand) -> None:
    """Each cycle reads the sample of that cycle, not of an earlier one.

    The drive is in operation, because a drive that is off may report no current.
    """
    enter_operation(stand)
    machine = stand.machine
    machine.current, machine.velocity, machine.angle = 0.0, 0.0, 0.0
    stand.cycle()
    stand.cycle()
    for cycle_number in range(1, 40):
        machine.current, machine.velocity, machine.angle = (
            change_per_cycle * cycle_number for change_per_cycle in CHANGE_PER_CYCLE.values()
        )
        stand.cycle()
        for quantity, change_per_cycle in CHANGE_PER_CYCLE.items():
            reading, true_value = stand.read(quantity), change_per_cycle * cycle_number
            if math.isnan(reading) or abs(reading - true_value) > VALUE_TOLERANCE * true_value + RESOLUTIONS[quantity]:
                raise Broken(
                    f"{quantity} reads {reading:.4g} in the cycle in which {true_value:g} is true,"
                    f" {cycle_number - reading / change_per_cycle:.2g} behind"
                )


def streams_read_true_values(stand: Stand) -> None:
    """Voltages that are read at their own rate, or with the readings of a cycle, equal the machine's, in V."""
    enter_operation(stand)
    for bus_voltage, voltage in ((29.6, 3.25), (27.0, -2.0)):
        stand.machine.bus_voltage, stand.machine.voltage = bus_voltage, voltage
        true_values = {"bus_voltage": bus_voltage, "q_axis_voltage": voltage}
        for quantity, reading in newest_values(stand).items():
            if quantity not in true_values:
                continue
            true_value = true_values[quantity]
            if not abs(reading - true_value) <= VALUE_TOLERANCE * abs(true_value) + VOLTAGE_RESOLUTION:
                raise Broken(
                    f"{quantity} reads {reading:.6g} where {true_value:g} is true{unit_hint(reading, true_value)}"
                )


def newest_values(stand: Stand) -> dict[str, float]:
    """Return the newest value of each quantity after some cycles; raise Broken if a stream has too few rows."""
    start_time, rows = stand.clock.now(), {spec.name: list[Row]() for spec in stand.driver.streams}
    for _ in stand.cycles(LONGEST_ROWS_S):
        for item in stand.driver.take():
            row = item.last if isinstance(item, SampleBlock) else item
            if row.time >= start_time:
                rows[row.stream].append(row)
        if all(len(rows_of_stream) >= FEWEST_ROWS for rows_of_stream in rows.values()):
            break
    else:
        stream, rows_of_stream = min(rows.items(), key=lambda item: len(item[1]))
        raise Broken(f"{stream}: {len(rows_of_stream)} rows in {LONGEST_ROWS_S:g} s of operation")
    values = {channel.quantity: stand.read(channel.quantity) for channel in stand.motion.loop_channels}
    for spec in stand.driver.streams:
        values |= {
            channel.quantity: value for channel, value in zip(spec.channels, rows[spec.name][-1].values, strict=True)
        }
    return values


def reads_nan_from_a_silent_drive(stand: Stand) -> None:
    """A drive that stops answering gives NaN, and the driver reports it."""
    stand.driver.open()
    stand.cycle()
    freeze(stand)
    stand.machine.velocity = 9.0
    end = stand.clock.now() + NOTICE_S
    with suppress(DeviceError):
        while stand.clock.now() < end:
            stand.cycle()
            reading = stand.read("velocity")
            if not math.isnan(reading):
                raise Broken(f"velocity still reads {reading:.4g} after the drive has fallen silent; NaN was expected")
        raise Broken(f"a drive that has been silent for {NOTICE_S:g} s was not reported")


def freeze(stand: Stand) -> None:
    """Make the far end stop answering while its output goes on; unplug the cable if it cannot be frozen."""
    if isinstance(stand.far_end, Breakable):
        stand.far_end.freeze(True)
    else:
        stand.cut()


def reports_whether_it_is_engaged(stand: Stand) -> None:
    """`engaged` reports the state of the drive: false before operation, after release, and in a fault."""
    stand.driver.open()
    stand.cycle()
    if stand.motion.engaged:
        raise Broken("engaged is true before anything was engaged")
    mode = modes_of(stand)[0]
    stand.motion.engage(mode)
    if stand.motion.engaged:
        raise Broken("engaged is true before the drive has entered operation")
    engage(stand, mode)
    stand.motion.release()
    for _ in stand.cycles(1.0):
        if not stand.motion.engaged:
            break
    else:
        raise Broken("engaged is true a second after release()")
    if isinstance(stand.far_end, Breakable):
        engage(stand, mode)
        stand.far_end.fault(0x2310)
        with suppress(DeviceError):
            for _ in stand.cycles(1.0):
                if not stand.motion.engaged:
                    return
            raise Broken("engaged is true a second after the drive has gone into fault")


def follows_its_setpoint(stand: Stand) -> None:
    """A setpoint reaches the machine in its SI unit and with its sign; the first is zero."""
    stand.driver.open()
    for mode in modes_of(stand):
        stand.machine.angle = 0.25
        engage(stand, mode)
        expected_mode, value = SETPOINTS[mode]
        for setpoint in (value, -value):
            stand.motion.command(setpoint)
            followed_mode, final_value = final_setpoint(stand, mode)
            if followed_mode != expected_mode:
                raise Broken(f"the machine follows '{followed_mode}' where '{mode}' was engaged")
            if abs(final_value - setpoint) > VALUE_TOLERANCE * abs(setpoint) + SETPOINT_RESOLUTION:
                likely_mistakes = [
                    mistake
                    for mistake, factor in UNIT_MISTAKES.items()
                    if abs(final_value - factor * setpoint) <= 0.02 * abs(final_value)
                ]
                hint = f": {likely_mistakes[0]}?" if likely_mistakes else ""
                raise Broken(f"{mode}: {final_value:.6g} arrives where {setpoint:g} was commanded{hint}")
        stand.motion.release()
        for _ in stand.cycles(0.5):
            pass
        if stand.machine.following[0] != "off":
            raise Broken(f"{mode}: the machine still follows {stand.machine.following} half a second after release()")


def final_setpoint(stand: Stand, mode: Mode) -> tuple[str, float]:
    """Return the machine's mode and setpoint two cycles after a command; those of a ramp, once they are constant."""
    stand.cycle()
    stand.cycle()
    mode_and_setpoint = stand.machine.following
    if mode is not Mode.TORQUE_PROFILE:
        return mode_and_setpoint
    constant_cycles = 0
    for _ in stand.cycles(LONGEST_RAMP_S):
        constant_cycles = constant_cycles + 1 if stand.machine.following == mode_and_setpoint else 0
        mode_and_setpoint = stand.machine.following
        if constant_cycles == RAMP_CYCLES:
            return mode_and_setpoint
    raise Broken(f"{mode}: the machine still changes what it follows {LONGEST_RAMP_S:g} s after command()")


def begins_at_rest(stand: Stand) -> None:
    """Operation begins with zero current and zero speed, or at the present angle of the shaft."""
    stand.driver.open()
    for mode in modes_of(stand):
        stand.machine.angle = 0.7
        engage(stand, mode)
        followed_mode, initial_setpoint = stand.machine.following
        expected_setpoint = 0.7 if mode is Mode.ANGLE else 0.0
        if followed_mode != "off" and abs(initial_setpoint - expected_setpoint) > 0.01:
            raise Broken(f"{mode}: begins at {initial_setpoint:.4g}, {expected_setpoint:g} was expected")
        stand.motion.release()
        for _ in stand.cycles(0.2):
            pass


def refuses_setpoints_out_of_range(stand: Stand) -> None:
    """A setpoint that is not finite, or beyond what the device can hold, is refused, not clipped."""
    stand.driver.open()
    for mode in modes_of(stand):
        engage(stand, mode)
        for value in (math.nan, math.inf, -math.inf, 1e12):
            try:
                stand.motion.command(value)
            except InputError:
                continue
            except Exception as error:  # noqa: BLE001 (whatever a driver raises in the place of the one error)
                raise Broken(
                    f"{mode}: command({value}) raises {type(error).__name__}; InputError was expected"
                ) from None
            raise Broken(f"{mode}: command({value}) is taken; InputError was expected")
        stand.motion.release()
        for _ in stand.cycles(0.2):
            pass


def call_safe_state(stand: Stand, deadline: float = SAFE_STATE_S) -> bool:
    """Call `safe_state` and return whether it confirms; raise Broken if it raises or exceeds the deadline."""
    start_time = stand.clock.now()
    try:
        confirmation = stand.driver.safe_state(deadline)
    except Exception as error:  # noqa: BLE001 (it must never raise)
        raise Broken(f"safe_state raises {type(error).__name__}: {error}") from None
    duration = stand.clock.now() - start_time
    if duration > deadline + 0.05:
        raise Broken(f"safe_state({deadline:g}) takes {duration:.2f} s")
    return bool(confirmation.safe)


def is_off_when_confirmed_safe(stand: Stand) -> None:
    """`safe_state` takes the power away, in operation, before `open`, and when it is called again."""
    check_off_when_confirmed(stand, "before open()")
    enter_operation(stand)
    check_off_when_confirmed(stand, "in operation")
    check_off_when_confirmed(stand, "the second time")


def check_off_when_confirmed(stand: Stand, when: str) -> None:
    """Make a drive that answers safe; raise Broken if that is not confirmed, or the machine is not off."""
    if not call_safe_state(stand):
        raise Broken(f"safe_state {when} is not confirmed although the drive answers")
    if stand.machine.following[0] != "off":
        raise Broken(f"safe_state {when} is confirmed while the machine follows {stand.machine.following}")


def never_confirms_a_silent_drive(stand: Stand) -> None:
    """`safe_state` is not confirmed if the drive does not answer, and returns by its deadline."""
    check_unconfirmed_in_silence(stand, freeze)


def never_confirms_over_a_cut_cable(stand: Stand) -> None:
    """`safe_state` is not confirmed if the cable is unplugged."""
    check_unconfirmed_in_silence(stand, Stand.cut)


def check_unconfirmed_in_silence(stand: Stand, silence: Callable[[Stand], None]) -> None:
    """Silence a drive in operation; raise Broken if `safe_state` confirms while the machine runs."""
    enter_operation(stand)
    silence(stand)
    if call_safe_state(stand) and stand.machine.following[0] != "off":
        raise Broken("safe_state is confirmed by a drive that answers nothing and goes on")


def is_cut_by_stop_now(stand: Stand) -> None:
    """`stop_now` sends the command that takes the power away, and does not wait."""
    enter_operation(stand)
    start_time = stand.clock.now()
    stand.driver.stop_now()
    if stand.clock.now() > start_time:
        raise Broken(f"stop_now waits for {stand.clock.now() - start_time:.3f} s; it must not wait")
    stand.wait(ANSWER_S)
    if stand.machine.following[0] != "off":
        raise Broken(f"the machine still follows {stand.machine.following} after stop_now()")


def stops_without_its_host(stand: Stand) -> None:
    """A drive that monitors its host stops within the declared time once nothing arrives, and not before."""
    check_stop_without_host(stand, lambda seconds: stand.wait(seconds + PERIOD_S))


def stops_unless_it_is_fed(stand: Stand) -> None:
    """A drive that monitors its host also stops if the cycles continue but nobody calls `feed`."""

    def go_on(seconds: float) -> None:
        end = stand.clock.now() + seconds + PERIOD_S
        with suppress(DeviceError):  # the driver reports the stop as a fault
            for _ in stand.cycles(seconds + PERIOD_S, feed=False):
                pass
        stand.clock.sleep_until(end)

    check_stop_without_host(stand, go_on)


def check_stop_without_host(stand: Stand, let_pass: Callable[[float], None]) -> None:
    """Raise Broken if a drive in operation has not stopped once `let_pass` let time [s] pass without a host."""
    silence_s = stand.settings.host_silence_s
    if silence_s is None:
        return
    enter_operation(stand)
    for _ in stand.cycles(6.0 * silence_s):
        pass
    if not stand.motion.engaged:
        raise Broken(
            f"leaves operation although feed() is called every {PERIOD_S:g} s; host_silence_s is {silence_s:g} s"
        )
    let_pass(1.2 * silence_s)
    if stand.machine.following[0] != "off":
        raise Broken(
            f"the machine still follows {stand.machine.following} {1.2 * silence_s:.3g} s after the host's last sign;"
            f" host_silence_s says {silence_s:g} s"
        )


def can_be_closed_and_reopened(stand: Stand) -> None:
    """The driver may be closed before it is opened, closed twice, and opened again."""
    stand.driver.close()
    enter_operation(stand)
    check_off_when_confirmed(stand, "in operation")
    try:
        stand.driver.close()
        stand.driver.close()
    except LeactlError as error:
        raise Broken(f"close() raises where it is closed already: {error}") from None
    enter_operation(stand)


TRIALS = (
    reads_si_units,
    reads_each_sample_once,
    streams_read_true_values,
    reads_nan_from_a_silent_drive,
    reports_whether_it_is_engaged,
    begins_at_rest,
    follows_its_setpoint,
    refuses_setpoints_out_of_range,
    is_off_when_confirmed_safe,
    never_confirms_a_silent_drive,
    never_confirms_over_a_cut_cable,
    is_cut_by_stop_now,
    stops_without_its_host,
    stops_unless_it_is_fed,
    can_be_closed_and_reopened,
)
