"""Commands of four families of supplies for one output; families differ in what SCPI leaves open.

If a model has several outputs, every command and every query names the output itself, so that none depends on which
output is selected. In a command, `{}` is replaced by a value, or by ON or OFF.
"""

import math
import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Final, NamedTuple

from leactl.driver.contract import TripAccuracy
from leactl.driver.conversation import Query
from leactl_plugins.scpi_supply import replies
from leactl_plugins.scpi_supply.models import TRACKING

RELATIVE_TOLERANCE, ABSOLUTE_TOLERANCE = 0.005, 0.01  # of a level that is read back: a share of it, plus V or A
# over-voltage protection: the data sheets of the E36xx state 0.5 % and 0.5 V, and so does Rigol for its supplies
PROTECTION_ACCURACY = TripAccuracy(0.005 + RELATIVE_TOLERANCE, 0.5 + ABSOLUTE_TOLERANCE)
UNKNOWN_ACCURACY = TripAccuracy(0.0, math.inf)  # infinite, so that no level counts as a protection
LOWEST_CURRENT_E36300 = 0.002  # A, that can be set; an E36312A answers this or less to CURR? MIN
OVER_VOLTAGE, OVER_CURRENT = "over-voltage protection", "over-current protection"
KEYSIGHT_NUMBER = re.compile(r"[+-]\d\.\d{8}E[+-]\d\d", re.ASCII)  # every answer has this length
MAKE_INDEPENDENT = "set them independent at the instrument"


class SettingCommand(NamedTuple):
    """Command that sets a value, with `{}` in its place if the value varies, and query that reads it back."""

    command: str
    query: str


class Protection(NamedTuple):
    """Commands and queries of one protection."""

    name: str
    level: SettingCommand
    switch: SettingCommand | None  # arms and disarms it; None: it is always armed
    tripped_query: str


class RequiredAnswer(NamedTuple):
    """Answer that the instrument must give before the output is used, so that outputs do not act on each other."""

    question: Query
    accepted: tuple[str, ...]
    refusal: str  # message if another answer comes


class ScpiDialect(NamedTuple):
    """Commands of one family of instruments for one output."""

    voltage: SettingCommand
    current: SettingCommand
    measure_voltage: str
    measure_current: str
    switch: str
    is_on: Query  # whether the output is on
    condition: Query  # 1: constant current, 2: constant voltage
    error: Query
    over_voltage: Protection | None
    over_current: Protection | None
    reading: re.Pattern[str]  # exact form of the answer to a measurement
    remote: str = "SYST:REM"  # empty: there is no such command
    local: str = "SYST:LOC"
    required_answers: tuple[RequiredAnswer, ...] = ()
    # selects this output: a command that loses its channel list on the line acts on it
    select: SettingCommand | None = None
    set_range: str = ""  # empty: the family has no output ranges that can be set
    decimals: int = 4  # of a level in a command
    lowest_current: float = 0.0  # A, lowest level that can be set
    clear: bytes = b""  # makes the instrument abandon its present command, if it has such a byte
    trip_accuracy: TripAccuracy = PROTECTION_ACCURACY

    @property
    def off_bytes(self) -> bytes:
        """Bytes that switch the output off from any state; the line feed ends an incomplete earlier command."""
        select = self.select.command if self.select else ""
        lines = [line for line in (self.remote, select, self.switch.format("OFF")) if line]
        return self.clear + b"\n" + "".join(f"{line}\n" for line in lines).encode("ascii")


