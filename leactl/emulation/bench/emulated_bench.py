"""An emulated bench made from a bench file: the plant, the devices' emulators, and the wires that lead to them."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import can
import numpy as np

from leactl.bench.benchfile import BenchFile, CanBus, CheckedDevice, I2cBus, LineBus
from leactl.driver import registry
from leactl.driver.far_end import BuslessEmulator, Numbered, Physics, SupplyLoad
from leactl.driver.i2c_port import SmBus
from leactl.driver.serial_port import SerialLine
from leactl.emulation.bench.emulated_block import actuator_of, effect_of, merge_parameters
from leactl.emulation.clock import EmulatedClock, HostClock
from leactl.emulation.faults import make_fault
from leactl.emulation.faults.device_readings import DeviceSignals
from leactl.emulation.faults.schedule import Schedule
from leactl.emulation.plant.effects.contract import RIG_HOOKS, own_hooks
from leactl.emulation.plant.exact.rig import Actuator, Rig
from leactl.emulation.plant.exact.rig_phases import PHASES_OF_PART
from leactl.emulation.plant.noise import Noise
from leactl.emulation.plant.parameters import BenchParameters
from leactl.emulation.plant.stepped.rig import SteppedActuator, SteppedRig
from leactl.emulation.plant.supply_loads import DcLink, HeatedLeads
from leactl.emulation.plant.terminals import MotorTerminals
from leactl.emulation.wires.buses import CanWire, EmulatedCanBus, EmulatedI2cBus
from leactl.emulation.wires.serial import EmulatedSerialLine, SerialWire
from leactl.errors import InputError

TEMPERATURES = ("winding_temperature", "housing_temperature", "ambient_temperature")


_observers: "list[Callable[[EmulatedBench], None]]" = []


@contextmanager
def observed(observer: "Callable[[EmulatedBench], None]") -> Iterator[None]:
    """Call `observer` with every emulated bench that this process makes within the block.

    With it, a rehearsal checks in the plant, not by a device's report, that a drive is off once it is confirmed safe.
    """
    _observers.append(observer)
    try:
        yield
    finally:
        _observers.remove(observer)


class EmulatedMachine:
    """One actuator of the rig as its drive's sensors read it; only current and velocity have noise."""

    def __init__(
        self,
        actuator: Actuator | SteppedActuator,
        rig: Rig | SteppedRig,
        noise: Noise,
        current_noise: float,
        velocity_noise: float,
    ) -> None:
        self._actuator, self._rig, self._noise = actuator, rig, noise
        self._current_noise, self._velocity_noise = current_noise, velocity_noise
        self.command = actuator.command

    def read(self) -> tuple[float, float, float]:
        """Return the present current [A], velocity [rad/s] and angle [rad]."""
        actuator, noise = self._actuator, self._noise
        current = actuator.current + self._current_noise * noise()
        return current, actuator.velocity + self._velocity_noise * noise(), actuator.angle

    @property
    def voltage(self) -> float:
        """q-axis voltage [V]."""
        return self._actuator.voltage

    @property
    def bus_voltage(self) -> float:
        """DC link voltage [V]."""
        return self._rig.bus_voltage


