"""Recognise ADS1115 converters at rest by their configuration, read at the four addresses that they can have.

Nothing is written, and no other address is touched. By its manual page, `i2cdetect` looks for chips by a write without
data, which corrupts some EEPROMs (AT24RF08), or by a read of a byte, which locks chips that can only be written.
"""

from leactl.driver.contract import Identity
from leactl.driver.i2c_port import I2cPort
from leactl.driver.probe import I2cProbe, Seen, Sighting
from leactl.errors import NoAnswer
from leactl_plugins.ads1115.settings import COMPARATOR_OFF, CONFIG, SINGLE_SHOT, START

ADDRESSES = range(0x48, 0x4C)
REST_CONFIG = START | SINGLE_SHOT | COMPARATOR_OFF  # idle, in single-shot mode, comparator off (TI SBAS444, 9.6.3)
ALL_ONES = 0xFFFF  # read from a bus that no device drives
AFTER_RESET = 0x8583  # configuration


class Ads1115Probe(I2cProbe):
    """Probe that reads one register of two bytes."""

    def ask(self, port: I2cPort) -> Seen:
        """Read the configuration at each address."""
        for address in ADDRESSES:
            try:
                config = port.read(address, CONFIG)
            except NoAnswer:
                continue
            detail = f"register 1 holds 0x{config:04X}"
            if config == ALL_ONES or config & REST_CONFIG != REST_CONFIG:
                yield Sighting(address, Identity(), None, f"{detail}; not that of an ADS1115 at rest")
            elif config == AFTER_RESET:
                yield Sighting(address, Identity("ADS1115"), {"address": address}, f"{detail}, as after its reset")
            else:
                yield Sighting(address, Identity("ADS1115"), {"address": address}, f"{detail}: it has been in use")