def _e36xx(_model: str, _output: int) -> ScpiDialect:
    """Return the commands of a Keysight E36xx, which has one output."""
    over_voltage, over_current = (
        Protection(
            name=name,
            level=SettingCommand(f"{head} {{}}", f"{head}?"),
            switch=SettingCommand(f"{head}:STAT {{}}", f"{head}:STAT?"),
            tripped_query=f"{head}:TRIP?",
        )
        for name, head in ((OVER_VOLTAGE, "VOLT:PROT"), (OVER_CURRENT, "CURR:PROT"))
    )
    return ScpiDialect(
        voltage=SettingCommand("VOLT {}", "VOLT?"),
        current=SettingCommand("CURR {}", "CURR?"),
        measure_voltage="MEAS:VOLT?",
        measure_current="MEAS:CURR?",
        switch="OUTP {}",
        is_on=Query("OUTP?", replies.parse_boolean),
        condition=Query("STAT:QUES:COND?", replies.parse_register),
        error=Query("SYST:ERR?", replies.parse_error_entry),
        over_voltage=over_voltage,
        over_current=over_current,
        reading=KEYSIGHT_NUMBER,
        set_range="VOLT:RANG {}",
        clear=b"\x03",  # device clear on RS-232 (E3632A User's Guide, page 61)
    )


def _e36300(model: str, output: int) -> ScpiDialect:
    """Return the commands of a Keysight E36300, which has three outputs; a channel list ends each command and query.

    The over-voltage protection has no switch. The over-current protection has no level: it trips as soon as the output
    regulates its current. It must be off, because the driver lets an output regulate its current.
    """
    channel_list = f"(@{output})"
    coupling_refusal = "its outputs are switched or set together: " + MAKE_INDEPENDENT
    required_answers = [
        RequiredAnswer(
            Query(f"CURR:PROT:STAT? {channel_list}", replies.parse_word),
            ("0",),
            f"{OVER_CURRENT} is on, and would trip as soon as the output regulates its current: switch it off at the"
            " instrument",
        ),
        RequiredAnswer(Query("OUTP:COUP:CHAN?", replies.parse_word), ("NONE",), coupling_refusal),
        RequiredAnswer(Query("OUTP:TRAC?", replies.parse_word), ("0",), coupling_refusal),
    ]
    if model != "E36311A":  # the outputs of an E36311A cannot be paired
        required_answers.append(RequiredAnswer(Query("OUTP:PAIR?", replies.parse_word), ("OFF",), coupling_refusal))
    return ScpiDialect(
        voltage=SettingCommand(f"VOLT {{}},{channel_list}", f"VOLT? {channel_list}"),
        current=SettingCommand(f"CURR {{}},{channel_list}", f"CURR? {channel_list}"),
        measure_voltage=f"MEAS:VOLT? {channel_list}",
        measure_current=f"MEAS:CURR? {channel_list}",
        switch=f"OUTP {{}},{channel_list}",
        is_on=Query(f"OUTP? {channel_list}", replies.parse_boolean),
        condition=Query(f"STAT:QUES:INST:ISUM{output}:COND?", replies.parse_regulation),
        error=Query("SYST:ERR?", replies.parse_error_entry),
        over_voltage=Protection(
            name=OVER_VOLTAGE,
            level=SettingCommand(f"VOLT:PROT {{}},{channel_list}", f"VOLT:PROT? {channel_list}"),
            switch=None,
            tripped_query=f"VOLT:PROT:TRIP? {channel_list}",
        ),
        over_current=None,
        reading=KEYSIGHT_NUMBER,
        required_answers=tuple(required_answers),
        lowest_current=LOWEST_CURRENT_E36300,
        select=SettingCommand(f"INST:NSEL {output}", "INST:NSEL?"),
        trip_accuracy=UNKNOWN_ACCURACY,
    )


