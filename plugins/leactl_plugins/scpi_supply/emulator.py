"""Emulator of an SCPI supply: commands of both families, an error queue, and a regulated output.

Spelt after the Keysight E3632A and E3633A/E3634A User's Guides and the Rigol DP800 Programming Guide; long and short
forms, optional nodes and letter case are taken as SCPI-1999 volume 1, section 6.2, has them.
"""

import math
import re
from collections import deque
from collections.abc import Callable

from leactl.driver.far_end import SupplyLoad
from leactl_plugins.scpi_supply.models import RANGES

REGULATE_S = 0.05  # the load's resistance changes within seconds
MOST_INPUT = 512
QUEUE = 20
OTHER_RATING = ((60.0, 60.0),)  # a DP800 as well, whose range is set at the instrument
OVER_RATING = 1.03  # what can still be programmed
OVER_PROTECTION = 1.1
NO_ERROR = (0, "No error")
UNDEFINED, OUT_OF_RANGE, OVERFLOW = (-113, "Undefined header"), (-222, "Data out of range"), (-350, "Queue overflow")
MAKERS = {"e36xx": "HEWLETT-PACKARD", "dp800": "RIGOL TECHNOLOGIES"}
REVISIONS = {"e36xx": "1.7-5.0-1.0", "dp800": "00.01.16"}


class _Level:
    """A protection: level, switch, whether it has tripped."""

    def __init__(self, level: float) -> None:
        self.level, self.armed, self.tripped = level, True, False


