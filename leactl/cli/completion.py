"""What a shell offers where a word is half typed: names of what ships, parameters of the protocol before them.

Paths are the shell's own: it offers files where nothing here begins with the word.
"""

from collections.abc import Callable, Iterable

import typer

from leactl.errors import InputError

Completion = Callable[[str], list[str]]


def offered(names: Callable[[], Iterable[str]]) -> Completion:
    """Names that begin as the word does; `names` is called, and what it needs imported, when a shell asks."""

    def matching(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return matching


def _protocols() -> Iterable[str]:
    from leactl.protocol.protocolfile import names

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
    """Offer `NAME=` of every parameter of the protocol that the command line names."""
    from leactl.protocol.protocolfile import load

    # a --set without its value stops the parser: words that were no options yet are left as they were
    named = context.params.get("protocol") or next(iter(context.args), "")
    try:
        names = load(named).parameters
    except InputError:
        return []
    return [f"{name}=" for name in names if name.startswith(incomplete)]
