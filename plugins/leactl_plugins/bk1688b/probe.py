"""Recognise a BK Precision supply by its limits (GMAX), or by its settings (GETS) if it does not report limits."""

from typing import Any

from leactl.driver.contract import Identity
from leactl.driver.conversation import Query
from leactl.driver.probe import LineProbe, Seen, Sighting
from leactl.driver.serial_port import SerialPort
from leactl_plugins.bk1688b import replies
from leactl_plugins.bk1688b.replies import OK, LevelCounts
from leactl_plugins.bk1688b.settings import RATINGS, STEP_V, can_be_model

LIMITS = Query("GMAX", replies.parser_of_last_lines(2, replies.parse_levels), last=OK)
SETTINGS = LIMITS._replace(text="GETS")
MAKER = "BK Precision"


class Bk1688bProbe(LineProbe):
    """Probe that reads a voltage and a current of three digits each; there is no serial number or firmware to read."""

    baudrates = (9600,)

    def ask(self, port: SerialPort) -> Seen:
        """Ask for the limits, then for the settings."""
        port.line_end = b"\r"
        limits: LevelCounts | None = self.answer(port, LIMITS)
        if limits is None:
            levels: LevelCounts | None = self.answer(port, SETTINGS)
            if levels is not None:
                detail = f"does not tell its limits; set to {levels.voltage_steps * STEP_V:.1f} V"
                yield Sighting(None, Identity(f"{MAKER}, model unknown"), {}, detail)
            return
        detail = f"limits of {limits.voltage_steps * STEP_V:.1f} V and {limits.current_steps} steps of current"
        models = [model for model, rating in RATINGS.items() if can_be_model(limits, rating)]
        settings: dict[str, Any] | None = {"model": models[0]} if len(models) == 1 else None
        model = models[0] if settings else "unknown to this driver"
        yield Sighting(None, Identity(f"{MAKER} {model}"), settings, detail)
