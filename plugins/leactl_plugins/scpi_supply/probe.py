"""Recognise an SCPI supply by `*IDN?`; nothing else is sent, and remote control is not asked for."""

from leactl.driver.contract import Identity
from leactl.driver.probe import LineProbe, Seen, Sighting
from leactl.driver.serial_port import SerialPort
from leactl_plugins.scpi_supply.dialogue import IDENTIFY
from leactl_plugins.scpi_supply.models import OUTPUTS, RANGES, dialect_of
from leactl_plugins.scpi_supply.replies import InstrumentIdentity


class ScpiProbe(LineProbe):
    """Probe that asks for maker, model, serial number and revision."""

    baudrates = (9600, 19200, 38400, 57600, 115200)

    def ask(self, port: SerialPort) -> Seen:
        """Ask for the identity."""
        reported: InstrumentIdentity | None = self.answer(port, IDENTIFY)
        if reported is None:
            return
        identity, dialect = identity_of(reported), dialect_of(reported.model)
        if dialect is None:
            yield Sighting(None, identity, None, f"no supply of this driver ({', '.join((*RANGES, *OUTPUTS))})")
            return
        serial_number = {"serial_number": identity.serial} if identity.serial else {}
        # no instrument knows which of its outputs feeds the motor
        unknown_settings = ("output",) if reported.model in OUTPUTS else ()
        yield Sighting(
            None, identity, {"dialect": dialect, "model": reported.model, **serial_number}, left_open=unknown_settings
        )


def identity_of(reported: InstrumentIdentity) -> Identity:
    """Return maker with model, serial number and revision; a field that the instrument reports as 0 is empty."""
    serial, revision = (text if text.strip("0") else "" for text in (reported.serial_number, reported.revision))
    return Identity(f"{reported.maker} {reported.model}", serial, revision)
