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
    """Send a command that removes power, without waiting for its answer; once more over a new connection if that fails.

    send : sends, and connects before if there is no connection.
    is_open : whether a connection had been made; without one there is no second try. `safe_state` reports the failure.
    """
    try:
        send()
    except DeviceError:
        if is_open():
            with suppress(DeviceError):
                port.reopen()
                send()


def make_safe(devices: Iterable[Driver]) -> dict[str, Confirmation]:
    """Bring these devices to their safe state in this order, power supplies last; never raises."""
    ordered = sorted(devices, key=_supplies)
    outcome: dict[str, Confirmation] = {}
    for device in ordered:
        try:
            device.stop_now()
        except Exception:  # noqa: BLE001 (a broken driver must not delay the others; `safe_state` is called below)
            continue
    for device in ordered:
        name = getattr(device, "name", type(device).__name__)
        try:
            outcome[name] = device.safe_state(SAFE_STATE_S)
        except Exception as error:  # noqa: BLE001 (a broken driver must not keep the others from being made safe)
            outcome[name] = Confirmation(False, f"{type(error).__name__}: {error}")
    return outcome


def _supplies(device: Driver) -> bool:
    try:
        return isinstance(device, PowerSupply)  # reads the properties of the driver
    except Exception:  # noqa: BLE001 (a broken driver must not keep any device from being made safe)
        return False


def unconfirmed_devices(outcome: Mapping[str, Confirmation], cause: str = "") -> str:
    """One line that names the devices without a confirmed safe state; empty if all confirmed.

    The reason of a device is left out if it equals `cause`, which the caller's message already contains.
    """
    unsafe = {name: confirmation.detail for name, confirmation in outcome.items() if not confirmation.safe}
    known = [name for name, detail in unsafe.items() if cause and detail.endswith(cause)]
    doubtful = [*([", ".join(known)] if known else []), *(f"{n}: {unsafe[n]}" for n in unsafe if n not in known)]
    return "NOT CONFIRMED SAFE, switch off the supply: " + "; ".join(doubtful) if doubtful else ""
