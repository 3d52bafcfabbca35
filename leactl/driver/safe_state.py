"""Make devices safe: remove power from all of them first, then wait for each to confirm its safe state.

A device that does not answer uses up its deadline; all others have received their command before.
"""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Protocol

from leactl.driver.contract import SAFE_STATE_S, Confirmation, Driver, PowerSupply
from leactl.errors import DeviceError


class Port(Protocol):
    """A connection that can be made again."""

    def reopen(self) -> None:
        """Connect afresh.

        Raises
        ------
        DeviceError : it cannot be connected to.
        """


def send_at_once(send: Callable[[], object], port: Port, is_open: Callable[[], bool]) -> None:
    """Send a command that removes power, without waiting for its answer; if that fails, send it over a new connection.

    A failure is not raised, because `safe_state` reports it.

    send : sends the command, and connects before if there is no connection.
    is_open : returns whether a connection had been made; without one there is no second attempt.
    """
    try:
        send()
    except DeviceError:
        if is_open():
            with suppress(DeviceError):
                port.reopen()
                send()


def make_safe(devices: Iterable[Driver]) -> dict[str, Confirmation]:
    """Bring these devices to their safe state in this order, power supplies last; never raise.

    Return the confirmation of each device by its name.
    """
    ordered = sorted(devices, key=_is_supply)
    confirmations: dict[str, Confirmation] = {}
    for device in ordered:
        try:
            device.stop_now()
        except Exception:  # noqa: BLE001 (a broken driver must not delay the others; `safe_state` is called below)
            continue
    for device in ordered:
        name = getattr(device, "name", type(device).__name__)
        try:
            confirmations[name] = device.safe_state(SAFE_STATE_S)
        except Exception as error:  # noqa: BLE001 (a broken driver must not keep the others from being made safe)
            confirmations[name] = Confirmation(False, f"{type(error).__name__}: {error}")
    return confirmations


def _is_supply(device: Driver) -> bool:
    """Return whether a device is a power supply; a broken driver counts as none."""
    try:
        return isinstance(device, PowerSupply)  # reads the properties of the driver
    except Exception:  # noqa: BLE001 (a broken driver must not keep any device from being made safe)
        return False


def unconfirmed_devices(confirmations: Mapping[str, Confirmation], cause: str = "") -> str:
    """Return a line that names the devices without a confirmed safe state; it is empty if all are confirmed.

    The reason of a device is left out if it equals `cause`, which the caller's message already contains.
    """
    details = {name: confirmation.detail for name, confirmation in confirmations.items() if not confirmation.safe}
    failed_for_cause = [name for name, detail in details.items() if cause and detail.endswith(cause)]
    doubtful = [
        *([", ".join(failed_for_cause)] if failed_for_cause else []),
        *(f"{name}: {details[name]}" for name in details if name not in failed_for_cause),
    ]
    return "NOT CONFIRMED SAFE, switch off the supply: " + "; ".join(doubtful) if doubtful else ""
