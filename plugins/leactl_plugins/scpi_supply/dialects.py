"""Commands of two families of supplies that SCPI does not standardise: protection, ranges, readings, device clear."""

import re
from typing import Final, NamedTuple


class Protection(NamedTuple):
    """One protection: its level, its switch, and whether it has tripped."""

    name: str
    set_level: str
    level: str
    switch: str
    armed: str
    tripped: str


class ScpiDialect(NamedTuple):
    """Commands of one family of instruments."""

    voltage: Protection
    current: Protection
    set_range: str  # empty: the family has no ranges that can be set
    reading: re.Pattern[str]  # what is answered to MEAS, to the last digit
    clear: bytes  # gives up what the instrument is about, where it knows such a byte

    @property
    def off(self) -> bytes:
        """Bytes that switch the output off from any state; the line feed ends an incomplete earlier command."""
        return self.clear + b"\nSYST:REM\nOUTP OFF\n"


DIALECTS: Final = {
    "e36xx": ScpiDialect(
        Protection(
            "over-voltage protection",
            "VOLT:PROT",
            "VOLT:PROT?",
            "VOLT:PROT:STAT",
            "VOLT:PROT:STAT?",
            "VOLT:PROT:TRIP?",
        ),
        Protection(
            "over-current protection",
            "CURR:PROT",
            "CURR:PROT?",
            "CURR:PROT:STAT",
            "CURR:PROT:STAT?",
            "CURR:PROT:TRIP?",
        ),
        "VOLT:RANG",
        re.compile(r"[+-]\d\.\d{8}E[+-]\d\d", re.ASCII),
        b"\x03",  # device clear on RS-232 (E3632A User's Guide, page 61)
    ),
    "dp800": ScpiDialect(
        Protection(
            "over-voltage protection", "OUTP:OVP:VAL", "OUTP:OVP:VAL?", "OUTP:OVP", "OUTP:OVP?", "OUTP:OVP:QUES?"
        ),
        Protection(
            "over-current protection", "OUTP:OCP:VAL", "OUTP:OCP:VAL?", "OUTP:OCP", "OUTP:OCP?", "OUTP:OCP:QUES?"
        ),
        "",
        re.compile(r"-?\d{1,2}\.\d{3,4}", re.ASCII),  # 12.0035; three decimals stand in the guide as well
        b"",
    ),
}
