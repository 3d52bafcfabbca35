"""Emulator of an SCPI supply: commands of four families, an error queue, and one regulated output or several.

Its commands follow the Keysight E3632A and E3633A/E3634A User's Guides, the Rigol DP800 Programming Guide, and for the
Siglent SPD3303X and the Keysight E36300 public drivers that quote their guides. Long and short forms, optional nodes
and letter case follow SCPI-1999 volume 1, section 6.2. A command that names no output acts on the selected output.
"""

import math
import re
from collections import deque
from collections.abc import Callable, Sequence

from leactl.driver.far_end import SupplyLoad
from leactl_plugins.scpi_supply.emulated_output import EmulatedOutput, NothingConnected, ProtectionState
from leactl_plugins.scpi_supply.models import OUTPUTS, RANGES, TRACKING

REGULATE_S = 0.05  # time between two regulations; the load's resistance changes within seconds
MOST_INPUT_BYTES = 512  # of an unfinished message, of which only the last are kept
MOST_ERROR_ENTRIES = 20  # that the error queue holds
UNLISTED_RATING = ((60.0, 60.0),)  # V and A; also of a DP800 with one output, whose range is set at the instrument
UNSERVED_RATING = (25.0, 1.0)  # V and A, of an output that the driver does not serve
HIGHEST_LEVEL_OVER_RATING = 1.03  # highest level that can be set, over the rating
LOWEST_CURRENT = {"e36300": 0.001}  # A, that can be set, by dialect; 0 for the other dialects
ON = ("1", "ON")
BOOLEANS = (*ON, "0", "OFF")
NO_ERROR = (0, "No error")
UNDEFINED_HEADER, MISSING_PARAMETER = (-113, "Undefined header"), (-109, "Missing parameter")
OUT_OF_RANGE, QUEUE_OVERFLOW = (-222, "Data out of range"), (-350, "Queue overflow")
IDENTITIES = {  # maker, and what follows the serial number
    "e36xx": ("HEWLETT-PACKARD", "1.7-5.0-1.0"),
    "e36300": ("Keysight Technologies", "2.1.0-1.0.4-1.12"),
    "dp800": ("RIGOL TECHNOLOGIES", "00.01.16"),
    "spd3303": ("Siglent Technologies", "1.01.01.02.07R2,V3.0"),
}
KEYSIGHT = ("e36xx", "e36300")
CHANNEL_LIST = re.compile(r"(?:(.*),)?\s*\(@([\d, ]+)\)")  # behind the value
CHANNEL = re.compile(r"CH(\d)\s*(?:,\s*(.*))?", re.IGNORECASE)  # in front of the value

OutputAction = Callable[[EmulatedOutput, str], str | None]


