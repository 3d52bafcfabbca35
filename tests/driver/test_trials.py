"""`leactl driver check` makes a driver and its far end: one planted defect each is found, sound drivers pass."""

import math
import os
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from leactl_plugins.ads1115.driver import Ads1115
from leactl_plugins.elmo_can.commissioning import Commissioning
from leactl_plugins.elmo_can.driver import ElmoCan
from leactl_plugins.elmo_can.probe import ElmoProbe
from leactl_plugins.elmo_recorder_csv.driver import ElmoRecorderCsv
from leactl_plugins.ni_daq.driver import NiDaq
from leactl_plugins.scpi_supply.driver import ScpiSupply

from leactl.driver import conformance, registry
from leactl.driver.contract import Confirmation, Driver, DriverSettings, Identity, Mode
from leactl.driver.probe import Sighting
from leactl.emulation.trial import measuring_devices, probing, running
from leactl.emulation.trial.known_bench import BASES, RISE
from leactl.emulation.trial.running import run_in_this_process, trial_name, try_driver
from leactl.emulation.trial.stand import Broken
from leactl.errors import DeviceError, InputError

CURRENT, ANGLE, VELOCITY = 3, 5, 4  # among the values of the drive


class Sound(ElmoCan):
    """The drive as it is."""


class SafeInWords(ElmoCan):
    """Says that it is safe and does nothing for it."""

    def safe_state(self, deadline_s):
        return Confirmation(True, "quite safe")


class SafeUnheard(ElmoCan):
    """Takes silence for consent."""

    def safe_state(self, deadline_s):
        super().safe_state(deadline_s)
        return Confirmation(True, "told to be safe")


class SafeSlowly(ElmoCan):
    """Waits by a clock of its own."""

    def safe_state(self, deadline_s):
        time.sleep(30)
        return super().safe_state(deadline_s)


class SafeLate(ElmoCan):
    """Waits for longer than it may."""

    def safe_state(self, deadline_s):
        self._clock.sleep_until(self._clock.now() + 3.0)
        return super().safe_state(deadline_s)


class SafeByRaising(ElmoCan):
    """Raises where a device does not answer."""

    def safe_state(self, deadline_s):
        confirmation = super().safe_state(deadline_s)
        if not confirmation.safe:
            raise DeviceError(confirmation.detail)
        return confirmation


class Stale(ElmoCan):
    """Gives its first sample for ever."""

    kept = None

    def end_cycle(self, deadline):
        super().end_cycle(deadline)
        self.kept = self.kept or list(self.values)
        self.values[:] = self.kept


class OneBehind(ElmoCan):
    """Gives each sample a cycle late."""

    before = None

    def end_cycle(self, deadline):
        super().end_cycle(deadline)
        now = list(self.values)
        self.values[:] = self.before or now
        self.before = now


class Turns(ElmoCan):
    """Tells turns."""

    def end_cycle(self, deadline):
        super().end_cycle(deadline)
        self.values[ANGLE] /= 2 * math.pi


class Degrees(ElmoCan):
    """Tells degrees a second."""

    def end_cycle(self, deadline):
        super().end_cycle(deadline)
        self.values[VELOCITY] *= 180 / math.pi


class AlwaysEngaged(ElmoCan):
    """Is engaged in its own opinion."""

    @property
    def engaged(self):
        return True

    @engaged.setter
    def engaged(self, value): ...


class Reversed(ElmoCan):
    """Commands the other sense."""

    def command(self, value):
        super().command(-value)


class Clips(ElmoCan):
    """Brings what it cannot follow to what it can."""

    def command(self, value):
        super().command(0.0 if not math.isfinite(value) else max(-1.0, min(1.0, value)))


class Unguarded(ElmoCan):
    """Says that it stops without its host, and has armed nothing."""

    def _setup(self):
        setup = super()._setup()
        setup.arm_dead_man = lambda: None
        return setup


class HoldsOldValues(ElmoCan):
    """Goes on with the last reading of a drive that has fallen silent."""

    def _clear_missing(self, now):
        self._answers.end(now)


