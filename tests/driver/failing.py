"""Far ends that fail on request; arguments and answers are plain JSON values, so that a request may cross processes."""

import math
import random
import time

from leactl_plugins.ads1115.emulator import Ads1115Emulator
from leactl_plugins.bk1688b.emulator import Bk1688bEmulator
from leactl_plugins.elmo_can.dictionary import ABORT_RANGE, Abort, ObjectEntry
from leactl_plugins.elmo_can.emulator import PRE_OPERATIONAL, STOPPED, ElmoEmulator
from leactl_plugins.elmo_serial.emulator import ElmoSerialEmulator, InterpreterError
from leactl_plugins.korad_ka.emulator import KoradEmulator
from leactl_plugins.scpi_supply.emulator import ScpiSupplyEmulator

from leactl.driver.far_end import Frame
from leactl.emulation.wires.buses import CanWire

RATED_MA = 11186
COUNTS = 40000


class Shaft:
    """A machine that reports what it was told last, exactly."""

    voltage = 3.25
    bus_voltage = 29.6

    def __init__(self) -> None:
        self.following = ("off", 0.0)
        self.velocity, self.angle = 0.0, 0.25

    def command(self, mode: str, value: float) -> None:
        self.following = (mode, value)

    def read(self) -> tuple[float, float, float]:
        mode, value = self.following
        return (value if mode == "current" else 0.0), self.velocity, self.angle


class FailingDrive(ElmoEmulator):
    """A drive alone on its wire, on a shaft; `fault` is its own already."""

    def __init__(self, wire: CanWire, node: int = 1, voltage: tuple[int, int, str, float] | None = None) -> None:
        self.shaft = Shaft()
        super().__init__(node, self.shaft, rated_current_ma=RATED_MA, counts_per_turn=COUNTS, voltage_object=voltage)
        self._wire = wire
        self._deaf: set[int] = set()
        self._mute: set[int] = set()
        self._refused: dict[int, int] = {}
        self._held_mode: int | None = None
        self._torque_off = self._sizeless = self._doubled = False
        self._resets_in: float | None = None
        self._reset_begun = math.nan
        wire.devices.clear()
        wire.cut = False
        wire.attach(self)

    def freeze(self, frozen: bool = True) -> None:
        super().freeze(frozen)

    def leave_operation(self) -> None:
        """Fall back to switch-on disabled, as Gold drives do after a lapse of their bus."""
        self._go("disabled")

    def run_away(self) -> None:
        """Be in operation at 5 rad/s, as another program has left it."""
        self.state = "enabled"
        self._values[0x6060, 0], self._values[0x60FF, 0] = 9, round(5 * self._counts_per_rad)
        self._follow()

    def reboot(self) -> None:
        """Lose the supply for a moment: boot-up, pre-operational, heartbeats as before."""
        self._go("disabled")
        self.nmt, self._booted = PRE_OPERATIONAL, False

    def stop_node(self) -> None:
        """Be stopped by somebody else's NMT command; heartbeats go on."""
        self.nmt = STOPPED

    def allow(self, most_torque: int, most_current: int) -> None:
        """Let no more flow than these per mille of the rated ones."""
        self._values[0x6072, 0], self._values[0x6073, 0] = most_torque, most_current
        self._follow()

    def turn(self, angle: float) -> None:
        """Stand at this angle."""
        self.shaft.angle = angle

    def lack(self, index: int, sub: int) -> None:
        """Be a firmware without this object."""
        del self._entries[index, sub]
        del self._values[index, sub]

    def hold(self, index: int, sub: int, value: int) -> None:
        """Hold this value, as another master or the maker's program has left it."""
        self._values[index, sub] = value

    def have(self, kind: str, index: int, sub: int, value: int) -> None:
        """Be a firmware with an object that the emulator lacks."""
        self._entries[index, sub] = ObjectEntry(kind)
        self._values[index, sub] = value

    def holds(self, index: int, sub: int) -> int:
        """Value of an object."""
        return self._values[index, sub]

    def stay_in_mode(self, mode: int | None) -> None:
        """Show and follow this mode whatever is asked for; None lets it go again."""
        self._held_mode = mode

    def drop_out(self) -> None:
        """Leave operation for "switched on" by itself, as Golds have been seen to do between two SYNCs."""
        self._go("on")

    def reset_slowly(self, seconds: float) -> None:
        """Need so long to leave the fault state once told to."""
        self._resets_in = seconds

    @property
    def _shown_mode(self) -> int:
        return super()._shown_mode if self._held_mode is None else self._held_mode

    def _control(self, previous: int, word: int) -> None:
        if self._resets_in is not None and self.state == "fault" and word & 0x80 and not previous & 0x80:
            self._reset_begun = self._wire.clock.now()
            return
        super()._control(previous, 0 if self._torque_off else word)

    def _upload(self, index: int, sub: int) -> bytes:
        if self._resets_in is not None and self._wire.clock.now() - self._reset_begun >= self._resets_in:
            self._resets_in = None
            super()._control(0, 0x80)
        answer = super()._upload(index, sub)
        return bytes([0x42]) + answer[1:] if self._sizeless else answer

    def ignore_writes(self, index: int) -> None:
        """Confirm writes to this object and forget them."""
        self._deaf.add(index)

    def say_nothing_of(self, index: int) -> None:
        """Leave what is asked of this object unanswered, as a lost frame does."""
        self._mute.add(index)

    def refuse(self, index: int, code: int) -> None:
        """Abort every transfer of this object with a code."""
        self._refused[index] = code

    def tell_no_sizes(self) -> None:
        """Answer without saying how many of the four bytes count, as CiA 301 lets a server do."""
        self._sizeless = True

    def have_a_twin(self) -> None:
        """Share the bus with a drive of the same node, which answers the same."""
        self._doubled = True

    def switch_torque_off(self, status: int) -> None:
        """Be held out of operation by the safe torque off, whose object 0x2086 shows this."""
        self._torque_off = True
        self._values[0x2086, 0] = status

    def have_no_remote_frames(self) -> None:
        """Hold and insist on bit 30 in every COB-ID of a TPDO, as a drive that answers no remote frame may."""
        for number in range(4):
            self._values[0x1800 + number, 1] |= 1 << 30

    def _check_special(self, index: int, sub: int, value: int) -> None:
        if 0x1800 <= index <= 0x1803 and sub == 1 and (self._values[index, 1] & ~value) >> 30 & 1:
            raise Abort(ABORT_RANGE)
        super()._check_special(index, sub, value)

    def _answer(self, frame: Frame, now: float) -> list[Frame]:
        if frame.identifier != 0x600 + self.node:
            return super()._answer(frame, now)
        asked = int.from_bytes(frame.data[1:3], "little")
        if asked in self._mute:
            return []
        if asked in self._refused:
            refusal = b"\x80" + frame.data[1:4] + self._refused[asked].to_bytes(4, "little")
            return [Frame(0x580 + self.node, refusal)]
        answers = super()._answer(frame, now)
        return answers * 2 if self._doubled else answers

    def cut_cable(self) -> None:
        """Let nothing through, either way."""
        self._wire.cut = True

    def say(self, identifier: int, data: str) -> None:
        """Send a frame that nobody asked for behind the next answer; its data in hex."""
        self._emergencies.append(Frame(identifier, bytes.fromhex(data)))

    def follows(self) -> list:
        """Mode and setpoint that the shaft was told last."""
        return list(self.shaft.following)

    def _download(self, index: int, sub: int, raw: bytes, now: float) -> None:
        if index not in self._deaf:
            super()._download(index, sub, raw, now)


