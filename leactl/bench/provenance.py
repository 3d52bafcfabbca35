"""What is known of the instruments of a bench: what each tells of itself, else what the bench file says of it."""

from collections.abc import Sequence
from datetime import UTC, date, datetime

from leactl.bench.benchfile import CheckedDevice
from leactl.driver.contract import Identity
from leactl.errors import DeviceError
from leactl.runfile.instruments import LONGEST, Instrument
from leactl.yamlfile import printable


class Provenance:
    """One instrument: the bench file's entry, and its own word once it is open."""

    def __init__(self, entry: Instrument) -> None:
        self._entry = entry
        self._identity: dict[str, str] = {}

    def take(self, identity: Identity) -> None:
        """Let what the device tells go over what the bench file says.

        Raises
        ------
        DeviceError : the device tells another serial number than the bench file.
        """
        texts = {name: " ".join(printable(text).split())[:LONGEST] for name, text in identity._asdict().items()}
        self._identity = {name: text for name, text in texts.items() if text}
        serial, expected = texts["serial"], self._entry.serial
        if serial and expected and _bare(serial) != _bare(expected):
            raise DeviceError(
                f"serial number {serial} answers, the bench file says {expected}: mend the wiring, or the file"
            )

    @property
    def facts(self) -> dict[str, str]:
        """Model, serial number, firmware and calibration, each where it is known."""
        return self._entry.facts | self._identity

    @property
    def doubt(self) -> str:
        """Another firmware than the bench file says; empty where it is the same, or either is silent."""
        firmware, expected = self._identity.get("firmware", ""), self._entry.firmware
        differs = firmware and expected and firmware != expected
        return f"firmware {firmware} answers, the bench file says {expected}" if differs else ""


def _bare(serial: str) -> str:
    """A serial number without what labels and instruments write differently: case, blanks, zeros in front, 0x."""
    return "".join(serial.split()).casefold().removeprefix("0x").lstrip("0")


def overdue(devices: Sequence[CheckedDevice], today: date | None = None) -> dict[str, str]:
    """A line for each device whose calibration was due before today (UTC), by its name."""
    today = today or datetime.now(UTC).date()
    lines = {}
    for device in devices:
        due, calibrated = device.entry.calibration_due, device.entry.calibrated
        if due is not None and due < today:
            since = f"; it was calibrated {calibrated}" if calibrated else ""
            lines[device.name] = f"calibration was due {due}, {(today - due).days} days ago{since}"
    return lines