class OldCurrentAndAngle(ElmoCan):
    """Gives the velocity of this cycle with the current and the angle of the one before the last."""

    def end_cycle(self, deadline):
        super().end_cycle(deadline)
        read = self.values[CURRENT], self.values[ANGLE]
        self.before = [*getattr(self, "before", [read, read]), read][-3:]
        self.values[CURRENT], self.values[ANGLE] = self.before[0]


class MillivoltsOfTheBus(ElmoCan):
    """Gives the voltage of its DC link in mV."""

    def take(self):
        return [row._replace(values=tuple(1000 * value for value in row.values)) for row in super().take()]


class FirstVoltageOfTheBus(ElmoCan):
    """Gives the first voltage of its DC link for ever."""

    kept = None

    def take(self):
        rows = super().take()
        self.kept = self.kept or (rows and rows[0].values)
        return [row._replace(values=self.kept) for row in rows]


class ReversedProfile(ElmoCan):
    """Commands the other sense and ten times the current where the drive ramps it."""

    factor = 1.0

    def engage(self, mode):
        super().engage(mode)
        self.factor = -10.0 if mode is Mode.TORQUE_PROFILE else 1.0

    def command(self, value):
        super().command(self.factor * value)


class FeedsItself(ElmoCan):
    """Sends the host's sign of life with every cycle."""

    def begin_cycle(self):
        self.feed()
        super().begin_cycle()


class CutsLate(ElmoCan):
    """Waits in `stop_now`."""

    def stop_now(self):
        self.safe_state(1.0)
        self._clock.sleep_until(self._clock.now() + 0.1)


class ClosesOnce(ElmoCan):
    """Complains where it is closed already."""

    def close(self):
        if not self._opened:
            raise DeviceError("closed already")
        super().close()


class TakesAllWithIt(ElmoCan):
    """Ends the process."""

    def open(self):
        os._exit(0)


class MilliUnits(Ads1115):
    """Gives thousandths."""

    def take(self):
        return [row._replace(values=tuple(1000 * value for value in row.values)) for row in super().take()]


class Repeats(Ads1115):
    """Gives each conversion twice."""

    def take(self):
        return [row for row in super().take() for _ in range(2)]


class StampsNow(Ads1115):
    """Stamps a sample with a moment at which it was not there yet."""

    def take(self):
        return [row._replace(time=row.time + 0.5) for row in super().take()]


class FirstReading(Ads1115):
    """Gives the first reading of a thermometer for ever, under new stamps."""

    example: ClassVar = {
        "inputs": [Ads1115.example["inputs"][0] | {"quantity": "ambient_temperature", "scale_per_V": 10.0}]
    }

    def take(self):
        rows = super().take()
        self.kept = {row.stream: row.values for row in reversed(rows)} | getattr(self, "kept", {})
        return [row._replace(values=self.kept[row.stream]) for row in rows]


class Milliseconds(ElmoRecorderCsv):
    """Takes the seconds of a record for milliseconds."""

    def read_files(self, paths):
        record = super().read_files(paths)
        return replace(record, time=1000.0 * record.time)


class AlwaysSupplying(ScpiSupply):
    """Supplies in its own opinion."""

    supplying = True


class OffInWords(ScpiSupply):
    """Says that it is off."""

    def safe_state(self, deadline_s):
        return Confirmation(True, "off")


class TakesEverything(ScpiSupply):
    """Passes on whatever it is told."""

    def supply(self, voltage, current):
        if math.isfinite(voltage) and voltage >= 0 and math.isfinite(current) and current >= 0:
            super().supply(min(voltage, self.most[0]), min(current, self.most[1]))


class MostVolts(ScpiSupply):
    """Sets its highest voltage whatever it is told."""

    def supply(self, voltage, current):
        super().supply(voltage, current)
        super().supply(self.most[0], current)


class DoubleBusCurrent(ScpiSupply):
    """Gives twice the current on a DC link."""

    example = ScpiSupply.example | {"feeds": "bus"}

    def take(self):
        return [row._replace(values=(row.values[0], 2 * row.values[1])) for row in super().take()]


