"""Every driver, found by its entry point, goes on, says or ends under damaged traffic, and leaves no output on.

LEACTL_MUTATIONS=1000000 pytest -s -m long tests/driver/test_mutated_traffic.py
"""

import os
import random
import signal
import struct
from collections import Counter

import pytest

from leactl.driver import registry
from leactl.driver.contract import SAFE_STATE_S, Confirmation, MotionDevice, PowerSupply, Row
from leactl.emulation.trial import drives, supplies
from leactl.emulation.trial.known_bench import LOAD_OHM
from leactl.emulation.trial.measuring_devices import MACHINE_QUANTITIES, RECORDED_S
from leactl.emulation.trial.stand import ANSWER_S, PERIOD_S, Stand
from leactl.errors import DeviceError, InputError

from .export_mutations import BYTE_MUTATIONS, KINDS, TEXT_MUTATIONS
from .traffic_mutations import BETWEEN, BYTES, WHOLE, Damage, damaged

DRIVERS = {name: registry.load(name) for name in registry.names()}
ON_WIRES = [name for name, driver in DRIVERS.items() if driver.transport in BETWEEN]
OF_FILES = [name for name, driver in DRIVERS.items() if hasattr(driver, "read_files")]
FEW, FEW_FILES = 1500, 40  # mutations of each driver in an ordinary run
MANY = int(os.environ.get("LEACTL_MUTATIONS", "1000000"))
MANY_FILES = MANY // 200
SESSION_S, CHANGE_S, POLL_S = 3.0, 0.2, 0.01
OPENED_S = 30.0  # in which a driver has opened its device or said that it cannot
AGE_S = 2.0  # of a reading at most: how fresh one is, `leactl driver check` tries
NOTED_S = 1.1  # within which a driver says what it noticed; most say one line a second
HANGS_S = 120  # by the wall clock, of a session that takes milliseconds
MOST_ATTEMPTS = 3  # at what was told; then the wire is whole again