PER_MILLE_A = RATED_MA * 1e-6 * math.sqrt(1.5)
STALL_EVERY, STALLS_S = 12, (0.0005, 0.05)  # SYNCs on average, and how long


class CountingDrive(FailingDrive):
    """A drive whose readings are the number of the SYNC at which it sampled them."""

    def __init__(self, wire: CanWire, node: int = 1) -> None:
        self.number = -1
        self.last_answers: list[Frame] = []
        self._draw: random.Random | None = None
        self._stalls: list[tuple[int, float]] = []
        super().__init__(wire, node)
        self.shaft.read = lambda: (
            self.number % 1000 * PER_MILLE_A,
            self.number * 2 * math.pi / COUNTS,
            self.number * 2 * math.pi / COUNTS,
        )

    def counted(self) -> int:
        """Number of the last SYNC."""
        return self.number

    def stall_at_random(self, seed: int) -> None:
        """Stand still from time to time, with the whole process, before a SYNC is answered."""
        self._draw = random.Random(seed)

    def stalls(self) -> list[tuple[int, float]]:
        """Number of the SYNC and length [s] of each stall."""
        return self._stalls

    def _sync(self, now: float) -> list[Frame]:
        self.number += 1
        self.last_answers = super()._sync(now)
        if self._draw is not None and self._draw.random() < 1 / STALL_EVERY:
            self._stalls.append((self.number, self._draw.uniform(*STALLS_S)))
            time.sleep(self._stalls[-1][1])
        return self.last_answers


DRIVES = {"failing": FailingDrive, "counting": CountingDrive}