class EmulatedBench:
    """The plant of a bench file in one set-up and condition, and the wires to its devices, all on one clock."""

    def __init__(
        self,
        file: BenchFile,
        devices: Sequence[CheckedDevice],
        setup: str,
        condition: str,
        seed: int | None = None,
        realtime: bool = False,
    ) -> None:
        emulated = file.emulated
        if emulated is None:
            raise InputError(f"bench '{file.name}' is a real bench; it has no `emulated:` block")
        emulated.expect(condition)
        all_faults = [make_fault(entry) for entry in emulated.faults]
        used_devices = [device.name for device in devices]  # a fault of another device is left out
        faults = [fault for fault in all_faults if getattr(fault, "device", None) in (None, *used_devices)]
        self.time = EmulatedClock(realtime)
        self.host_clock = HostClock(self.time)
        self.clock = self.host_clock if faults else self.time
        self.disk_delay_s = 0.0
        self.inactive_faults = [  # a line for each fault that does nothing if this bench is served to another process
            f"fault {fault.fault}: nothing happens, {fault.inactive_when_served}"
            for fault in faults
            if fault.inactive_when_served
        ]
        condition_changes = emulated.conditions.get(condition, {})
        chosen_seed = emulated.seed if seed is None else seed
        test = actuator_of(file, "test", merge_parameters(emulated.test, condition_changes))
        load = actuator_of(file, "load", merge_parameters(emulated.load, condition_changes))
        effects = [effect_of(entry) for entry in emulated.effects]
        bench = BenchParameters.from_mapping(emulated.bench)
        suits_exact_rig = all(set(own_hooks(effect)) <= set(RIG_HOOKS) for effect in effects)
        self.rig: Rig | SteppedRig = (
            Rig(setup, test, load, bench, chosen_seed, effects)
            if suits_exact_rig
            else SteppedRig(setup, test, load, bench, effects)
        )
        self.time.follow(self.rig.advance)
        self._file, self._settings, self._seed = file, emulated, chosen_seed
        self._noise_stream_count = 1
        self.machines = {role: self._machine(role) for role in ("test", "load")}
        self.wires = {name: CanWire(self.time) for name, bus in file.buses.items() if isinstance(bus, CanBus)}
        self.i2c_buses = {
            name: EmulatedI2cBus(self.time) for name, bus in file.buses.items() if isinstance(bus, I2cBus)
        }
        self.bus_of = {device.name: device.entry.bus or "" for device in devices}
        self.serial_wires = {
            name: SerialWire(self.time, bus.byte_s) for name, bus in file.buses.items() if isinstance(bus, LineBus)
        }
        self.far_ends: dict[str, Any] = {}
        self.signals: dict[str, DeviceSignals] = {}
        for device in devices:
            self._attach(device, bool(faults))
        Schedule(self, faults, chosen_seed)
        for observer in _observers:
            observer(self)

    def can(self, name: str, bus: CanBus) -> Callable[[], can.BusABC]:
        """Return a function that connects to an emulated CAN bus."""
        return lambda: EmulatedCanBus(self.wires[name])

    def i2c(self, name: str, bus: I2cBus) -> Callable[[], SmBus]:
        """Return a function that connects to an emulated I2C bus."""
        return lambda: self.i2c_buses[name]

    def emulator_of(self, device: str) -> Any:
        """Return the emulator of a device without a bus, which replaces the maker's library."""
        return self.far_ends[device]

    def wait_for_disk(self) -> None:
        """Wait for the delay of a slow disk, by the wall clock."""
        if self.disk_delay_s:
            time.sleep(self.disk_delay_s)

    def apply_weight_torque(self, torque: float) -> None:
        """Apply the torque of weights [N*m] to the torque sensor."""
        self.rig.hung_torque = torque

    def serial(self, name: str, bus: LineBus) -> Callable[[], SerialLine]:
        """Return a function that connects to an emulated serial line."""
        return lambda: EmulatedSerialLine(self.serial_wires[name])

    def at_supply(self, feeds: str, role: str) -> SupplyLoad:
        """Return the load at the terminals of a power supply.

        Raises
        ------
        InputError : the supply feeds the leads of another motor than 'test'.
        """
        if feeds == "bus":
            return DcLink(self.rig)
        if role != "test":
            raise InputError(f"an emulated supply feeds leads of 'test', not of '{role}'")
        return HeatedLeads(self.rig)

    def terminals(self, role: str) -> MotorTerminals:
        """Return the three leads of this role's motor.

        Raises
        ------
        InputError : the bench has no such motor.
        """
        if role not in self.rig.actuators:
            raise InputError(f"the emulated bench has motors 'test' and 'load', not '{role}'")
        settings, self._noise_stream_count = self._settings, self._noise_stream_count + 1
        generator = np.random.default_rng([self._seed, self._noise_stream_count])
        harmonics, voltage_noise = settings.back_emf_harmonics, settings.terminal_noise_V
        leads = MotorTerminals(self.rig.actuators[role], harmonics, voltage_noise, generator)
        leads.sample(self.time.now())
        self.time.follow(leads.sample)
        return leads

    def machine(self, role: str) -> EmulatedMachine:
        """Return the machine that the drive of this role turns.

        Raises
        ------
        InputError : the role is neither 'test' nor 'load'.
        """
        if role not in self.machines:
            raise InputError(f"an emulated drive turns 'test' or 'load', not '{role}'")
        return self.machines[role]

    def reading(self, quantity: str, role: str, location: str = "") -> Callable[[], float]:
        """Return a function that gives the present reading of a quantity's sensor.

        Raises
        ------
        InputError : the bench has no such quantity for this role.
        """
        rig, noise = self.rig, self._fresh_noise()
        if quantity == "torque" and role == "test":
            torque_noise = self._settings.torque_noise_Nm
            return lambda: rig.shaft_torque + torque_noise * noise()
        if quantity.endswith("_temperature"):
            return self._thermometer(quantity, role, location, noise)
        plain_readings: Mapping[str, Callable[[], float]] = {
            "line_current": lambda: rig.line_current,
            "line_voltage": lambda: rig.line_voltage,
            "bus_voltage": lambda: rig.bus_voltage,
        }
        if quantity not in plain_readings:
            raise InputError(f"the emulated bench has no {quantity} of '{role}' for an analogue sensor")
        return plain_readings[quantity]

    def _thermometer(self, quantity: str, role: str, location: str, noise: Noise) -> Callable[[], float]:
        """Return a function that gives a temperature sensor's reading, with the bench file's offset, gain and noise."""
        rig, settings, quantity_of_role = self.rig, self._settings, f"{quantity} of '{role}'"
        if role not in rig.actuators or quantity not in TEMPERATURES:
            raise InputError(
                f"the emulated bench has no {quantity_of_role}; it has {', '.join(TEMPERATURES)} of test and load"
            )
        actuator, ambient, winding_part = rig.actuators[role], rig.bench.ambient_temperature, location.partition("_")[0]
        temperature_noise, offset, gain = (
            settings.temperature_noise_K,
            settings.temperature_offset_K,
            settings.temperature_gain,
        )
        if quantity == "ambient_temperature":
            return lambda: ambient + offset + temperature_noise * noise()
        if quantity == "winding_temperature" and winding_part in PHASES_OF_PART:
            return lambda: (
                ambient
                + offset
                + gain * (rig.part_of_winding(role, winding_part) - ambient)
                + temperature_noise * noise()
            )
        return lambda: ambient + offset + gain * (getattr(actuator, quantity) - ambient) + temperature_noise * noise()

    def _fresh_noise(self) -> Noise:
        """Return noise that is independent of all noise before."""
        self._noise_stream_count += 1
        return Noise(self._seed, self._noise_stream_count)

    def _machine(self, role: str) -> EmulatedMachine:
        """Return the actuator of a role as its drive reads it, with the noise of the bench file."""
        settings = self._settings
        actuator = self.rig.actuators[role]
        return EmulatedMachine(
            actuator, self.rig, self._fresh_noise(), settings.current_noise_A, settings.velocity_noise_rad_s
        )

    def _attach(self, device: CheckedDevice, has_faults: bool) -> None:
        """Make the emulator of a device and connect it to its wire, or to the clock if it has no bus."""
        entry = device.entry
        physics: Physics = self
        if has_faults:
            physics = self.signals[device.name] = DeviceSignals(self)
        far_end: Any = registry.load(entry.driver).far_end(device.settings, entry.role, physics)
        if entry.bus in self.wires:
            self.wires[entry.bus].attach(far_end)
        elif entry.bus in self.i2c_buses:
            address, far_end = far_end
            self.i2c_buses[entry.bus].devices[address] = far_end
        elif entry.bus in self.serial_wires:
            self.serial_wires[entry.bus].device = far_end
        else:
            self._keep_time(far_end)
        if entry.serial and isinstance(far_end, Numbered):
            far_end.serial_number = entry.serial
        self.far_ends[device.name] = far_end

    def _keep_time(self, far_end: BuslessEmulator) -> None:
        """Let the clock drive an emulator that has no wire to do so."""
        self.time.follow(far_end.tick)
        self.time.stop_at(lambda: far_end.due)
