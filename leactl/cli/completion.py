"""Shell completion of names: protocols, benches, motors, effects, campaigns and drivers, and parameters of a protocol.

If no name matches, the shell itself completes paths.
"""

from collections.abc import Callable, Iterable

import typer

from leactl.errors import InputError

Completion = Callable[[str], list[str]]


def completion_of(names: Callable[[], Iterable[str]]) -> Completion:
    """Return a function that completes a typed word: it returns the results of `names` that begin with the word."""

    def matching(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return matching


def _protocol_names() -> Iterable[str]:
    """Return the names of the shipped protocols; the library is imported only when a user presses Tab."""
    from leactl.protocol.shipped import names

    return names()


def _bench_names() -> Iterable[str]:
    """Return the names of the shipped benches."""
    from leactl.bench.benchfile import names

    return names()


def _motor_names() -> Iterable[str]:
    """Return the names of the shipped motors."""
    from leactl.model.motor import motor_names

    return motor_names()


def _effect_names() -> Iterable[str]:
    """Return the names of the effects of the vocabulary."""
    from leactl.vocabulary.effect import effect_names

    return effect_names()


def _campaign_names() -> Iterable[str]:
    """Return the names of the shipped campaigns."""
    from leactl.runner.campaign.campaignfile import names

    return names()


def _driver_names() -> Iterable[str]:
    """Return the names of the driver plug-ins."""
    from leactl.driver.registry import names

    return names()


complete_protocol, complete_bench, complete_motor = (
    completion_of(_protocol_names),
    completion_of(_bench_names),
    completion_of(_motor_names),
)
complete_effect, complete_campaign, complete_driver = (
    completion_of(_effect_names),
    completion_of(_campaign_names),
    completion_of(_driver_names),
)


def complete_setting(context: typer.Context, incomplete: str) -> list[str]:
    """Complete `NAME=` for each parameter of the protocol on the command line."""
    from leactl.protocol.protocolfile import load

    # a --set without its value stops the parser, which then leaves the protocol in context.args
    protocol = context.params.get("protocol") or next(iter(context.args), "")
    try:
        parameters = load(protocol).parameters
    except InputError:
        return []
    return [f"{name}=" for name in parameters if name.startswith(incomplete)]
