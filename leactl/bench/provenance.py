"""Collect facts about the instruments of a bench, as reported by the devices or else stated in the bench file."""

from collections.abc import Sequence
from datetime import UTC, date, datetime

from leactl.bench.benchfile import CheckedDevice
from leactl.driver.contract import Identity
from leactl.errors import DeviceError
from leactl.runfile.instruments import LONGEST_LINE, Instrument
from leactl.yamlfile import printable


class Provenance:
    """Facts about one instrument: its entry in the bench file, and the identity that it reports when it is opened."""

    def __init__(self, entry: Instrument) -> None:
        self._entry = entry
        self._identity: dict[str, str] = {}

    def take(self, identity: Identity) -> None:
        """Store the identity that a device reports; it overrides the bench file.

        Raises
        ------
        DeviceError : the device reports a serial number, and the bench file states another.
        """
        texts = {name: " ".join(printable(text).split())[:LONGEST_LINE] for name, text in identity._asdict().items()}
        self._identity = {name: text for name, text in texts.items() if text}
        serial, expected = texts["serial"], self._entry.serial
        if serial and expected and _normalised(serial) != _normalised(expected):
            raise DeviceError(
                f"serial number {serial} answers, the bench file says {expected}: mend the wiring, or the file"
            )

    @property
    def reported(self) -> dict[str, str]:
        """The facts that the device reports of itself, by name, without empty ones."""
        return dict(self._identity)

    @property
    def facts(self) -> dict[str, str]:
        """All known facts among model, serial number, firmware and calibration dates, by name."""
        return self._entry.facts | self._identity

    @property
    def doubt(self) -> str:
        """Line on a reported firmware that differs from that in the bench file; empty if equal or if one is unknown."""
        firmware, expected = self._identity.get("firmware", ""), self._entry.firmware
        differs = firmware and expected and firmware != expected
        return f"firmware {firmware} answers, the bench file says {expected}" if differs else ""


def _normalised(serial: str) -> str:
    """Return a serial number without differences of spelling: case, blanks, leading zeros, 0x."""
    return "".join(serial.split()).casefold().removeprefix("0x").lstrip("0")


def overdue(devices: Sequence[CheckedDevice], today: date | None = None) -> dict[str, str]:
    """Return one line for each calibration that was due before today (UTC), by device."""
    today = today or datetime.now(UTC).date()
    lines = {}
    for device in devices:
        due_date, calibrated = device.entry.calibration_due, device.entry.calibrated
        if due_date is not None and due_date < today:
            calibration_text = f"; it was calibrated {calibrated}" if calibrated else ""
            lines[device.name] = f"calibration was due {due_date}, {(today - due_date).days} days ago{calibration_text}"
    return lines