class Unprotected(ScpiSupply):
    """Takes the level of its protection and does nothing with it."""

    def protect(self, level): ...


class ProtectedInWords(ScpiSupply):
    """Refuses what is above the level of its protection, which the instrument does not know."""

    level = math.inf

    def protect(self, level):
        self.level = level

    def supply(self, voltage, current):
        if voltage > self.level:
            raise InputError(f"{voltage} V are above {self.level} V")
        super().supply(voltage, current)


class KeepsItsLastOnTimeOut(Ads1115):
    """Gives its last sample again where the converter does not answer."""

    kept = ()

    def take(self):
        try:
            self.kept = super().take() or self.kept
        except DeviceError:
            self.kept = [row._replace(time=self._clock.now()) for row in self.kept]
        return self.kept if self.kept and self.kept[0].time == self._clock.now() else ()


class SwapsTheUnits(ElmoCan):
    """Says that the current is in rad/s and the velocity in A."""

    @property
    def loop_channels(self):
        channels = list(super().loop_channels)
        channels[CURRENT] = channels[CURRENT]._replace(units="rad/s")
        channels[VELOCITY] = channels[VELOCITY]._replace(units="A")
        return tuple(channels)


class InventsAQuantity(Ads1115):
    """Has a channel of no quantity that analyses ask for."""

    @property
    def streams(self):
        return [
            spec._replace(channels=tuple(channel._replace(quantity="volume", units="l") for channel in spec.channels))
            for spec in super().streams
        ]


class LeavesAThread(Ads1115):
    """Reads in the background, and goes on when it is closed."""

    def open(self):
        super().open()
        threading.Thread(target=threading.Event().wait, daemon=True).start()


class LeavesAFile(Ads1115):
    """Keeps a file open."""

    def open(self):
        super().open()
        self.log = Path(os.devnull).open("rb")  # noqa: SIM115 (as a driver would that forgets it)


class OpensTwice(ElmoCan):
    """Opens its port once more than it closes it."""

    def open(self):
        super().open()
        self._port.open()


class SafeWhereConnected(ElmoCan):
    """Takes a drive that it has not opened for one that is off."""

    def safe_state(self, deadline_s):
        return super().safe_state(deadline_s) if self._opened else Confirmation(True, "not connected")


class NotSafeOnceClosed(ElmoCan):
    """Cannot be made safe again after its end."""

    closed = False

    def close(self):
        super().close()
        self.closed = True

    def safe_state(self, deadline_s):
        return Confirmation(False, "closed") if self.closed else super().safe_state(deadline_s)


class EndsLate(ElmoCan):
    """Waits on for readings that did not come by the deadline."""

    def end_cycle(self, deadline):
        super().end_cycle(deadline)
        if math.isnan(self.values[VELOCITY]):
            self._clock.sleep_until(deadline + 0.02)


class TakesItsTime(Ads1115):
    """Waits for the conversion in `take`."""

    def take(self):
        self._clock.sleep_until(self._clock.now() + 0.004)
        return super().take()


