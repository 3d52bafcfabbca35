"""Recognise an Elmo drive on a serial line by its version (VR) and serial number (SN[4]); nothing is assigned.

The driver's own exchanges are not used here: each sets a variable of the drive, to tell answers apart.
"""

import re

from leactl.driver.conversation import Query, Unreadable
from leactl.driver.probe import LineProbe, Seen, Sighting
from leactl.driver.serial_port import SerialPort
from leactl_plugins.elmo_serial.commissioning import identity_of
from leactl_plugins.elmo_serial.interpreter import END

VERSION_FORM = re.compile(r"[A-Z][A-Za-z]+ [0-9]+(\.[0-9]+)+[ -~]*", re.ASCII)  # such as "Whistle 1.01.12.00 08Mar2018"
SERIAL_NUMBER_FORM = re.compile(r"[0-9]{1,10}", re.ASCII)


class ElmoSerialProbe(LineProbe):
    """Probe that asks two questions; the echo of a question is not taken for an answer."""

    baudrates = (19200, 57600, 115200)

    def ask(self, port: SerialPort) -> Seen:
        """Ask for the version, then for the serial number."""
        port.line_end = END
        version: str | None = self.answer(port, Query("VR", lambda answer: _text_of_form(VERSION_FORM, answer)))
        if version is None:
            return
        serial: str | None = self.answer(port, Query("SN[4]", lambda answer: _text_of_form(SERIAL_NUMBER_FORM, answer)))
        yield Sighting(None, identity_of(version, serial or ""), {})


def _text_of_form(form: re.Pattern[str], answer: bytes) -> str:
    """Return an answer as text; raise Unreadable if it has another form."""
    text = answer.decode("ascii", "backslashreplace").strip()
    if not form.fullmatch(text):
        raise Unreadable(f"'{text}' where another form was expected")
    return text
