"""Shell completion of names: protocols, benches, motors, effects, campaigns and drivers, and parameters of a protocol.

Where no name matches, the shell completes paths itself.
"""

from collections.abc import Callable, Iterable

import typer

from leactl.errors import InputError

Completion = Callable[[str], list[str]]


def offered(names: Callable[[], Iterable[str]]) -> Completion:
    """Return a completion function for names; it calls `names` and returns those that begin with the typed word."""

    def matching(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return matching


def _protocols() -> Iterable[str]:
    from leactl.protocol.shipped import names

    return names()


def _benches() -> Iterable[str]:
    from leactl.bench.benchfile import names

    return names()


def _motors() -> Iterable[str]:
    from leactl.model.motor import motor_names

    return motor_names()


def _effects() -> Iterable[str]:
    from leactl.vocabulary.effect import effect_names

    return effect_names()


def _campaigns() -> Iterable[str]:
    from leactl.runner.campaign.campaignfile import names

    return names()


def _drivers() -> Iterable[str]:
    from leactl.driver.registry import names

    return names()


protocols, benches, motors = offered(_protocols), offered(_benches), offered(_motors)
effects, campaigns, drivers = offered(_effects), offered(_campaigns), offered(_drivers)


def settings(context: typer.Context, incomplete: str) -> list[str]:
    """Complete `NAME=` for each parameter of the protocol on the command line."""
    from leactl.protocol.protocolfile import load

    # a --set without its value stops the parser, which then leaves arguments in context.args
    protocol = context.params.get("protocol") or next(iter(context.args), "")
    try:
        names = load(protocol).parameters
    except InputError:
        return []
    return [f"{name}=" for name in names if name.startswith(incomplete)]
