"""Recognise a supply by `*IDN?` without an end of line."""

from leactl.driver.conversation import Script, Talk
from leactl.driver.probe import ANSWER_S, LineProbe, Seen, Sighting
from leactl.driver.serial_port import SerialPort
from leactl.errors import NoAnswer
from leactl_plugins.korad_ka.dialogue import IDENTIFY, identity_of, known_names
from leactl_plugins.korad_ka.replies import KoradIdentity
from leactl_plugins.korad_ka.settings import model_of


class KoradProbe(LineProbe):
    """Probe that asks for name, firmware and serial number."""

    baudrates = (9600,)

    def ask(self, port: SerialPort) -> Seen:
        """Ask for the identity; if nothing answers, send an end of line, which other instruments wait for."""
        port.line_end = b""
        try:
            reported = Talk(port, _query_identity(), ANSWER_S).finish(port.clock.now() + 2 * ANSWER_S)
        except NoAnswer:
            port.write(b"\n")
            return
        model = model_of(reported.name)
        if model is None:
            yield Sighting(None, identity_of(reported), None, f"no supply of this driver ({known_names()})")
        else:
            yield Sighting(None, identity_of(reported), {"model": model})


def _query_identity() -> Script[KoradIdentity]:
    """Query the identity."""
    reply = yield IDENTIFY._replace(patient=True)
    assert reply is not None
    identity: KoradIdentity = reply.value
    return identity
