"""Recognise an SCPI supply by `*IDN?`; nothing else is sent, and remote control is not asked for."""

from leactl.driver.contract import Identity
from leactl.driver.probe import LineProbe, Seen, Sighting
from leactl.driver.serial_port import SerialPort
from leactl_plugins.scpi_supply.dialogue import IDENTIFY
from leactl_plugins.scpi_supply.models import OUTPUTS, RANGES, dialect_of
from leactl_plugins.scpi_supply.replies import InstrumentIdentity


class ScpiProbe(LineProbe):
    """Asks for maker, model, serial number and revision."""

    baudrates = (9600, 19200, 38400, 57600, 115200)

    def ask(self, port: SerialPort) -> Seen:
        """Ask for the identity."""
        who: InstrumentIdentity | None = self.answer(port, IDENTIFY)
        if who is None:
            return
        identity, dialect = identity_of(who), dialect_of(who.model)
        if dialect is None:
            yield Sighting(None, identity, None, f"no supply of this driver ({', '.join((*RANGES, *OUTPUTS))})")
            return
        number = {"serial_number": identity.serial} if identity.serial else {}
        several = ("output",) if who.model in OUTPUTS else ()  # which of them feeds the motor, no instrument can know
        yield Sighting(None, identity, {"dialect": dialect, "model": who.model, **number}, left_open=several)


def identity_of(reported: InstrumentIdentity) -> Identity:
    """Maker with model, serial number and revision; the instrument reports 0 if it has none."""
    serial, revision = (text if text.strip("0") else "" for text in (reported.serial_number, reported.revision))
    return Identity(f"{reported.maker} {reported.model}", serial, revision)