PLANTED = [
    (SafeInWords, "is off when confirmed safe", "confirmed while the machine follows"),
    (SafeUnheard, "never confirms", "answers nothing and goes on"),
    (SafeSlowly, "is off when confirmed safe", "it hangs"),
    (SafeLate, "is off when confirmed safe", "takes 3.00 s"),
    (SafeByRaising, "never confirms", "safe_state raises DeviceError"),
    (Stale, "reads each sample once", "in the cycle in which"),
    (OneBehind, "reads each sample once", "in the cycle in which"),
    (Turns, "reads si units", "turns for radians?"),
    (Degrees, "reads si units", "degrees for radians?"),
    (AlwaysEngaged, "reports whether it is engaged", "engaged is true before anything was engaged"),
    (Reversed, "follows its setpoint", "the other sense?"),
    (Clips, "refuses setpoints out of range", "command(nan) is taken"),
    (Unguarded, "stops without its host", "after the host's last sign"),
    (HoldsOldValues, "reads nan from a silent drive", "still reads"),
    (OldCurrentAndAngle, "reads each sample once", "q_axis_current reads 0 in the cycle in which 0.2 is true"),
    (MillivoltsOfTheBus, "streams read true values", "bus_voltage reads 29600 where 29.6 is true: milli-units?"),
    (FirstVoltageOfTheBus, "streams read true values", "bus_voltage reads 29.6 where 27 is true"),
    (ReversedProfile, "follows its setpoint", "torque_profile: -15.0015 arrives where 1.5 was commanded"),
    (FeedsItself, "stops unless it is fed", "after the host's last sign"),
    (CutsLate, "is cut by stop now", "stop_now waits"),
    (ClosesOnce, "can be closed and reopened", "closed already"),
    (TakesAllWithIt, "reads si units", "ended the process"),
    (MilliUnits, "measures true values", "1000 times"),
    (Repeats, "measures true values", "a sample comes twice"),
    (StampsNow, "measures true values", "before the moment at which a sample is taken"),
    (FirstReading, "measures true values", "where"),
    (Milliseconds, "reads exported files", "its unit of time?"),
    (AlwaysSupplying, "is off until switched on", "before switch_on()"),
    (OffInWords, "is off when confirmed safe", "confirmed while 2 A flow"),
    (TakesEverything, "refuses levels out of range", "is taken"),
    (MostVolts, "outputs its set levels", "1.8 V and 3 A at the terminals; 1.2 V and 2 A were expected"),
    (DoubleBusCurrent, "outputs its set levels", "bus_current reads 4 where 2 is true"),
    (Unprotected, "keeps below its protection", "as asked for, after protect(1.5)"),
    (ProtectedInWords, "keeps below its protection", "by a failure, after protect(1.5)"),
    (KeepsItsLastOnTimeOut, "reports disconnection", "although the device is unplugged"),
    (SwapsTheUnits, "declares known quantities and units", "iq: q_axis_current is in 'rad/s'; A was expected"),
    (InventsAQuantity, "declares known quantities and units", "'volume' is no quantity of the vocabulary"),
    (LeavesAThread, "releases everything when closed", "1 more threads run after close()"),
    (LeavesAFile, "releases everything when closed", "1 more files are open after close()"),
    (OpensTwice, "releases everything when closed", "its bus is still open after close()"),
    (SafeWhereConnected, "safe state stops a device left on", "continues as an earlier host left it"),
    (NotSafeOnceClosed, "releases everything when closed", "safe_state after close() is not confirmed"),
    (EndsLate, "never waits", "end_cycle() ends 0.02"),
    (TakesItsTime, "never waits", "take() ends 0.004"),
]


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(running, "TRIAL_TIMEOUT_S", 3.0)


def faults_of(driver):
    return [(tried.name, tried.fault) for tried in try_driver(driver) if tried.fault]


@pytest.mark.parametrize(("driver", "trial", "said"), PLANTED, ids=[planted[0].__name__ for planted in PLANTED])
def test_a_planted_defect_is_found_and_named(driver, trial, said):
    faults = faults_of(driver)
    assert any(name.startswith(trial) and said in fault for name, fault in faults), faults


def test_a_device_without_a_bus_has_no_cable_to_unplug():
    assert "reports disconnection" not in [tried.name for tried in try_driver(NiDaq)]
    assert "reports disconnection" in [tried.name for tried in try_driver(Ads1115)]


class ReadsAFlag(Ads1115):
    """Measures whether the drive is on."""

    example: ClassVar = {"inputs": [{**Ads1115.example["inputs"][0], "quantity": "drive_enabled"}]}