class FailingConverter(Ads1115Emulator):
    """A converter whose pins are at chosen voltages."""

    def __init__(self, clock_error: float = 0.0) -> None:
        self._volts = [0.0, 0.0, 0.0, 0.0]
        self._step = 0.0
        super().__init__(self._pin, clock_error=clock_error)
        self._stalled = False

    def _pin(self, number: int) -> float:
        if number == 0:
            self._volts[0] += self._step
        return self._volts[number]

    def climb(self, volts: float) -> None:
        """Have A0 go up by so much with every conversion."""
        self._step = volts

    def apply(self, *volts: float) -> None:
        """Put these voltages at the pins from A0 on."""
        self._volts[: len(volts)] = volts

    def stall(self) -> None:
        """Never end another conversion."""
        self._stalled = True

    def reset(self) -> None:
        """Lose the supply for a moment: nothing under way, and registers as after power-up."""
        super().__init__(self._pin)

    def _finish(self, now: float) -> None:
        super()._finish(-math.inf if self._stalled else now)


class Resistor:
    """A load of 0.6 ohm."""

    def feed(self, voltage: float, current: float) -> tuple[float, float]:
        flowing = min(current, voltage / 0.6)
        return 0.6 * flowing, flowing


class FailingLine:
    """What may go wrong between a host and any supply's far end."""

    def __init__(self, *arguments) -> None:
        super().__init__(*arguments)
        self._spoilt: list[bytes | None] = []
        self._deaf: list[str] = []
        self._frozen = False
        self._unheard = 0

    def leave_on(self, volts: float, amperes: float) -> None:
        """Be switched on, as another program or a person at the front panel has left it."""
        self.set_volts, self.set_amperes, self.on = volts, amperes, True
        self._regulate()

    def go_off(self) -> None:
        """Be switched off at the front panel."""
        self.on = False
        self._regulate()

    def ignore(self, header: str) -> None:
        """Do nothing about commands that begin so."""
        self._deaf.append(header)

    def spoil(self, *answers: str | None) -> None:
        """Send these bytes, in hex, in place of the next answers; None loses one."""
        self._spoilt += [None if answer is None else bytes.fromhex(answer) for answer in answers]

    def slow_down(self, seconds: float) -> None:
        """Take this long for every answer."""
        self._answer_s = seconds

    def freeze(self) -> None:
        """Neither obey nor answer."""
        self._frozen = True

    def miss(self, count: int) -> None:
        """Lose the next bytes that come."""
        self._unheard = count

    def output(self) -> list:
        """Whether it is on, and what is at the terminals."""
        return [self.on, self.volts, self.amperes]

    def receive(self, data: bytes, now: float) -> None:
        lost = min(self._unheard, len(data))
        self._unheard -= lost
        if not self._frozen:
            super().receive(data[lost:], now)

    def tick(self, now: float) -> bytes:
        answer = super().tick(now)
        if answer and self._spoilt:
            return self._spoilt.pop(0) or b""
        return answer

    def _obey(self, command: str, *now: float):
        if any(command.startswith(header) for header in self._deaf):
            return None
        return super()._obey(command, *now)


class FailingSupplyEnd(FailingLine, ScpiSupplyEmulator):
    """A supply that speaks SCPI, whose fed output is at a resistor."""

    def __init__(
        self, dialect: str = "e36xx", model: str = "E3633A", serial_number: str = "0", output: int | None = None
    ) -> None:
        super().__init__(dialect, model, Resistor(), serial_number, output)

    def leave_on(self, volts: float, amperes: float) -> None:
        """Be switched on, as another program or a person at the front panel has left it."""
        self.fed.set_volts, self.fed.set_amperes, self.fed.on = volts, amperes, True
        self.fed.regulate()

    def go_off(self) -> None:
        """Be switched off at the front panel."""
        self.fed.on = False
        self.fed.regulate()

    def output(self) -> list:
        """Whether it is on, and what is at the terminals."""
        return [self.fed.on, self.fed.volts, self.fed.amperes]

    def trip(self) -> None:
        """Have the over-voltage protection trip."""
        self.fed.over_voltage.tripped = True
        self.fed.regulate()

    def note_error(self, number: int, text: str) -> None:
        """Have an entry in the error queue."""
        self._queue_error((number, text))

    def protect_itself(self, volts: float, over_voltage: bool, amperes: float, over_current: bool) -> None:
        """Have protections at these levels, each armed or not, as somebody has left them."""
        self.fed.over_voltage.level, self.fed.over_voltage.armed = volts, over_voltage
        self.fed.over_current.level, self.fed.over_current.armed = amperes, over_current

    def armed(self) -> list:
        """Whether either protection is armed."""
        return [self.fed.over_voltage.armed, self.fed.over_current.armed]

    def levels(self) -> list:
        """Both settings and both protections' levels."""
        fed = self.fed
        return [fed.set_volts, fed.set_amperes, fed.over_voltage.level, fed.over_current.level]

    def in_remote_control(self) -> bool:
        """Whether the front panel is locked."""
        return self.remote

    def select(self, number: int) -> None:
        """Have this output selected, on which a command acts that names none."""
        self.selected = self.outputs[number - 1]

    def use_others(self) -> None:
        """Have somebody else's loads at the other outputs: on, at levels and protections of their own."""
        for output in self._others():
            output.set_volts, output.set_amperes, output.on = 1.0 + output.number / 8, 0.25, True
            output.over_voltage.level = 2.5 + output.number / 8
            output.regulate()

    def others(self) -> list:
        """Everything that can be set at the other outputs, and what is at their terminals."""
        return [
            [
                *(output.number, output.on, output.volts, output.set_volts, output.set_amperes),
                *(output.over_voltage.level, output.over_voltage.armed, output.over_voltage.tripped),
                *(output.over_current.level, output.over_current.armed, output.over_current.tripped),
            ]
            for output in self._others()
        ]

    def _others(self) -> list:
        return [output for output in self.outputs if output is not self.fed]