class Session:
    """One device that is opened, used and made safe while its traffic is damaged."""

    def __init__(self, driver, kinds, seed, folder):
        self.damage = Damage(kinds, f"{driver.__name__} {kinds[0]} {seed}")
        self.stand = Stand(damaged(driver, self.damage), folder)
        self.judged = kinds is WHOLE
        self._true: list[tuple[float, dict[str, float]]] = []
        self._wrong: list[tuple[float, str]] = []
        self._noted: list[float] = []

    def run(self):
        """Go through it; gives what is wrong, in a line each."""
        stand, rng = self.stand, self.damage.rng
        began_damaged = rng.random() < 0.3
        try:
            self.damage.on = began_damaged
            began = stand.clock.now()
            try:
                self._begin()
            finally:
                if stand.clock.now() - began > OPENED_S:
                    raise AssertionError(f"took {stand.clock.now() - began:.1f} s to open")
            self.damage.on = True
            self._go_on()
        # told, a limit that was misread among it; `Broken` where damage kept it from operation
        except (DeviceError, InputError, drives.Broken):
            self._noted.append(stand.clock.now())
            if not began_damaged and not self.damage.on:
                raise
        self._end()
        return self._unnoted()

    def _begin(self):
        driver = self.stand.driver
        if isinstance(driver, MotionDevice):
            drives.enter_operation(self.stand)
        elif isinstance(driver, PowerSupply):
            supplies.open_and_switch_on(self.stand)
        else:
            driver.open()
            self.stand.bench.rise(SESSION_S)

    def _go_on(self):
        stand, rng, driver = self.stand, self.damage.rng, self.stand.driver
        self._note_truth()
        end, change = stand.clock.now() + SESSION_S, -1.0
        while (now := stand.clock.now()) < end:
            if now >= change:
                change = now + CHANGE_S
                self._change(rng)
            self._note_truth()
            if isinstance(driver, MotionDevice):
                self._cycle(now)
            self._take()
            stand.clock.sleep_until(now + (PERIOD_S if isinstance(driver, MotionDevice) else POLL_S))

    def _change(self, rng):
        machine, driver = self.stand.machine, self.stand.driver
        machine.current, machine.velocity, machine.angle = rng.uniform(-4, 4), rng.uniform(-9, 9), rng.uniform(-3, 3)
        machine.bus_voltage, machine.voltage = rng.uniform(26, 30), rng.uniform(-4, 4)
        if isinstance(driver, PowerSupply):
            driver.supply(*rng.choice(((1.2, 3.0), (3.0, 2.0), (1.8, 3.0), (1.5, 1.5))))

    def _note_truth(self):
        stand, now = self.stand, self.stand.clock.now()
        machine, (volts, amperes) = stand.machine, stand.bench.load.fed
        true = {
            "q_axis_current": machine.read()[0],
            "velocity": machine.velocity,
            "angle": machine.angle,
            "bus_voltage": machine.bus_voltage,
            "q_axis_voltage": machine.voltage,
        }
        if isinstance(stand.driver, PowerSupply):
            true = {"line_voltage": volts, "line_current": amperes, "bus_voltage": volts, "bus_current": amperes}
        elif not isinstance(stand.driver, MotionDevice):
            channels = [channel for spec in stand.driver.streams for channel in spec.channels]
            true = {channel.quantity: stand.bench.true_value(channel.quantity, now) for channel in channels}
        self._true.append((now, true))

    def _cycle(self, now):
        stand = self.stand
        drive = stand.motion
        drive.begin_cycle()
        if stand.driver.synchronised:
            stand._port.sync()
        drive.end_cycle(now + ANSWER_S)
        if stand.clock.now() > now + ANSWER_S + 1e-3:
            raise AssertionError(f"end_cycle took {stand.clock.now() - now:.4f} s of {ANSWER_S:g}")
        for channel, value in zip(drive.loop_channels, drive.values, strict=True):
            self._judge(now, channel.quantity, value)
        drive.feed()
        if stand.clock.now() > now + ANSWER_S + 1e-3:
            raise AssertionError("feed waits")

    def _take(self):
        stand = self.stand
        now = stand.clock.now()
        for taken in stand.driver.take():
            for row in [taken] if isinstance(taken, Row) else taken.rows():
                if row.fault:
                    self._noted.append(now)
                spec = next(spec for spec in stand.driver.streams if spec.name == row.stream)
                for channel, value in zip(spec.channels, row.values, strict=True):
                    self._judge(now, channel.quantity, value)
        self._noted += [now] * bool(stand.driver.notices())
        if stand.clock.now() > now:
            raise AssertionError(f"take() or notices() waited for {stand.clock.now() - now:.4f} s")

    def _judge(self, now, quantity, value):
        """Whether a value was true within its age, or is missing."""
        if not self.judged or value != value:
            return
        recent = [true[quantity] for time, true in self._true if time >= now - AGE_S and quantity in true]
        if not recent:
            return
        low, high = min(recent), max(recent)
        slack = 0.02 * max(abs(low), abs(high)) + 0.06
        known = any(abs(value - true) <= slack for true in recent)
        if not known and not (isinstance(self.stand.driver, PowerSupply) and 0.0 <= value <= high + slack):
            self._wrong.append((now, f"{quantity} reads {value:.6g} at {now:.3f} s"))

    def _end(self):
        """It becomes safe, says so truly and never raises; over a whole wire it is off."""
        stand = self.stand
        for attempt in range(MOST_ATTEMPTS):
            self.damage.on = attempt < MOST_ATTEMPTS - 1
            began = stand.clock.now()
            confirmation = stand.driver.safe_state(SAFE_STATE_S)
            if (took := stand.clock.now() - began) > SAFE_STATE_S + 0.05:
                raise AssertionError(f"safe_state took {took:.3f} s")
            if confirmation.safe and (on := self._is_on()):
                raise AssertionError(f"safe_state is confirmed ({confirmation.detail}) while {on}")
        if not confirmation.safe:
            raise AssertionError(f"safe_state over a whole wire: {confirmation.detail}")
        stand.driver.close()

    def _is_on(self):
        mode, volts = self.stand.machine.following[0], self.stand.bench.load.fed[1] * LOAD_OHM
        return f"the machine follows {mode}" if mode != "off" else f"{volts:.3g} V are put out" if volts else ""

    def _unnoted(self):
        return [
            text for time, text in self._wrong if not any(time - NOTED_S <= at <= time + NOTED_S for at in self._noted)
        ]


def hung(_number, _frame):
    raise TimeoutError(f"a session takes more than {HANGS_S} s of the wall clock, in which the bench's clock waits")


@pytest.fixture(autouse=True)
def told_where_it_hangs():
    before = signal.signal(signal.SIGALRM, hung)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def faults_of(driver, count, folder):
    """What is wrong in sessions with so many mutations, the first ten, and how many there were of each kind."""
    counts, faults, seed = Counter(), [], 0
    while counts.total() < count and len(faults) < 10:
        for kinds in (WHOLE, BYTES):
            signal.alarm(HANGS_S)
            session = Session(driver, kinds, seed, folder)
            try:
                faults += [f"{kinds[0]} {seed}: {text}" for text in session.run()[:1]]
            except Exception as error:  # whatever breaks is a fault, with its seed
                faults.append(f"{kinds[0]} {seed}: {type(error).__name__}: {error}")
            counts += session.damage.counts
        seed += 1
    return faults[:10], counts | {"sessions": 2 * seed}