def test_a_flag_that_is_only_read_while_it_switches_is_told(monkeypatch, tmp_path):
    whole = measuring_devices.take_samples

    def around_the_switch(stand, *arguments):
        samples, moments = whole(stand, *arguments)
        switch = stand.bench.rises_from + 0.5 * stand.bench.rises_for
        near = {name: (t > switch - 0.09) & (t < switch) for name, (t, _) in samples.items()}
        if stand.bench.rises_from:
            samples = {name: (t[near[name]], values[near[name]]) for name, (t, values) in samples.items()}
        return samples, moments

    monkeypatch.setattr(measuring_devices, "take_samples", around_the_switch)
    fault = run_in_this_process(measuring_devices.measures_true_values, ReadsAFlag, tmp_path)
    assert fault == "torque: all samples come less than 0.1 s before the flag switches"


def test_a_display_s_steps_are_allowed_for_and_readings_that_are_kept_are_not():
    true = BASES["torque"] * (1.0 + RISE * np.arange(100) / 100)
    measuring_devices.expect_true_values("torque", np.round(true, 1), true)
    with pytest.raises(Broken, match="torque reads"):
        measuring_devices.expect_true_values("torque", np.repeat(true[::20], 20), true)


class OffByOne(ElmoProbe):
    """Tells another node than answered."""

    def ask(self, port, addresses, taken):
        for seen in super().ask(port, addresses, taken):
            yield seen._replace(settings={"node": seen.address + 1})


class SeesGhosts(ElmoProbe):
    """Tells a device whatever is there."""

    def ask(self, port, addresses, taken):
        yield Sighting(1, Identity(), {"node": 1})


class Enables(ElmoProbe):
    """Makes the drive follow a current to see whether it is one."""

    def ask(self, port, addresses, taken):
        port.send(0x000, bytes((0x01, 0x00)))
        for write in ("2f6060000a000000", "2b40600006000000", "2b40600007000000", "2b4060000f000000"):
            port.send(0x601, bytes.fromhex(write))
        yield from super().ask(port, addresses, taken)


class Waits(ElmoProbe):
    """Waits for an answer for ever."""

    def ask(self, port, addresses, taken):
        while True:
            port.pump_until((False,), port.clock.now() + 1.0)
        yield ""


@pytest.mark.parametrize(
    ("probe", "trial", "said"),
    [
        (OffByOne, "its probe recognises its device", "gives it node 2; 1 was expected"),
        (SeesGhosts, "its probe ends on a silent wire", "saw a device"),
        (Enables, "its probe moves and energises nothing", "the machine follows ('current'"),
        (Waits, "its probe ends on a silent wire", "it takes more than 20 s"),
    ],
)
def test_a_defect_of_a_probe_is_found_and_named(probe, trial, said, tmp_path):
    driver = type("Probed", (ElmoCan,), {"probe": probe()})
    faults = {trial_name(each): run_in_this_process(each, driver, tmp_path) for each in probing.TRIALS}
    assert said in faults[trial], faults


@pytest.mark.parametrize("name", registry.names())
def test_every_shipped_driver_passes_every_trial(name):
    assert faults_of(registry.load(name)) == []


def test_a_driver_without_an_example_is_told_what_is_missing():
    class Bare(ElmoCan):
        example = {}

    with pytest.raises(InputError, match=r"its `example` is no settings of one: .*node.*Field required"):
        try_driver(Bare)


def test_whole_numbers_without_a_unit_and_any_order_of_methods_are_sound():
    class Settings(DriverSettings):
        averages: int = 4

    class Plain(Ads1115):
        """Has another first method."""

        def close(self): ...

        def safe_state(self, deadline_s: float) -> Confirmation:
            return Confirmation(True, "")

    Plain.Settings = Settings
    assert conformance.faults_of(Plain) == []


def test_a_driver_that_lacks_a_method_is_told_which():
    class Half(Driver):
        """A driver that cannot be made."""

        Settings, transport, summary = ElmoCan.Settings, "can", "half"

        def safe_state(self, deadline_s: float) -> Confirmation:
            return Confirmation(True, "")

    assert conformance.faults_of(Half) == ["does not implement __init__, close, open"]


def test_the_set_up_that_a_defect_is_planted_in_is_the_drives_own():
    assert "arm_dead_man" in vars(Commissioning)
