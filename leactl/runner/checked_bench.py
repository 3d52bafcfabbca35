"""Reading of a bench file with every check that does not depend on a protocol; no device is touched.

`leactl bench check` and every command that uses a bench read it here.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence

from leactl.bench import benchfile
from leactl.bench.bench import Bench, require_channels_for_interlocks
from leactl.bench.benchfile import BenchFile, CanBus, CheckedDevice, host_silences
from leactl.bench.wiring import MachineWiring, unknown_interface
from leactl.driver.contract import SAFE_STATE_S
from leactl.emulation.bench.emulated_block import check_emulated
from leactl.errors import InputError
from leactl.model.motor import Motor, load_motor
from leactl.quantities import ChannelSpec
from leactl.runner.thermal_admission import STOP_DELAY_S
from leactl.safety.thermal.box import Box
from leactl.yamlfile import Document

HAS_LOCATION = re.compile(r"\S.*?:\d+:\d+  ")  # file:line:column
HOTTEST_PHASE_FACTOR = 2.0  # heat of the hottest phase at standstill over the mean heat of the three phases


def load_checked(name_or_path: str) -> tuple[BenchFile, list[CheckedDevice], Document]:
    """Read a bench and check all of it.

    Raises
    ------
    InputError : no such bench, or faults in it, in a motor file or in the `emulated:` block; one line each with file,
        line and column.
    """
    file, devices, document = benchfile.load(name_or_path)
    motors = _motors(file, document)
    faults = [*_unknown_interfaces(file, document), *_burnt_before_the_end(file, devices, document, motors)]
    try:
        check_emulated(file, devices, document)
    except InputError as error:
        faults += error.faults
    try:
        bench = Bench(file, devices, MachineWiring())
        faults += _alike_channels(bench, devices, document)
        require_channels_for_interlocks(bench, document)
    except InputError as error:
        faults += error.faults
    if faults:
        raise InputError(faults)
    return file, devices, document


def _unknown_interfaces(file: BenchFile, document: Document) -> Iterator[str]:
    """Yield a fault for each CAN interface that python-can lacks; an emulated bench replaces its interfaces."""
    for name, bus in file.buses.items() if file.emulated is None else ():
        if isinstance(bus, CanBus) and (fault := unknown_interface(bus)):
            yield document.fault(("buses", name, "interface"), fault)


def _alike_channels(bench: Bench, devices: Sequence[CheckedDevice], document: Document) -> Iterator[str]:
    """Yield a fault for each channel with quantity, role and location of another: no run file can hold both."""
    settings = {device.name: device.settings for device in devices}
    first_by_identity: dict[tuple[str, str, str], ChannelSpec] = {}
    for channel in (channel for stream in bench.streams().values() for channel in stream):
        first_channel = first_by_identity.setdefault((channel.quantity, channel.role, channel.location), channel)
        if channel.quantity and first_channel is not channel:
            matching_ranges = [
                item.place for item in settings[channel.device].shown() if item.quantity == channel.quantity
            ]
            yield document.fault(
                ("devices", channel.device, "settings", *(matching_ranges[-1][:2] if matching_ranges else ())),
                f"{channel.quantity} of {channel.role} is measured by {first_channel.device} too; another role or"
                " location was expected",
            )


def _motors(file: BenchFile, document: Document) -> Mapping[str, Motor]:
    """Return the motors of a bench by the roles that its file names.

    Raises
    ------
    InputError : an unknown motor, faults in its file, or a file without tolerances.
    """
    motors: dict[str, Motor] = {}
    faults: list[str] = []
    for role, name in file.motors.items():
        try:
            motors[role] = load_motor(name)[0]
            Box.of(motors[role])
        except InputError as error:
            for text in error.faults:
                line = text if HAS_LOCATION.match(text) else document.fault(("motors", role), text)
                faults += [line] if line not in faults else []
    if faults:
        raise InputError(faults)
    return motors


def _burnt_before_the_end(
    file: BenchFile, devices: Sequence[CheckedDevice], document: Document, motors: Mapping[str, Motor]
) -> Iterator[str]:
    """Yield a fault for a current limit at which a winding passes its limit before a drive without its host stops."""
    silences = [silence for silence in host_silences(devices).values() if silence is not None]
    silent_s = max(silences, default=SAFE_STATE_S) + STOP_DELAY_S
    ambient, limits = file.limits.ambient_temperature_degC, file.limits
    currents = {}
    for role, motor in motors.items():
        rise = min(limits.winding_temperature_degC, motor.limits.winding_temperature) - ambient
        heat = HOTTEST_PHASE_FACTOR * motor.phase_resistance * silent_s  # for each square of the current
        currents[role] = math.sqrt(motor.thermal.winding_capacitance * max(rise, 0.0) / heat)
    role = min(currents, key=lambda name: currents[name])
    if limits.current_A > currents[role]:
        yield document.fault(
            ("limits", "current_A"),
            f"{limits.current_A:g} A takes the {role} winding to its temperature limit within the {silent_s:.3g} s that"
            f" a drive without its host goes on; at most {currents[role]:.3g} A was expected",
        )