def _dp800(model: str, output: int) -> ScpiDialect:
    """Return the commands of a Rigol DP800, which has one output or several.

    If it has several, the channel stands in front of each value and behind each query.
    """
    value_prefix, query_suffix, source = (f"CH{output},", f" CH{output}", f"SOUR{output}:") if output else ("", "", "")
    over_voltage, over_current = (
        Protection(
            name=name,
            level=SettingCommand(f"{head}:VAL {value_prefix}{{}}", f"{head}:VAL?{query_suffix}"),
            switch=SettingCommand(f"{head} {value_prefix}{{}}", f"{head}?{query_suffix}"),
            tripped_query=f"{head}:QUES?{query_suffix}",
        )
        for name, head in ((OVER_VOLTAGE, "OUTP:OVP"), (OVER_CURRENT, "OUTP:OCP"))
    )
    required_answers: tuple[RequiredAnswer, ...] = ()
    if output:
        pair = TRACKING.get(model, ())
        required_answers = (
            *(
                RequiredAnswer(
                    Query(f"OUTP:TRAC? CH{number}", replies.parse_word),
                    ("OFF", "NONE"),
                    f"the voltages of outputs {pair[0]} and {pair[1]} follow each other: {MAKE_INDEPENDENT}",
                )
                for number in (pair if output in pair else ())
            ),
            RequiredAnswer(
                Query("SYST:ONOFFSYNC?", replies.parse_word),
                ("OFF",),
                "its outputs are switched together: " + MAKE_INDEPENDENT,
            ),
        )
    return ScpiDialect(
        voltage=SettingCommand(f"{source}VOLT {{}}", f"{source}VOLT?"),
        current=SettingCommand(f"{source}CURR {{}}", f"{source}CURR?"),
        measure_voltage=f"MEAS:VOLT?{query_suffix}",
        measure_current=f"MEAS:CURR?{query_suffix}",
        switch=f"OUTP {value_prefix}{{}}",
        is_on=Query(f"OUTP?{query_suffix}", replies.parse_boolean),
        condition=Query(f"STAT:QUES:INST:ISUM{output}:COND?", replies.parse_regulation)
        if output
        else Query("STAT:QUES:COND?", replies.parse_register),
        error=Query("SYST:ERR?", replies.parse_error_entry),
        over_voltage=over_voltage,
        over_current=over_current,
        reading=re.compile(r"-?\d{1,2}\.\d{3,4}", re.ASCII),  # such as 12.0035; the guide has three decimals as well
        required_answers=required_answers,
    )


def _spd3303(_model: str, output: int) -> ScpiDialect:
    """Return the commands of a Siglent SPD3303X, which has two outputs that share a status word.

    The headers are spelt in full, as in the guide: the instrument never answers a header that it does not know, so that
    an unknown abbreviation would cost a time-out.
    """
    status = "SYSTem:STATus?"
    return ScpiDialect(
        voltage=SettingCommand(f"CH{output}:VOLTage {{}}", f"CH{output}:VOLTage?"),
        current=SettingCommand(f"CH{output}:CURRent {{}}", f"CH{output}:CURRent?"),
        measure_voltage=f"MEASure:VOLTage? CH{output}",
        measure_current=f"MEASure:CURRent? CH{output}",
        switch=f"OUTPut CH{output},{{}}",
        is_on=Query(status, partial(replies.parse_status_on, output=output)),
        condition=Query(status, partial(replies.parse_status_regulation, output=output)),
        error=Query("SYSTem:ERRor?", replies.parse_loose_error_entry),
        over_voltage=None,
        over_current=None,
        reading=re.compile(r"\d{1,2}\.\d{2,3}", re.ASCII),  # an SPD3303X-E sends two decimals
        remote="",
        local="",
        required_answers=(
            RequiredAnswer(
                Query(status, replies.parse_status_outputs),
                ("independent",),
                "its outputs are in series or in parallel: " + MAKE_INDEPENDENT,
            ),
        ),
        decimals=3,
        trip_accuracy=UNKNOWN_ACCURACY,
    )


# by family; arguments are the model and the number of its output, 0 if it has only one
DIALECTS: Final[Mapping[str, Callable[[str, int], ScpiDialect]]] = {
    "e36xx": _e36xx,
    "e36300": _e36300,
    "dp800": _dp800,
    "spd3303": _spd3303,
}