@pytest.mark.parametrize("name", ON_WIRES)
def test_damaged_traffic_breaks_stalls_and_leaves_on_nothing(name, tmp_path):
    faults, _counts = faults_of(DRIVERS[name], FEW, tmp_path)
    assert faults == []


class OffInWords(DRIVERS["scpi_supply"]):
    """Says that it is off."""

    def safe_state(self, deadline_s):
        return Confirmation(True, "off")


class ReadsAnyLength(DRIVERS["odrive_can"]):
    """Takes a frame of any length for an answer."""

    def _on_iq(self, data, timestamp):
        struct.unpack("<ff", data)
        super()._on_iq(data, timestamp)


class GuessesWhatIsMissing(DRIVERS["odrive_can"]):
    """Fills in what did not come, and says nothing of it."""

    def notices(self):
        return []

    def end_cycle(self, deadline):
        super().end_cycle(deadline)
        self.values = [12.5 if value != value else value for value in self.values]


class WaitsForAnAnswer(DRIVERS["odrive_can"]):
    """Asks for what did not come, and waits."""

    def end_cycle(self, deadline):
        super().end_cycle(deadline)
        if self.values[4] != self.values[4]:
            self._clock.sleep_until(self._clock.now() + 0.05)


@pytest.mark.parametrize(
    ("driver", "said"),
    [
        (OffInWords, "safe_state is confirmed (off) while 1"),
        (ReadsAnyLength, "error: unpack requires a buffer of 8 bytes"),
        (GuessesWhatIsMissing, "reads 12.5"),
        (WaitsForAnAnswer, "end_cycle took"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_driver_that_damage_breaks_is_found(driver, said, tmp_path):
    faults, _counts = faults_of(driver, FEW, tmp_path)
    assert any(said in fault for fault in faults), faults


def files_of(driver, folder):
    """A source of records, and the files that its far end has written while everything rose."""
    stand = Stand(driver, folder)
    stand.driver.open()
    stand.bench.rise(RECORDED_S)
    while (now := stand.clock.now()) < RECORDED_S:
        machine = stand.machine
        machine.current, machine.velocity, machine.angle = (
            float(stand.bench.true_value(quantity, now)) for quantity in MACHINE_QUANTITIES[:3]
        )
        stand.wait(0.05)
    return stand.driver, stand.driver.exports.fresh()


def outcomes_of_files(name, count, folder):
    """How many damaged files of a far end are refused and read; whatever else is raised is a fault.

    What is read of a camera's is judged in test_damaged_exports.py.
    """
    source, files = files_of(DRIVERS[name], folder)
    whole, counts, rng = [path.read_bytes() for path in files], Counter(), random.Random(name)
    for _number in range(count):
        at, kind = rng.randrange(len(files)), rng.choice(KINDS)
        content = whole[at]
        if kind in BYTE_MUTATIONS:
            content = BYTE_MUTATIONS[kind](rng, content, "utf-8")
        else:
            lines = content.decode().splitlines(keepends=True)
            content = "".join(TEXT_MUTATIONS[kind](rng, lines, True)).encode()
        files[at].write_bytes(content)
        signal.alarm(HANGS_S)
        try:
            source.read_files(files)
        except InputError:
            counts["refused"] += 1
        else:
            counts["read"] += 1
        files[at].write_bytes(whole[at])
    return counts


@pytest.mark.parametrize("name", OF_FILES)
def test_a_damaged_file_of_a_far_end_is_refused_or_read(name, tmp_path):
    assert outcomes_of_files(name, FEW_FILES, tmp_path).keys() == {"refused", "read"}


@pytest.mark.long
@pytest.mark.parametrize("name", OF_FILES)
def test_thousands_of_damaged_files_of_a_far_end_are_refused_or_read(name, tmp_path):
    counts = outcomes_of_files(name, MANY_FILES, tmp_path)
    print(f"\n{name}: {dict(counts)}")
    assert counts.keys() == {"refused", "read"}


@pytest.mark.long
@pytest.mark.parametrize("name", ON_WIRES)
def test_a_million_mutations_break_stall_and_leave_on_nothing(name, tmp_path):
    faults, counts = faults_of(DRIVERS[name], MANY, tmp_path)
    print(f"\n{name}: {dict(counts)}")
    assert faults == []