class ScpiSupplyEmulator:
    """One supply; its output of this number, or its only one, feeds a load, and nothing is connected to the others."""

    def __init__(
        self,
        dialect: str,
        model: str,
        load: SupplyLoad,
        serial_number: str = "0",
        output: int | None = None,
        answer_s: float = 0.02,
    ) -> None:
        self.dialect, self.model, self.serial_number = dialect, model, serial_number
        self._answer_s = answer_s
        fed_number = output or 1
        self.outputs = [
            EmulatedOutput(number, ratings, load if number == fed_number else NothingConnected())
            for number, ratings in enumerate(self._ratings(), start=1)
        ]
        self.fed = self.outputs[fed_number - 1]
        self.selected = self.outputs[0]
        self.coupled = self.tracking = False
        self.remote = False
        if dialect == "e36300":
            for emulated_output in self.outputs:
                emulated_output.trips_in_regulation, emulated_output.over_current.armed = True, False
        elif dialect == "spd3303":
            for emulated_output in self.outputs:
                emulated_output.over_voltage.armed = emulated_output.over_current.armed = False
        self._admits = False
        self._input = b""
        self._output: deque[tuple[float, bytes]] = deque()
        self._busy = 0.0
        self._errors: deque[tuple[int, str]] = deque()
        self._regulates = 0.0
        self._commands = self._command_table()

    def _ratings(self) -> Sequence[tuple[tuple[float, float], ...]]:
        """Return the ratings [V, A] of all ranges, by output."""
        if self.model in OUTPUTS:
            ratings_by_output = OUTPUTS[self.model]
            count = 2 if self.model.startswith("DP82") else 3
            return [(ratings_by_output.get(number, UNSERVED_RATING),) for number in range(1, count + 1)]
        return [RANGES.get(self.model, UNLISTED_RATING) if self.dialect == "e36xx" else UNLISTED_RATING]

    # -- faults that a bench may inject ------------------------------------------------------------------------------

    def stuck_on(self, admits: bool = True) -> None:
        """Make the fed output stay on, as with a welded relay; `admits`: whether it still reports to be on."""
        self.fed.stuck, self._admits = True, admits

    def lose_regulation(self, share: float) -> None:
        """Put out only this share of the set voltage and current, and report that it does not regulate."""
        self.fed.share = share
        self.fed.regulate()

    def mend(self) -> None:
        """Return to normal operation."""
        self.fed.stuck, self.fed.share = False, 1.0
        self.fed.regulate()

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
                self._input = (self._input + bytes([byte]))[-MOST_INPUT_BYTES:]

    def tick(self, now: float) -> bytes:
        """Regulate the outputs if that is due; return an answer that is ready."""
        if now >= self._regulates:
            self._regulates = now + REGULATE_S
            self._regulate()
        if self._output and now >= self._output[0][0]:
            return self._output.popleft()[1]
        return b""

    def _obey(self, command: str, now: float) -> None:
        """Carry out one command and send its answer, if it has one."""
        header, _, argument = command.partition(" ")
        for pattern, act in self._commands:
            if match := pattern.fullmatch(header):
                header_number = match[1] if pattern.groups else None
                answers = self._act(act, header_number, argument.strip())
                break
        else:
            self._queue_error(UNDEFINED_HEADER)
            return
        self._regulate()
        if answers:
            self._busy = max(self._busy, now) + self._answer_s
            text = ",".join(answers) + ("\r\n" if self.dialect == "e36xx" else "\n")
            self._output.append((self._busy, text.encode("ascii")))

    def _act(self, act: OutputAction, header_number: str | None, argument: str) -> list[str]:
        """Act on the outputs named in the header or argument, or on the selected one; return their answers."""
        numbers, value = ([int(header_number)] if header_number else []), argument
        if self.dialect == "e36300" and (match := CHANNEL_LIST.fullmatch(argument)):
            numbers, value = [int(number) for number in match[2].split(",")], match[1] or ""
        elif self.dialect in ("dp800", "spd3303") and (match := CHANNEL.fullmatch(argument)):
            numbers, value = [int(match[1])], match[2] or ""
        if any(not 1 <= number <= len(self.outputs) for number in numbers):
            self._queue_error(OUT_OF_RANGE)
            return []
        named_outputs = [self.outputs[number - 1] for number in numbers] or [self.selected]
        return [answer for output in named_outputs if (answer := act(output, value.strip())) is not None]

    def _queue_error(self, error: tuple[int, str]) -> None:
        """Append number and text of an error to the error queue."""
        if len(self._errors) == MOST_ERROR_ENTRIES:
            self._errors[-1] = QUEUE_OVERFLOW
        else:
            self._errors.append(error)

    def _regulate(self) -> None:
        for output in self.outputs:
            output.regulate()

    # -- the commands ------------------------------------------------------------------------------------------------

    def _command_table(self) -> list[tuple[re.Pattern[str], OutputAction]]:
        """Return the patterns of all headers that the dialect knows, with their actions."""
        source = {"dp800": "[SOURce<n>:]", "spd3303": "[CH<n>:]"}.get(self.dialect, "[SOURce:]")
        maker, revision = IDENTITIES[self.dialect]
        common: dict[str, OutputAction] = {
            "*IDN?": lambda *_: ",".join((maker, self.model, self.serial_number, revision)),
            "*CLS": lambda *_: self._errors.clear(),
            "SYSTem:ERRor?": lambda *_: self._next_error(),
            f"{source}VOLTage": self._set_volts,
            f"{source}VOLTage?": lambda output, _: self._number_text(output.set_volts),
            f"{source}CURRent": self._set_amperes,
            f"{source}CURRent?": lambda output, _: self._number_text(output.set_amperes),
            "MEASure:VOLTage[:DC]?": lambda output, _: self._number_text(output.volts),
            "MEASure:CURRent[:DC]?": lambda output, _: self._number_text(output.amperes),
            "OUTPut[:STATe]": self._switch,
        }
        commands_of_dialect = {
            "e36xx": self._e36xx,
            "e36300": self._e36300,
            "dp800": self._dp800,
            "spd3303": self._spd3303,
        }
        return [(_pattern(name), act) for name, act in (common | commands_of_dialect[self.dialect]()).items()]

    def _panel_commands(self) -> dict[str, OutputAction]:
        """Return the commands that all dialects but the SPD3303X have, among them those that lock the panel."""
        return {
            "SYSTem:REMote": lambda *_: setattr(self, "remote", True),
            "SYSTem:LOCal": lambda *_: setattr(self, "remote", False),
            "OUTPut[:STATe]?": lambda output, _: self._boolean_text(output.on),
            "MEASure?": lambda output, _: self._number_text(output.volts),
        }

    def _e36xx(self) -> dict[str, OutputAction]:
        """Return the further commands of a Keysight E36xx."""
        return {
            **self._panel_commands(),
            **self._protection_commands("[SOURce:]VOLTage:PROTection", "[:LEVel]", ":TRIPped?", "over_voltage"),
            **self._protection_commands("[SOURce:]CURRent:PROTection", "[:LEVel]", ":TRIPped?", "over_current"),
            "[SOURce:]VOLTage:RANGe": self._set_range,
            "STATus:QUEStionable:CONDition?": lambda output, _: self._register_text(output.condition),
        }

    def _e36300(self) -> dict[str, OutputAction]:
        """Return the further commands of a Keysight E36300."""
        level = self._protection_commands("[SOURce:]VOLTage:PROTection", "[:LEVel]", ":TRIPped?", "over_voltage")
        return {
            **self._panel_commands(),
            **{name: act for name, act in level.items() if ":STATe" not in name},
            "[SOURce:]CURRent:PROTection:STATe": self._arm("over_current"),
            "[SOURce:]CURRent:PROTection:STATe?": lambda output, _: self._boolean_text(output.over_current.armed),
            "[SOURce:]CURRent:PROTection:TRIPped?": lambda output, _: self._boolean_text(output.over_current.tripped),
            "STATus:QUEStionable:INSTrument:ISUMmary<n>:CONDition?": lambda output, _: self._register_text(
                output.condition
            ),
            "INSTrument:NSELect": self._select,
            "INSTrument:NSELect?": lambda *_: f"{self.selected.number}",
            "OUTPut[:STATe]:COUPle:CHANnel?": lambda *_: "ALL" if self.coupled else "NONE",
            "OUTPut:TRACk[:STATe]?": lambda *_: self._boolean_text(self.tracking),
            **({} if self.model == "E36311A" else {"OUTPut:PAIR?": lambda *_: "OFF"}),
        }

    def _dp800(self) -> dict[str, OutputAction]:
        """Return the further commands of a Rigol DP800."""
        pair = TRACKING.get(self.model, ())
        commands_of_several: dict[str, OutputAction] = {
            "STATus:QUEStionable:INSTrument:ISUMmary<n>:CONDition?": lambda output, _: self._register_text(
                output.condition | 4 * output.over_voltage.tripped | 8 * output.over_current.tripped
            ),
            "INSTrument:NSELect": self._select,
            "INSTrument:NSELect?": lambda *_: f"{self.selected.number}",
            "OUTPut:TRACk?": lambda output, _: self._boolean_text(self.tracking) if output.number in pair else "NONE",
            "SYSTem:ONOFFSync?": lambda *_: self._boolean_text(self.coupled),
        }
        commands_of_one: dict[str, OutputAction] = {
            "STATus:QUEStionable:CONDition?": lambda output, _: self._register_text(output.condition)
        }
        return {
            **self._panel_commands(),
            **self._protection_commands("OUTPut:OVP", ":VALue", ":QUES?", "over_voltage"),
            **self._protection_commands("OUTPut:OCP", ":VALue", ":QUES?", "over_current"),
            **(commands_of_several if len(self.outputs) > 1 else commands_of_one),
        }

    def _spd3303(self) -> dict[str, OutputAction]:
        """Return the further commands of a Siglent SPD3303X."""
        return {
            "INSTrument": lambda output, _: setattr(self, "selected", output),
            "SYSTem:STATus?": lambda *_: f"0x{self._status():x}",
        }

    def _status(self) -> int:
        """Return the status word of an SPD3303X."""
        reported_outputs = list(enumerate(self.outputs[:2]))  # the word has no bits for output 3
        regulated = sum(1 << bit for bit, output in reported_outputs if output.condition == 1)
        on = sum(0x10 << bit for bit, output in reported_outputs if output.on)
        return regulated | (0x0C if self.coupled else 0x04) | on

    def _protection_commands(
        self, head: str, level_node: str, tripped_node: str, attribute: str
    ) -> dict[str, OutputAction]:
        """Return the commands of a protection, from the parts of their headers and the attribute of the output."""

        def protection_of(output: EmulatedOutput) -> ProtectionState:
            state: ProtectionState = getattr(output, attribute)
            return state

        def set_level(output: EmulatedOutput, text: str) -> None:
            value = _finite_number(text)
            if value is None or value < 0.0:
                return self._queue_error(OUT_OF_RANGE)
            protection_of(output).level = value
            return None

        switch_node = "[:STATe]" if self.dialect == "dp800" else ":STATe"
        return {
            head + level_node: set_level,
            f"{head}{level_node}?": lambda output, _: self._number_text(protection_of(output).level),
            head + switch_node: self._arm(attribute),
            f"{head}{switch_node}?": lambda output, _: self._boolean_text(protection_of(output).armed),
            head + tripped_node: lambda output, _: self._boolean_text(protection_of(output).tripped, "YES", "NO"),
        }

    def _arm(self, protection_name: str) -> OutputAction:
        """Return the action that switches a protection on or off."""

        def arm(output: EmulatedOutput, text: str) -> None:
            if text.upper() not in BOOLEANS:
                return self._queue_error(MISSING_PARAMETER if not text else OUT_OF_RANGE)
            getattr(output, protection_name).armed = text.upper() in ON
            return None

        return arm

    def _select(self, _output: EmulatedOutput, text: str) -> None:
        if not text.isdecimal() or not 1 <= int(text) <= len(self.outputs):
            return self._queue_error(OUT_OF_RANGE)
        self.selected = self.outputs[int(text) - 1]
        return None

    def _switch(self, output: EmulatedOutput, text: str) -> None:
        if text.upper() not in BOOLEANS:
            return self._queue_error(MISSING_PARAMETER if not text else OUT_OF_RANGE)
        on = text.upper() in ON
        for switched in self.outputs if self.coupled else (output,):
            switched.on = on or (switched.stuck and self._admits and switched.on)
        return None

    def _set_volts(self, output: EmulatedOutput, text: str) -> None:
        output.set_volts = self._programmed(text, 0.0, output.rating[0], output.set_volts)

    def _set_amperes(self, output: EmulatedOutput, text: str) -> None:
        lowest = LOWEST_CURRENT.get(self.dialect, 0.0)
        output.set_amperes = self._programmed(text, lowest, output.rating[1], output.set_amperes)

    def _programmed(self, text: str, lowest: float, rating: float, present_level: float) -> float:
        """Return the level in a command; queue an error and return the present one if it is out of range."""
        value = _finite_number(text)
        if value is None or not lowest <= value <= HIGHEST_LEVEL_OVER_RATING * rating:
            self._queue_error(OUT_OF_RANGE)
            return present_level
        return value

    def _set_range(self, output: EmulatedOutput, text: str) -> None:
        output.range = 0 if text.upper() == "LOW" else len(output.ratings) - 1

    def _next_error(self) -> str:
        """Remove the first entry of the error queue and return it as an answer."""
        number, text = self._errors.popleft() if self._errors else NO_ERROR
        if self.dialect == "spd3303":
            return f"{number},{text}" if number else "0  No Error"
        return f'{number:+d},"{text}"' if self.dialect in KEYSIGHT else f'{number},"{text}"'

    def _number_text(self, value: float) -> str:
        """Return a number in the form of the dialect."""
        if self.dialect == "spd3303":
            return f"{value:.2f}" if self.model.endswith("-E") else f"{value:.3f}"
        return f"{round(value, 8):+.8E}" if self.dialect in KEYSIGHT else f"{value:.4f}"

    def _register_text(self, value: int) -> str:
        return f"{value:+d}" if self.dialect in KEYSIGHT else f"{value}"

    def _boolean_text(self, value: bool, yes: str = "ON", no: str = "OFF") -> str:
        if self.dialect in KEYSIGHT:
            return "1" if value else "0"
        return yes if value else no


def _pattern(name: str) -> re.Pattern[str]:
    """Return the pattern of a header in the notation of the manuals.

    Capitals are the short form, and brackets enclose optional parts.

    `<n>` is the number of an output and may be missing.
    """
    expression = re.sub(
        r"[A-Z]+[a-z]*", lambda word: _both_forms(word[0]), name.replace("*", r"\*").replace("?", r"\?")
    )
    expression = expression.replace("<n>", r"(\d)?")
    return re.compile(":?" + expression.replace("[", "(?:").replace("]", ")?"), re.IGNORECASE)


def _both_forms(word: str) -> str:
    """Return an expression for the long and the short form of a word."""
    short_form = "".join(letter for letter in word if letter.isupper())
    return word if short_form == word else f"(?:{word}|{short_form})"


def _finite_number(text: str) -> float | None:
    """Return the number in a text; None if it is not a finite one."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