class FailingBk1688bEnd(FailingLine, Bk1688bEmulator):
    """A supply of the 168xB family, into a resistor."""

    def __init__(self, model: str = "1688B") -> None:
        super().__init__(model, Resistor())

    def levels(self) -> list:
        """Both settings."""
        return [self.set_volts, self.set_amperes]


class FailingKoradEnd(FailingLine, KoradEmulator):
    """A Korad supply, into a resistor; identity and stray byte in hex."""

    def __init__(self, model: str = "KA3010P", identity: str = "", stray: str = "", rest_s: float = 0.04) -> None:
        super().__init__(model, Resistor(), bytes.fromhex(identity), bytes.fromhex(stray), rest_s)

    def levels(self) -> list:
        """Both settings."""
        return [self.set_volts, self.set_amperes]

    def busy_until(self, moment: float) -> None:
        """Lose what comes before this moment."""
        self._ready_at = moment


class FailingElmoEnd(ElmoSerialEmulator):
    """A drive at the end of a serial line, on a shaft."""

    def __init__(self) -> None:
        self.shaft = Shaft()
        super().__init__(self.shaft, counts_per_turn=COUNTS)
        self._deaf: set[str] = set()
        self._refused: dict[str, int] = {}
        self._silent_after, self._answers_left = "", math.inf

    def follows(self) -> list:
        """Mode and setpoint that the shaft was told last."""
        return list(self.shaft.following)

    def fall_silent(self, command: str, count: int) -> None:
        """Answer nothing any more once so many commands that begin with this were answered, and the query after."""
        self._silent_after, self._answers_left = command, count

    def _obey(self, command: str, now: float) -> bytes:
        if self._answers_left < 0:
            return b""
        self._answers_left -= not self._answers_left or command.startswith(self._silent_after)
        return super()._obey(command, now)

    def hold(self, name: str, value: float) -> None:
        """Hold this value, as somebody has left it."""
        self.values[name] = value

    def lack(self, name: str) -> None:
        """Be a firmware without this command."""
        del self.values[name]

    def ignore(self, name: str) -> None:
        """Confirm that this is set, and forget it."""
        self._deaf.add(name)

    def run_away(self) -> None:
        """Be on at 5 rad/s, as another program has left it, its echo on and half a command in its buffer."""
        self.values.update({"UM": 2, "JV": round(5 * COUNTS / (2 * math.pi)), "EO": 1})
        self._input = b"J"
        self._switch(True)
        self.values["JV"] = round(5 * COUNTS / (2 * math.pi))
        self._execute("BG")
        self.program_running = False

    def reboot(self) -> None:
        """Lose the supply for a moment."""
        self._switch(False)
        self.values["EO"] = 1

    def refuse(self, name: str, number: int) -> None:
        """Answer whatever sets this by an error."""
        self._refused[name] = number

    def _set(self, name: str, value: float, now: float) -> None:
        if name in self._refused and value:
            raise InterpreterError(self._refused[name])
        if name not in self._deaf:
            super()._set(name, value, now)


SERIAL_ENDS = {
    "scpi_supply": FailingSupplyEnd,
    "bk1688b": FailingBk1688bEnd,
    "korad_ka": FailingKoradEnd,
    "elmo_serial": FailingElmoEnd,
}