class ScpiSupplyEmulator:
    """One supply with one output that feeds a load."""

    def __init__(
        self, dialect: str, model: str, load: SupplyLoad, serial_number: str = "0", answer_s: float = 0.02
    ) -> None:
        self.dialect, self.model, self.serial_number = dialect, model, serial_number
        self._load, self._answer_s = load, answer_s
        self._ratings = RANGES.get(model, OTHER_RATING) if dialect == "e36xx" else OTHER_RATING
        self._range = 0
        volts, amperes = max(v for v, _ in self._ratings), max(a for _, a in self._ratings)
        self.set_volts, self.set_amperes = 0.0, self._rating[1]
        self.on = False
        self.volts = self.amperes = 0.0  # at the terminals
        self.over_voltage = _Level(OVER_PROTECTION * volts)
        self.over_current = _Level(OVER_PROTECTION * amperes)
        self._stuck = self._admits = False
        self._share = 1.0
        self._input = b""
        self._output: deque[tuple[float, bytes]] = deque()
        self._busy = 0.0
        self._errors: deque[tuple[int, str]] = deque()
        self._regulates = 0.0
        self._commands = self._tree()
        self._regulate()

    # -- what a bench may have go wrong ------------------------------------------------------------------------------

    def stuck_on(self, admits: bool = True) -> None:
        """Make the output stay on, as with a welded relay; `admits` says whether `OUTP?` still answers 1."""
        self._stuck, self._admits = True, admits

    def lose_regulation(self, share: float) -> None:
        """Put out only this share of the set voltage and current, and report that it does not regulate."""
        self._share = share
        self._regulate()

    def mend(self) -> None:
        """Return to normal operation."""
        self._stuck, self._share = False, 1.0
        self._regulate()

    # -- the wire ----------------------------------------------------------------------------------------------------

    @property
    def due(self) -> float:
        """Time of the next answer or the next regulation [s]."""
        return min(self._output[0][0] if self._output else math.inf, self._regulates)

    def receive(self, data: bytes, now: float) -> None:
        """Receive bytes; a line feed ends a message, and semicolons separate its commands."""
        for byte in data:
            if byte == 0x03 and self.dialect == "e36xx":  # device clear
                self._input = b""
                self._output.clear()
            elif byte == 0x0A:
                message, self._input = self._input.rstrip(b"\r"), b""
                for command in message.decode("ascii", "replace").split(";"):
                    if command.strip():
                        self._obey(command.strip(), now)
            else:
                self._input = (self._input + bytes([byte]))[-MOST_INPUT:]

    def tick(self, now: float) -> bytes:
        """Regulate the output if that is due; returns an answer that is ready."""
        if now >= self._regulates:
            self._regulates = now + REGULATE_S
            self._regulate()
        if self._output and now >= self._output[0][0]:
            return self._output.popleft()[1]
        return b""

    def _obey(self, command: str, now: float) -> None:
        header, _, argument = command.partition(" ")
        for pattern, act in self._commands:
            if pattern.fullmatch(header):
                answer = act(argument.strip())
                break
        else:
            self._fail(UNDEFINED)
            return
        self._regulate()
        if answer is not None:
            self._busy = max(self._busy, now) + self._answer_s
            self._output.append((self._busy, answer.encode("ascii") + (b"\r\n" if self.dialect == "e36xx" else b"\n")))

    def _fail(self, error: tuple[int, str]) -> None:
        if len(self._errors) == QUEUE:
            self._errors[-1] = OVERFLOW
        else:
            self._errors.append(error)

    # -- the output --------------------------------------------------------------------------------------------------

    @property
    def _rating(self) -> tuple[float, float]:
        return self._ratings[self._range]

    def _regulate(self) -> None:
        tripped = self.over_voltage.tripped or self.over_current.tripped
        live = self._stuck or (self.on and not tripped)
        asked = (self.set_volts * self._share, self.set_amperes * self._share) if live else (0.0, 0.0)
        self.volts, self.amperes = self._load.feed(*asked)
        for protection, value in ((self.over_voltage, self.volts), (self.over_current, self.amperes)):
            if protection.armed and value > protection.level and not protection.tripped:
                protection.tripped = True
                self._regulate()

    def _condition(self) -> int:
        if not self.on or self._share != 1.0 or self.over_voltage.tripped or self.over_current.tripped:
            return 0
        return 1 if self.volts < self.set_volts - 1e-6 else 2

    # -- the commands ------------------------------------------------------------------------------------------------

    def _tree(self) -> list[tuple[re.Pattern[str], Callable[[str], str | None]]]:
        common: dict[str, Callable[[str], str | None]] = {
            "*IDN?": lambda _: ",".join(
                (MAKERS[self.dialect], self.model, self.serial_number, REVISIONS[self.dialect])
            ),
            "*CLS": lambda _: self._errors.clear(),
            "SYSTem:ERRor?": lambda _: self._next_error(),
            "SYSTem:REMote": lambda _: None,
            "OUTPut[:STATe]": self._switch,
            "OUTPut[:STATe]?": lambda _: self._truth(self.on),
            "[SOURce:]VOLTage": self._set_volts,
            "[SOURce:]VOLTage?": lambda _: self._number(self.set_volts),
            "[SOURce:]CURRent": self._set_amperes,
            "[SOURce:]CURRent?": lambda _: self._number(self.set_amperes),
            "MEASure[:VOLTage][:DC]?": lambda _: self._number(self.volts),
            "MEASure:CURRent[:DC]?": lambda _: self._number(self.amperes),
            "STATus:QUEStionable:CONDition?": lambda _: self._register(self._condition()),
        }
        if self.dialect == "e36xx":
            subtree = self._protection("[SOURce:]VOLTage:PROTection", "[:LEVel]", ":TRIPped?", self.over_voltage)
            subtree |= self._protection("[SOURce:]CURRent:PROTection", "[:LEVel]", ":TRIPped?", self.over_current)
            subtree |= {"[SOURce:]VOLTage:RANGe": self._set_range}
        else:
            subtree = self._protection("OUTPut:OVP", ":VALue", ":QUES?", self.over_voltage)
            subtree |= self._protection("OUTPut:OCP", ":VALue", ":QUES?", self.over_current)
        return [(_pattern(name), act) for name, act in (common | subtree).items()]

    def _protection(self, head: str, level: str, tripped: str, held: _Level) -> dict[str, Callable[[str], str | None]]:
        def set_level(text: str) -> None:
            value = _amount(text)
            if value is None or value < 0.0:
                return self._fail(OUT_OF_RANGE)
            held.level = value
            return None

        def arm(text: str) -> None:
            held.armed = text.upper() in ("1", "ON")

        state = ":STATe" if self.dialect == "e36xx" else "[:STATe]"
        return {
            head + level: set_level,
            f"{head}{level}?": lambda _: self._number(held.level),
            head + state: arm,
            f"{head}{state}?": lambda _: self._truth(held.armed),
            head + tripped: lambda _: self._truth(held.tripped, "YES", "NO"),
        }

    def _switch(self, text: str) -> None:
        if text.upper() not in ("0", "1", "ON", "OFF"):
            return self._fail(OUT_OF_RANGE)
        on = text.upper() in ("1", "ON")
        self.on = on or (self._stuck and self._admits and self.on)
        return None

    def _set_volts(self, text: str) -> None:
        self.set_volts = self._programmed(text, self._rating[0], self.set_volts)

    def _set_amperes(self, text: str) -> None:
        self.set_amperes = self._programmed(text, self._rating[1], self.set_amperes)

    def _programmed(self, text: str, rating: float, before: float) -> float:
        value = _amount(text)
        if value is None or not 0.0 <= value <= OVER_RATING * rating:
            self._fail(OUT_OF_RANGE)
            return before
        return value

    def _set_range(self, text: str) -> None:
        self._range = 0 if text.upper() == "LOW" else len(self._ratings) - 1

    def _next_error(self) -> str:
        number, text = self._errors.popleft() if self._errors else NO_ERROR
        return f'{number:+d},"{text}"' if self.dialect == "e36xx" else f'{number},"{text}"'

    def _number(self, value: float) -> str:
        return f"{round(value, 8):+.8E}" if self.dialect == "e36xx" else f"{value:.4f}"

    def _register(self, value: int) -> str:
        return f"{value:+d}" if self.dialect == "e36xx" else f"{value}"

    def _truth(self, value: bool, yes: str = "ON", no: str = "OFF") -> str:
        if self.dialect == "e36xx":
            return "1" if value else "0"
        return yes if value else no


def _pattern(name: str) -> re.Pattern[str]:
    """Pattern of a header in the notation of the manuals: capitals for the short form, brackets for optional parts."""
    spelt = re.sub(r"[A-Z]+[a-z]*", lambda word: _either(word[0]), name.replace("*", r"\*").replace("?", r"\?"))
    return re.compile(":?" + spelt.replace("[", "(?:").replace("]", ")?"), re.IGNORECASE)


def _either(word: str) -> str:
    short = "".join(letter for letter in word if letter.isupper())
    return word if short == word else f"(?:{word}|{short})"


def _amount(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
