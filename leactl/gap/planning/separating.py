"""Choose the experiment that tells the effects of a class apart, a protocol that `leactl run` can execute."""

from collections.abc import Sequence

from leactl.protocol import protocolfile, shipped


def separating_experiment(effect: str, peers: Sequence[str]) -> str | None:
    """Return the shipped protocol that separates most effects of a class; of several such, the shortest.

    None is returned if the class has one effect, or no protocol separates two of its effects, such as gains that only a
    reference instrument separates.
    """
    if not peers:
        return None
    members = {effect, *peers}
    plans = [protocolfile.load(name) for name in shipped.names()]
    best = max(plans, key=lambda plan: (len(members.intersection(plan.separates)), -plan.duration_s))
    return best.name if len(members.intersection(best.separates)) > 1 else None
